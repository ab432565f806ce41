"""Style: colours for the terminal, and lines that are wrapped or cut to its width."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from itertools import groupby, pairwise
from operator import itemgetter
from unicodedata import combining, east_asian_width

from failstop.policy.setting import UNITS

Span = tuple[str, str]
"""A piece of text, and its role, which determines its colour."""
Line = list[Span]

OK = "ok"
WARN = "warn"
FAIL = "fail"
DIM = "dim"
STRONG = "strong"
PLAIN = ""

_COLOURS = {OK: "38;5;28", WARN: "38;5;166", FAIL: "1;38;5;160", DIM: "38;5;244", STRONG: "1"}
"""The colour of each role. The colours are from the 256-colour palette, which a terminal's theme does not change. Their
contrast is at least 3.8 on black and on white, so they can be read on both. In comparison, the yellow of a theme may
have a contrast of only 1.1 on white. A console with fewer colours shows the closest one."""
NO_TERMINAL_COLUMNS = 80
LEAST_COLUMNS = 20
_WHOLE = re.compile(r'`failstop run [^`]*/[^`]*`|^\{"[^ ]*\}')
"""Matches a text that must not be broken across lines, because people copy it. It is a command with a path, or a JSON
frame of the board."""
_UNIT = f"(?:{'|'.join(map(re.escape, sorted(UNITS)))})(?![\\w/])"
_WORD = re.compile(f"(?:`[^`]*`|pid [0-9]+|[0-9] {_UNIT}|[^ ])+ *| +")
"""Matches one word with the spaces after it. Some texts with spaces count as one word: a command in backquotes, a
number with its unit, and "pid" with its number."""
_BEFORE_UNIT = re.compile(f"(?<=[0-9]) (?={_UNIT})")
_NUMBER = re.compile(" *[0-9]+[.] +")
"""Matches the number in front of an item of a list, for example "2. "."""


def lives(environ: Mapping[str, str], *, terminal: bool) -> bool:
    """Return True if `terminal` is True and TERM names a terminal that understands escape sequences."""
    return terminal and environ.get("TERM", "dumb") not in ("", "dumb")


def codes(environ: Mapping[str, str], *, terminal: bool) -> dict[str, str]:
    """Return the escape code (SGR) of each role's colour. Empty if this terminal shows no colours."""
    return _COLOURS if lives(environ, terminal=terminal) and not environ.get("NO_COLOR") else {}


@cache
def _known() -> dict[str, str]:
    return codes(os.environ, terminal=sys.stdout.isatty())


def paint(text: str, role: str) -> str:
    """Return the text in the colour of its role. It is unchanged if standard output shows no colours."""
    code = _known().get(role)
    return f"\x1b[{code}m{text}\x1b[0m" if code and text else text


def width() -> int:
    """Return the width of the terminal in columns; 80 if there is no terminal."""
    try:
        return max(LEAST_COLUMNS, os.get_terminal_size(1).columns or NO_TERMINAL_COLUMNS)
    except OSError:
        return NO_TERMINAL_COLUMNS


def cells(text: str) -> int:
    """Return how many columns a printable text needs on a terminal."""
    if text.isascii():
        return len(text)
    return sum(0 if combining(c) else 2 if east_asian_width(c) in "WF" else 1 for c in text)


def cut(text: str, columns: int) -> str:
    """Cut a text to this many columns. If it is too long, the result ends with an ellipsis."""
    if cells(text) <= columns:
        return text
    while cells(text) >= max(1, columns):
        text = text[:-1]
    return f"{text}…" if columns > 0 else ""


def plain(line: Line) -> str:
    """Return the text of a line, without colours."""
    return "".join(text for text, _ in line)


def painted(line: Line, columns: int | None = None) -> str:
    """Return a line as text with colours, cut to `columns`. If `columns` is None, the line is not cut."""
    parts = []
    for text, role in line:
        if columns is not None:
            text = cut(text, columns)
            columns -= cells(text)
        parts.append(paint(text, role))
    return "".join(parts)


