"""Replay: whether a genuine stop is a new one. Pure; the wall clock is an argument.

A stop has an id and a date. Each id is obeyed once. The date must be near this robot's clock; ids whose date is past
that are forgotten, and the newest date that was forgotten is remembered: whatever is not newer is refused, wherever the
clock is set. So a stop that somebody recorded stops nothing again, after a restart neither.
"""

from __future__ import annotations

import json
import re

from failstop.api.words import span

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterable

NEW = "new"
AGAIN = "again"
MOST = 256
"""Ids that are remembered; a sender with the key who sends more in a tolerance pushes out the oldest."""
ID = re.compile(r"[0-9a-f]{16,64}")
UNKNOWN_S = 0.0


class Seen:
    """The stops that were obeyed."""

    def __init__(self, tolerance_s: float, ids: dict[str, float] | None = None, floor_s: float = UNKNOWN_S) -> None:
        """`ids`: their dates; `floor_s`: nothing dated so or earlier is new."""
        self._tolerance_s = tolerance_s
        self._ids = dict(ids or {})
        self._floor_s = floor_s

    def judge(self, stop_id: str, dated_s: float, now_s: float) -> str:
        """NEW, AGAIN (it was obeyed already), or why it is refused."""
        if stop_id in self._ids:
            return AGAIN
        off_s = dated_s - now_s
        # Not `abs(off_s) > tolerance`: a date that is no number is refused too.
        if not -self._tolerance_s <= off_s <= self._tolerance_s:
            side = "old by" if off_s < 0 else "ahead by"
            return f"dated {side} {span(abs(off_s))} on this robot's clock, and {self._tolerance_s:g} s are allowed"
        if dated_s <= self._floor_s:
            return "older than a stop that was obeyed already: this robot's clock was set back"
        return NEW

    def obeyed(self, stop_id: str, dated_s: float, now_s: float) -> None:
        """It was; or once more, with another date."""
        self._ids[stop_id] = max(dated_s, self._ids.get(stop_id, dated_s))
        gone = [known for known, date_s in self._ids.items() if date_s < now_s - self._tolerance_s]
        left = sorted((known for known in self._ids if known not in gone), key=lambda known: self._ids[known])
        self._forget([*gone, *left[: max(0, len(left) - MOST)]])

    def _forget(self, ids: Iterable[str]) -> None:
        for known in ids:
            self._floor_s = max(self._floor_s, self._ids.pop(known))

    def dump(self) -> bytes:
        """For the file that outlives a restart."""
        return json.dumps({"ids": self._ids, "floor_s": self._floor_s}).encode()

    @classmethod
    def load(cls, data: bytes, tolerance_s: float) -> Seen:
        """The inverse. Raises ValueError."""
        try:
            found = json.loads(data)
            ids = {str(known): float(date_s) for known, date_s in found["ids"].items()}
            return cls(tolerance_s, ids, float(found["floor_s"]))
        except (TypeError, KeyError, AttributeError, OverflowError, RecursionError) as error:
            raise ValueError(str(error)) from None
