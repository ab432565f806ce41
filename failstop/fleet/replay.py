"""Replay: tells a new fleet stop from an old one that somebody recorded and sends again. Pure, because the time is an
argument.

A stop has an id and a date. A robot obeys a stop only if its id is new and its date is close to the robot's clock. When
the date of an obeyed stop has become too old to be accepted, the robot forgets the stop's id. The robot keeps the
newest date of all forgotten stops, and refuses every stop that is not newer. While the file of obeyed stops is kept, a
recorded stop never works again, even after a restart or with a clock that was set back.
"""

from __future__ import annotations

import json
import re

from failstop.api.words import span
from failstop.fleet.message import LATEST_S

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterable

NEW = "new"
AGAIN = "again"
MOST = 256
"""How many ids are remembered. If more stops arrive within the tolerance, the oldest ids are forgotten first."""
ID = re.compile(r"[0-9a-f]{16,64}")
UNKNOWN_S = 0.0


class Seen:
    """Remembers the stops that were obeyed, and judges new ones."""

    def __init__(self, tolerance_s: float, ids: dict[str, float] | None = None, floor_s: float = UNKNOWN_S) -> None:
        """`tolerance_s`: how far a stop's date may differ from this robot's clock, s. `ids`: the date of each obeyed
        stop, by id. `floor_s`: see below. Dates are Unix time, s."""
        self._tolerance_s = tolerance_s
        self._ids = dict(ids or {})
        self.floor_s = floor_s
        """Stops that are not newer than this are refused. It is in the future if this robot's clock was ahead when it
        obeyed a stop, and was set back since."""

    def judge(self, stop_id: str, dated_s: float, now_s: float) -> str:
        """Judge a stop. Returns NEW if it must be obeyed, AGAIN if it was obeyed already, or the reason to refuse
        it."""
        if stop_id in self._ids:
            return AGAIN
        off_s = dated_s - now_s
        # Not `abs(off_s) > tolerance`, because this form also refuses a date that is NaN.
        if not -self._tolerance_s <= off_s <= self._tolerance_s:
            side = "old by" if off_s < 0 else "ahead by"
            return f"dated {side} {span(abs(off_s))} on this robot's clock, and {self._tolerance_s:g} s are allowed"
        if dated_s <= self.floor_s:
            return "older than a stop that was obeyed already: this robot's clock was set back"
        return NEW

    def repeated(self, stop_id: str, dated_s: float, now_s: float) -> bool:
        """Return True if this is a later sending of a stop that was obeyed already. The sender signs each sending with
        a new date, so a recorded message is not newer than the one that was obeyed, or it is soon too old."""
        known_s = self._ids.get(stop_id)
        return known_s is not None and dated_s > known_s and abs(dated_s - now_s) <= self._tolerance_s

    def obeyed(self, stop_id: str, dated_s: float, now_s: float) -> None:
        """Note that a stop was obeyed. If its id was noted before, the newer date counts."""
        self._ids[stop_id] = max(dated_s, self._ids.get(stop_id, dated_s))
        gone = [known for known, date_s in self._ids.items() if date_s < now_s - self._tolerance_s]
        left = sorted((known for known in self._ids if known not in gone), key=lambda known: self._ids[known])
        self._forget([*gone, *left[: max(0, len(left) - MOST)]])

    def _forget(self, ids: Iterable[str]) -> None:
        for known in ids:
            self.floor_s = max(self.floor_s, self._ids.pop(known))

    def dump(self) -> bytes:
        """Return the content of the file that keeps the obeyed stops over a restart."""
        return json.dumps({"ids": self._ids, "floor_s": self.floor_s}).encode()

    @classmethod
    def load(cls, data: bytes, tolerance_s: float) -> Seen:
        """Read what dump() has written. Raises ValueError."""
        try:
            found = json.loads(data)
            ids = {str(known): float(date_s) for known, date_s in found["ids"].items()}
            floor_s = float(found["floor_s"])
            if not all(0.0 <= date_s <= LATEST_S for date_s in (*ids.values(), floor_s)):
                raise ValueError("a date is out of range")
            return cls(tolerance_s, ids, floor_s)
        except (TypeError, KeyError, AttributeError, OverflowError, RecursionError) as error:
            raise ValueError(str(error)) from None
