"""The page docs/reference/commands.md: all commands, from their parsers."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator

from failstop.cli import main as cli
from failstop_lab.pages import completion, man

PAGE_HEAD = """# Commands

On this page you can look up every command with its options. On the robot `failstop COMMAND --help` and `man failstop`
say the same. {laboratory} come with the package `failstop-lab`; a checkout has them too.
This page is generated from the parsers (`make docs`).
"""

SECOND = "The same as "
"""The first words of the help of a command that is only a second name."""


def page() -> str:
    """The page."""
    parts = [PAGE_HEAD.format(laboratory=_listed(name for name in cli.COMMANDS if cli.is_laboratory(name)))]
    for title, names in cli.GROUPS.items():
        parts.append(f"## {title.capitalize()}\n")
        parts += [part for name in names for below in completion.walk(cli.load(name)[0]) for part in command(below)]
    parts += ["## Exit codes\n", *_table("code", man.EXITS)]
    parts += ["## Files\n", *_table("file", ((f"`{name}`", text) for name, text in man.FILES))]
    parts += ["## Environment\n", *_table("variable", ((f"`{name}`", text) for name, text in man.ENVIRONMENT))]
    return "\n".join(parts)


def command(parser: argparse.ArgumentParser) -> Iterator[str]:
    """The page's part on one command."""
    what = completion.what(parser)
    yield f"### {parser.prog}\n"
    yield f"{what}\n"
    if what.startswith(SECOND):
        return
    if parser._subparsers is None and not all(action.option_strings for action in completion.arguments(parser)):
        yield f"`{' '.join(_synopsis(parser))}`\n"
    rows = []
    for action in completion.arguments(parser):
        value = completion.placeholder(action)
        names = ", ".join(f"`{f'{flag} {value}'.strip()}`" for flag in action.option_strings or ("",))
        rows.append((names, completion.help_of(parser, action)))
    yield from _table("argument", rows)
    if examples := completion.examples(parser):
        yield "\n".join(["```sh", *examples, "```\n"])


def _listed(names: Iterable[str]) -> str:
    """The names as they are read in a sentence: `a`, `b` and `c`."""
    *others, last = (f"`{name}`" for name in names)
    return f"{', '.join(others)} and {last}"


def _synopsis(parser: argparse.ArgumentParser) -> Iterator[str]:
    yield f"{parser.prog} [OPTION ...]"
    for action in completion.arguments(parser):
        if not action.option_strings:
            yield completion.placed(action, completion.value(action))


def _table(head: str, rows: Iterable[tuple[str, str]]) -> Iterator[str]:
    if cells := [f"| {name} | {text} |" for name, text in ((_cell(name), _cell(text)) for name, text in rows)]:
        yield "\n".join([f"| {head} | meaning |", "|---|---|", *cells, ""])


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
