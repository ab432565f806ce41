"""Fold: a line for people, broken at words to fit a terminal. A pipe and the journal get it whole: one event, one line.

The supervisor uses this too, so it imports nothing that costs.
"""

from __future__ import annotations

import os

LEAST_COLUMNS = 40
"""Below this a hanging indent leaves too little."""
PREFIX = "failstop: "
"""The begin of the service's lines and of the commands' errors."""
JOINED = "\0"
"""In the place of a space that is no place to break at."""


def fold(text: str, width: int, indent: int) -> str:
    """The text with line breaks, no line longer than `width` columns, those after the first indented. A command in
    backquotes stays whole where it fits; a single word that is longer than a line is left to the terminal."""
    if len(text) <= width or width < LEAST_COLUMNS:
        return text
    rows, row = [], ""
    for word in _words(text, width - indent):
        if row and len(row) + 1 + len(word) > width:
            rows.append(row)
            row = " " * indent + word
        else:
            row = f"{row} {word}" if row else word
    return "\n".join([*rows, row])


def _words(text: str, room: int) -> list[str]:
    """The pieces that may not be broken: words, and commands in backquotes with what is written against them."""
    parts = text.split("`")
    parts[1:-1:2] = [command.replace(" ", JOINED) for command in parts[1:-1:2]]
    found: list[str] = []
    for word in "`".join(parts).split(" "):
        found += [word.replace(JOINED, " ")] if len(word) <= room else word.split(JOINED)
    return found


def fitted(text: str, fd: int, indent: int = len(PREFIX)) -> str:
    """The text as it is to be written to this descriptor, a terminal or not."""
    try:
        return fold(text, os.get_terminal_size(fd).columns, indent)
    except (OSError, ValueError):
        return text
