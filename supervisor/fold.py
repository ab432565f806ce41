"""Fold: a line for people, broken at words to fit a terminal. A pipe and the journal get it whole: one event, one line.

The supervisor uses this too, so it imports nothing that costs.
"""

from __future__ import annotations

import os

LEAST_COLUMNS = 40
"""Below this a hanging indent leaves too little."""
PREFIX = "failstop: "
"""What the lines of the service and the errors of the commands begin with."""


def columns(fd: int) -> int:
    """Columns of the terminal that a descriptor is; 0 when it is none."""
    try:
        return os.get_terminal_size(fd).columns
    except (OSError, ValueError):
        return 0


def fold(text: str, width: int, indent: int) -> str:
    """The text with line breaks, no line longer than `width` columns, those after the first indented. A command in
    backquotes stays whole where it fits; a single word that is longer than a line is left to the terminal."""
    if len(text) <= width or width < LEAST_COLUMNS:
        return text
    rows, row = [], ""
    room = width - indent
    for word in _words(text, room):
        if row and len(row) + 1 + len(word) > width:
            rows.append(row)
            row = " " * indent + word
        else:
            row = f"{row} {word}" if row else word
    return "\n".join([*rows, row])


def _words(text: str, room: int) -> list[str]:
    """What may not be broken: words, and commands in backquotes with what is written against them."""
    found: list[str] = []
    quoted: list[str] = []
    for word in text.split(" "):
        quoted.append(word)
        if sum(part.count("`") for part in quoted) % 2 == 0:
            whole = " ".join(quoted)
            found += [whole] if len(whole) <= room else quoted
            quoted = []
    return found + quoted


def fitted(text: str, fd: int, indent: int = len(PREFIX)) -> str:
    """The text as it is to be written to this descriptor."""
    width = columns(fd)
    return fold(text, width, indent) if width else text
