"""The commands of `failstop` as data, read from their parsers: what completion and the man page are made from."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass

from failstop.cli import main as cli

KINDS = {
    "FILE": "file",
    "PATH": "file",
    "LINK": "file",
    "F": "file",
    "F.PNG": "file",
    "F.MCAP": "file",
    "DIR": "directory",
    "NAME": "instance",
    "ID": "incident",
}
"""What a value is, by the name that the help gives it; any other value is the user's to know."""


@dataclass(frozen=True)
class Argument:
    """One option or one positional argument."""

    flags: tuple[str, ...]
    """Empty: positional."""
    value: str | None
    """What the help calls its value; None: it has none."""
    help: str
    kind: str
    """One of the values of KINDS; "choice", "other", or "none" for an option without a value."""
    choices: tuple[str, ...] = ()
    repeats: bool = False
    """Takes any number of values."""
    required: bool = False


@dataclass(frozen=True)
class Command:
    """One command, or one command of a command."""

    path: tuple[str, ...]
    """Its words after `failstop`."""
    what: str
    """One sentence."""
    options: tuple[Argument, ...]
    positionals: tuple[Argument, ...]
    children: tuple[Command, ...]
    examples: tuple[str, ...]

    def walk(self) -> Iterator[Command]:
        """It, and the commands below it."""
        yield self
        for child in self.children:
            yield from child.walk()


def read() -> list[tuple[str, list[Command]]]:
    """All commands that are installed, by purpose, in the order of `failstop --help`."""
    found = [(title, [command(name) for name in names if cli.here(name)]) for title, names in cli.groups()]
    return [(title, commands) for title, commands in found if commands]


def command(name: str) -> Command:
    """One of the names of cli.COMMANDS."""
    parser, module = cli.load(name)
    return _command((name,), parser, tuple(cli.examples(module, name)))


def _command(path: tuple[str, ...], parser: argparse.ArgumentParser, examples: tuple[str, ...] = ()) -> Command:
    arguments, children = [], []
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            helps = {choice.dest: choice.help or "" for choice in action._choices_actions}
            for word, below in action.choices.items():
                below.description = below.description or helps.get(word)
                children.append(_command((*path, word), below))
        elif action.help != argparse.SUPPRESS:
            arguments.append(_argument(action))
    return Command(
        path,
        _sentence(parser.description or ""),
        tuple(argument for argument in arguments if argument.flags),
        tuple(argument for argument in arguments if not argument.flags),
        tuple(children),
        examples,
    )


def _sentence(text: str) -> str:
    text = " ".join(text.split())
    return text[:1].upper() + text[1:].rstrip(".") + "."


def _argument(action: argparse.Action) -> Argument:
    takes_none = action.nargs == 0
    choices = tuple(str(choice) for choice in action.choices or ())
    shown = action.metavar if isinstance(action.metavar, str) else None
    if takes_none:
        value = None
    elif action.option_strings:
        value = shown or (f"{{{','.join(choices)}}}" if choices else action.dest.upper())
    else:
        value = shown or (f"{{{','.join(choices)}}}" if choices else action.dest)
    return Argument(
        flags=tuple(action.option_strings),
        value=value,
        help=_expanded(action),
        kind="none" if takes_none else "choice" if choices else KINDS.get((value or "").upper(), "other"),
        choices=choices,
        repeats=action.nargs in ("*", "+", argparse.REMAINDER),
        required=action.required if action.option_strings else action.nargs not in ("?", "*"),
    )


def _expanded(action: argparse.Action) -> str:
    """The help text with its %(default)s and the like filled in."""
    text = action.help or ""
    return " ".join((text % {**vars(action), "prog": "failstop"}).split()) if "%" in text else " ".join(text.split())
