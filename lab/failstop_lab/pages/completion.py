"""The scripts that make a shell complete what is typed after `failstop`; and the whole command line as one parser, of
which the man page is made too.

    python -m failstop_lab.pages.completion bash|zsh|fish
"""

from __future__ import annotations

import argparse
import sys
from argparse import SUPPRESS, ArgumentParser
from collections.abc import Iterator

import shtab

from failstop.cli import main as cli

SHELLS = ("bash", "zsh", "fish")
FILES = ("FILE", "PATH", "LINK", "F", "F.PNG", "F.MCAP")
"""The help's word for values that are files."""
# Bash takes a word apart at each "=", and shtab counts the parts.
EQUALS = """
_failstop() {
    local word words=()
    for word in "${COMP_WORDS[@]:0:COMP_CWORD}"; do
        [[ $word == "=" ]] || words+=("$word")
    done
    local COMP_WORDS=("${words[@]}" "${COMP_WORDS[COMP_CWORD]#=}") COMP_CWORD=${#words[@]}
    _shtab_failstop
}
complete -o bashdefault -F _failstop failstop
"""


def script(shell: str) -> str:
    """The completion script for one of SHELLS."""
    kinds = dict.fromkeys(FILES, shtab.FILE) | {"DIR": shtab.DIRECTORY}
    parsers = whole()
    for parser in walk(parsers):
        for action in arguments(parser):
            if found := kinds.get(value(action)):
                action.complete = found  # type: ignore[attr-defined]
    return str(shtab.complete(parsers, shell)) + (EQUALS if shell == "bash" else "")


def whole() -> ArgumentParser:
    """`failstop` with all commands that are installed, in the order of `failstop --help`."""
    parser = ArgumentParser(prog="failstop")
    parser.add_argument("-V", "--version", action="store_true", help="the version")
    below = parser.add_subparsers()
    for name in filter(cli.here, cli.COMMANDS):
        below.add_parser(name, help=cli.COMMANDS[name][1])
        below.choices[name], _ = cli.load(name)
    named = list(below.choices)
    below.add_parser("help", help="what a command does").add_argument("command", nargs="?", choices=named)
    return parser


def walk(parser: ArgumentParser) -> Iterator[ArgumentParser]:
    """It, and the parsers of the commands below it, each with a description."""
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            helps = {choice.dest: choice.help for choice in action._choices_actions}
            for word, below in action.choices.items():
                below.description = below.description or helps[word]
                yield from walk(below)


def arguments(parser: ArgumentParser) -> list[argparse.Action]:
    """The arguments that its help shows, positional ones first, without the help itself and the commands below."""
    shown = [action for action in parser._actions if action.help != SUPPRESS]
    kinds = (argparse._HelpAction, argparse._SubParsersAction)
    return sorted((action for action in shown if not isinstance(action, kinds)), key=lambda it: bool(it.option_strings))


def value(action: argparse.Action) -> str:
    """The help's word for its value; empty: it has none."""
    if action.nargs == 0:
        return ""
    if isinstance(action.metavar, str):
        return action.metavar
    if action.choices:
        return f"{{{','.join(map(str, action.choices))}}}"
    return action.dest.upper() if action.option_strings else action.dest


def placeholder(action: argparse.Action) -> str:
    """The help's word for its value, in brackets if an option's value may be left out; empty: it has none."""
    word = value(action)
    return f"[{word}]" if word and action.option_strings and action.nargs == "?" else word


def what(parser: ArgumentParser) -> str:
    """The purpose of a command, as a sentence."""
    text = " ".join((parser.description or "").split())
    return f"{text[:1].upper()}{text[1:].rstrip('.')}."


def help_of(parser: ArgumentParser, action: argparse.Action) -> str:
    """The help on an argument; empty: there is none."""
    return " ".join(parser._get_formatter()._expand_help(action).split()) if action.help else ""


def placed(action: argparse.Action, shown: str) -> str:
    """A positional argument as a synopsis has it: whether it may be left out, or be several."""
    several = f"{shown} ..." if action.nargs in ("*", "+", argparse.REMAINDER) else shown
    return f"[{several}]" if action.nargs in ("?", "*") else several


def examples(parser: ArgumentParser) -> list[str]:
    """The lines below its help."""
    lines = (parser.epilog or "").removeprefix(cli.EXAMPLES).strip().splitlines()
    return [line.strip() for line in lines]


if __name__ == "__main__":
    sys.stdout.write(script(sys.argv[1]))
