"""The whole command line as one parser: what completion and the man page are made from."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

from failstop.cli import main as cli


def whole() -> argparse.ArgumentParser:
    """`failstop` with all commands that are installed, in the order of `failstop --help`."""
    parser = argparse.ArgumentParser(prog="failstop")
    parser.add_argument("-V", "--version", action="store_true", help="the version")
    below = parser.add_subparsers()
    for _, names in cli.groups():
        for name in filter(cli.here, names):
            below.add_parser(name, help=cli.COMMANDS[name][1])
            below.choices[name], _ = cli.load(name)
    named = list(below.choices)
    below.add_parser("help", help="what a command does").add_argument("command", nargs="?", choices=named)
    return parser


def walk(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """It, and the parsers of the commands below it, each with a description."""
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            helps = {choice.dest: choice.help for choice in action._choices_actions}
            for word, below in action.choices.items():
                below.description = below.description or helps[word]
                yield from walk(below)


def arguments(parser: argparse.ArgumentParser) -> list[argparse.Action]:
    """The arguments that its help shows, positional ones first, without the help itself and the commands below."""
    shown = [action for action in parser._actions if action.help != argparse.SUPPRESS]
    kinds = (argparse._HelpAction, argparse._SubParsersAction)
    return sorted((action for action in shown if not isinstance(action, kinds)), key=lambda it: bool(it.option_strings))


def value(action: argparse.Action) -> str:
    """What the help calls its value; empty: it has none."""
    if action.nargs == 0:
        return ""
    if isinstance(action.metavar, str):
        return action.metavar
    if action.choices:
        return f"{{{','.join(map(str, action.choices))}}}"
    return action.dest.upper() if action.option_strings else action.dest
