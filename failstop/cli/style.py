"""Style: colours by role, and lines of coloured pieces that are cut to the terminal's width."""

from __future__ import annotations

import os
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    Span = tuple[str, str]
    """A piece of text and its role."""
    Line = list[Span]

OK = "ok"
WARN = "warn"
FAIL = "fail"
DIM = "dim"
STRONG = "strong"
PLAIN = ""

PALETTE = {OK: 28, WARN: 166, FAIL: 160, DIM: 244}
"""Of the 256 colours, which terminals show alike whatever their theme: each is legible on black and on white (contrast
of at least 3.8; a theme's own yellow is 1.1 on white)."""
_FINE = {OK: "38;5;28", WARN: "38;5;166", FAIL: "1;38;5;160", DIM: "38;5;244", STRONG: "1"}
_COARSE = {OK: "32", WARN: "35", FAIL: "1;31", DIM: "", STRONG: "1"}
"""For terminals with 8 or 16 colours, which belong to the theme: neither yellow nor grey can be relied on there."""
NO_TERMINAL_COLUMNS = 80
LEAST_COLUMNS = 20
RESET = "\x1b[0m"


def codes(environ: Mapping[str, str], *, terminal: bool) -> dict[str, str]:
    """What each role is on this terminal, as the parameters of an SGR sequence; empty: no colours at all."""
    term = environ.get("TERM", "")
    if not terminal or environ.get("NO_COLOR") or term in ("", "dumb"):
        return {}
    fine = "256" in term or environ.get("COLORTERM") or "kitty" in term or "alacritty" in term or "direct" in term
    return _FINE if fine else _COARSE


_codes: dict[str, str] | None = None


def _known() -> dict[str, str]:
    global _codes
    if _codes is None:
        _codes = codes(os.environ, terminal=sys.stdout.isatty())
    return _codes


def paint(text: str, role: str) -> str:
    """The text in the colour of its role, if standard output is a terminal that shows colours."""
    code = _known().get(role)
    return f"\x1b[{code}m{text}{RESET}" if code and text else text


def width() -> int:
    """Columns of the terminal; 80 where there is none."""
    try:
        columns = os.get_terminal_size(1).columns
    except (OSError, ValueError):
        columns = 0
    return max(LEAST_COLUMNS, columns) if columns else NO_TERMINAL_COLUMNS


def fancy() -> bool:
    """True when standard output takes characters beyond ASCII."""
    return (sys.stdout.encoding or "").lower().replace("-", "") == "utf8"


def cells(text: str) -> int:
    """Columns that a printable text takes on a terminal."""
    if text.isascii():
        return len(text)
    from unicodedata import combining, east_asian_width

    return sum(0 if combining(c) else 2 if east_asian_width(c) in "WF" else 1 for c in text)


def cut(text: str, columns: int) -> str:
    """As much of it as fits into so many columns; what was cut ends in an ellipsis."""
    if cells(text) <= columns:
        return text
    return f"{text[: _fitting(text, columns - 1)]}…" if columns > 0 else ""


def _fitting(text: str, columns: int) -> int:
    """How many characters of the text fit."""
    count = min(len(text), max(0, columns))
    while cells(text[:count]) > max(0, columns):
        count -= 1
    return count


def plain(line: Line) -> str:
    """The text alone."""
    return "".join(text for text, _ in line)


def painted(line: Line, columns: int | None = None) -> str:
    """One line for the terminal, cut to `columns` (None: as long as it is)."""
    parts = []
    left = columns
    for text, role in line:
        if left is not None:
            text = cut(text, left)
            left -= cells(text)
        parts.append(paint(text, role))
    return "".join(parts)


def show(lines: Iterable[Line]) -> None:
    """Print them. What standard output can't take is shown as question marks."""
    text = "".join(f"{painted(line)}\n" for line in lines)
    encoding = sys.stdout.encoding or "ascii"
    sys.stdout.write(text.encode(encoding, "replace").decode(encoding))


def wrap(line: Line, columns: int, indent: int) -> list[Line]:
    """Break a line at spaces so that each part fits, those after the first indented. A word that is longer than a line
    is broken where it must be."""
    rows: list[Line] = [[]]
    at = 0
    for word in _words(line):
        if at > indent and at + cells(plain(word).rstrip(" ")) > columns:
            rows.append([(" " * indent, PLAIN)])
            at = indent
        for piece, role in word:
            left = piece
            while at + cells(left.rstrip(" ")) > columns:
                head = left[: _fitting(left, columns - at) or int(at <= indent)]
                head = head[: head.rfind(" ") + 1] or head  # a command that is longer than a line
                rows[-1].append((head, role))
                rows.append([(" " * indent, PLAIN)])
                at, left = indent, left[len(head) :]
            rows[-1].append((left, role))
            at += cells(left)
    return [_trimmed(row) for row in rows]


def _words(line: Line) -> Iterable[Line]:
    """The words of a line, each with the spaces after it: what is written without a space between, in whatever roles.
    A command in backquotes is not broken; a process id stays with its word."""
    word: Line = []
    for text, role in line:
        if text.startswith("`"):
            word.append((text, role))
            continue
        start = 0
        for end in range(1, len(text) + 1):
            if text[end - 1] == " " and (end == len(text) or text[end] != " ") and text[end - 4 : end] != "pid ":
                yield [*word, (text[start:end], role)]
                word, start = [], end
        if start < len(text):
            word.append((text[start:], role))
    if word:
        yield word


def _trimmed(row: Line) -> Line:
    """Without spaces at the end; neighbours of one role are joined."""
    joined: Line = []
    for text, role in row:
        if joined and joined[-1][1] == role:
            joined[-1] = (joined[-1][0] + text, role)
        else:
            joined.append((text, role))
    if joined:
        joined[-1] = (joined[-1][0].rstrip(" "), joined[-1][1])
    return joined


def table(rows: list[Line]) -> list[Line]:
    """The rows with their columns aligned, two spaces apart; a text that begins with a space is set to the right."""
    widths = [max(cells(row[i][0].strip()) for row in rows) for i in range(len(rows[0]))]
    found = []
    for row in rows:
        line: Line = []
        for (text, role), columns in zip(row, widths, strict=True):
            word = text.strip()
            pad = " " * (columns - cells(word))
            shown = [(pad, PLAIN), (word, role)] if text.startswith(" ") else [(word, role), (pad, PLAIN)]
            line += [*shown, ("  ", PLAIN)]
        found.append(_trimmed(line))
    return found