def show(lines: Iterable[Line]) -> None:
    """Print these lines. A character that standard output can't show becomes a question mark."""
    text = "".join(f"{painted(line)}\n" for line in lines)
    encoding = sys.stdout.encoding or "ascii"
    sys.stdout.write(text.encode(encoding, "replace").decode(encoding))


def warn(text: str, end: str = "\n") -> None:
    """Print paragraphs on standard error, at most 80 columns wide."""
    sys.stderr.write(paragraphs(text, min(NO_TERMINAL_COLUMNS, width())) + end)
    sys.stderr.flush()


def record(found: object) -> list[Line]:
    """Convert a value to JSON, for programs. A value that JSON can't represent becomes its repr(). In a dict, an entry
    whose key JSON can't represent is left out."""
    import json

    return [[(json.dumps(found, indent=2, default=repr, skipkeys=True), PLAIN)]]


def bound(text: str, space: str) -> str:
    """Replace the space between each number and its unit with `space`. This is a space at which another program does
    not break lines."""
    return _BEFORE_UNIT.sub(lambda _: space, text)


def wrap(line: Line, columns: int, indent: int) -> list[Line]:
    """Break a line at spaces, so that each part fits, and indent all parts after the first. A word is broken only if it
    is longer than a line."""
    text, roles = plain(line), [role for text, role in line for _ in text]
    starts, at, used = [0], 0, 0
    for piece in _pieces(text, columns - indent):
        if used + cells(piece.rstrip(" ")) > columns and at > starts[-1]:
            starts.append(at)
            used = indent
        at += len(piece)
        used += cells(piece)
    rows: list[Line] = []
    for start, end in pairwise([*starts, len(text)]):
        letters = zip(text[start:end].rstrip(" "), roles[start:end], strict=False)
        spans = [("".join(letter for letter, _ in span), role) for role, span in groupby(letters, itemgetter(1))]
        rows.append([(" " * indent, PLAIN), *spans] if rows else spans)
    return rows


def _pieces(text: str, room: int) -> Iterator[str]:
    """Split a text into pieces that must not be broken, each with the spaces after it. A piece is a word, or a command
    that fits into `room` columns. A longer command is split at its spaces, and a longer word into letters. A word that
    contains a match of _WHOLE is never split, because people copy it."""
    parts = re.compile(f".{{1,{max(1, room)}}}(?: +|$)|[^ ]+ *| +")
    for word in _WORD.findall(text):
        if _WHOLE.search(word):
            yield word
            continue
        for part in [word] if cells(word.rstrip(" ")) <= room else parts.findall(word):
            yield from [part] if cells(part.rstrip(" ")) <= room else part


def paragraphs(text: str, columns: int) -> str:
    """Wrap each line of a text. In a numbered list, the text of an item stays to the right of its number."""
    rows: list[Line] = []
    for line in text.split("\n"):
        number = _NUMBER.match(line)
        rows += wrap([(line, PLAIN)], columns, number.end() if number else 0)
    return "\n".join(map(plain, rows))


def table(rows: list[Line]) -> list[Line]:
    """Align the columns of a table, two spaces apart. A text that begins with a space is aligned to the right."""
    widths = [max(cells(text.strip()) for text, _ in column) for column in zip(*rows, strict=True)]
    found = []
    for row in rows:
        line: Line = []
        for (text, role), columns in zip(row, widths, strict=True):
            word = text.strip()
            pad = " " * (columns - cells(word))
            line.append((f"{pad}{word}  " if text.startswith(" ") else f"{word}{pad}  ", role))
        found.append([*line[:-1], (line[-1][0].rstrip(" "), line[-1][1])])
    return found


def fit(lines: list[Line], rows: int) -> list[Line]:
    """Return the lines that fit on the screen. If there are too many, empty lines are dropped first, and then the last
    lines. A line at the end says how many of the last lines were dropped."""
    empty = [number for number, line in enumerate(lines) if not line][: max(0, len(lines) - rows)]
    kept = [line for number, line in enumerate(lines) if number not in empty]
    if len(kept) > rows:
        hidden = len(kept) - rows + 1
        kept = [*kept[: rows - 1], [(f"({hidden} more lines: the window is too small)", DIM)]]
    return kept
