"""Said: what clients say of themselves in a line, for people: what they see, and what is wrong. Pure; nothing depends
on its truth."""

from __future__ import annotations

from failstop.procs.gate.remarks import Budget
from failstop.shm.packing import Note

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterable

    Row = tuple[int, int, str, int, str, str]
    """Session, slot, who, when it was said (CLOCK_MONOTONIC ns), what it sees, what is wrong (may be empty)."""


class Said:
    """The last words of each session."""

    __slots__ = ("_budget", "_rows")

    def __init__(self, now_ns: int) -> None:
        self._rows: dict[int, Row] = {}
        self._budget = Budget(now_ns)

    def follow(self, rows: Iterable[Row], now_ns: int) -> list[Note] | None:
        """The words of all sessions that said something; returns what people are told of, None when nothing has
        changed, not even when it was said."""
        before, self._rows = self._rows, {row[0]: row for row in rows}
        if before == self._rows:
            return None
        notes = [note for session, row in self._rows.items() if (note := _news(before.get(session), row))]
        notes += [_gone(row) for session, row in before.items() if session not in self._rows]
        return [note for note in notes if self._budget.spend(now_ns)]

    def table(self) -> list[tuple[int, int, str, str]]:
        """Slot, when, what it sees, what is wrong, of each."""
        return [(slot, t_ns, sees, wrong) for _, slot, _, t_ns, sees, wrong in self._rows.values()]


def _news(before: Row | None, row: Row) -> Note | None:
    _, _, who, _, sees, wrong = row
    if before and before[4:] == row[4:]:
        return None
    fields: dict[str, str | int | float] = {"who": who, "sees": sees, "wrong": wrong}
    if wrong and (before is None or before[5] != wrong):
        return Note("said", f"{who} says: {wrong}", fields, level="warning")
    return Note("said", f"{who} says: {sees}", fields)


def _gone(row: Row) -> Note:
    return Note("said", f"{row[2]} has gone", {"who": row[2], "sees": "", "wrong": ""})
