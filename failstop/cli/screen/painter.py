"""Painter: from one screenful to the next, only the lines that differ. Pure."""

from __future__ import annotations

CLEAR = "\x1b[H\x1b[2J"


class Painter:
    """What the screen shows now, line by line."""

    __slots__ = ("_shown",)

    def __init__(self) -> None:
        self._shown: list[str] | None = None

    def forget(self) -> None:
        """The screen may show anything: the next update begins with an empty one."""
        self._shown = None

    def update(self, rows: list[str]) -> str:
        """What to write so that the screen shows these rows, from its top; they must fit."""
        parts = []
        if self._shown is None:
            parts.append(CLEAR)
            self._shown = []
        for number, row in enumerate(rows):
            if number >= len(self._shown) or self._shown[number] != row:
                parts.append(f"\x1b[{number + 1};1H{row}\x1b[K")
        if len(rows) < len(self._shown):
            parts.append(f"\x1b[{len(rows) + 1};1H\x1b[J")
        self._shown = list(rows)
        return "".join(parts)
