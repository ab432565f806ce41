"""Attendance: the operators who are there, where motion needs one (setting attend.required). Pure.

An operator's device proves again and again that it was there at some moment; what counts is that moment, by this
machine's clock, and not when the proof came.
"""

from __future__ import annotations

from failstop.policy import causes
from failstop.procs.gate.stamps import believed_ns

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.policy.causes import Cause

NOBODY = "nobody attends: press ATTEND on the page, or run `failstop attend`"
LEFT = "left"
MS = 1_000_000


class Attendance:
    """Who was there last, and when, by the session that says so."""

    __slots__ = ("_last", "_lease_ns", "_there", "on")

    def __init__(self, lease_ns: int, *, on: bool) -> None:
        self.on = on
        self._lease_ns = lease_ns
        self._there: dict[int, tuple[int, str]] = {}
        self._last = ("", LEFT)
        """Who was there last, and how that ended."""

    def hear(self, session: int, who: str, t_ns: int, now_ns: int) -> None:
        """An operator was there at `t_ns`; a proof that is older than the last one, or than the lease, changes nothing,
        and a stamp from the future is none."""
        proven_ns = believed_ns(t_ns, now_ns)
        if self.on and max(self._there.get(session, (0, ""))[0], now_ns - self._lease_ns - 1) < proven_ns:
            self._there[session] = proven_ns, who

    def leave(self, session: int) -> None:
        """That session's operator is there no more, by its own word or by its death."""
        if found := self._there.pop(session, None):
            self._last = found[1], LEFT

    def names(self, now_ns: int) -> list[str]:
        """Who is there now; who is not any more is forgotten."""
        for session, (proven_ns, who) in tuple(self._there.items()):
            if now_ns - proven_ns > self._lease_ns:
                del self._there[session]
                self._last = who, f"was not heard for {(now_ns - proven_ns) // MS} ms"
        return [who for _, who in self._there.values()]

    def due_ns(self) -> int:
        """When the last of them counts no more, if nothing is heard."""
        return max((proven_ns for proven_ns, _ in self._there.values()), default=0) + self._lease_ns + 1

    def unmet(self, now_ns: int) -> str:
        """Why motion may not be enabled; empty when it may."""
        return NOBODY if self.on and not self.names(now_ns) else ""

    def gone(self, now_ns: int) -> Cause | None:
        """Why motion may not go on."""
        return causes.OPERATOR_GONE(*self._last) if self.on and not self.names(now_ns) else None
