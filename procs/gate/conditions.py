"""Conditions that must be asserted again and again for motion: the obstacle sensor, interlocks, an operator. Pure;
every assertion comes with its time, by the clock of the process that asserts it."""

from __future__ import annotations

from failstop.messages.packing import Note
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.procs.loop import MS

AHEAD_NS = 20 * MS
"""How far in the future a record's time stamp may be, because it may be written after the turn that reads it began. A
stamp that is further ahead comes from another machine's clock, and would count for too long."""
NOBODY_ATTENDS = "nobody attends: press ATTEND on the page, or run `failstop attend`"
DEPARTED = "left"


def believed_ns(t_ns: int, now_ns: int) -> int:
    """The time that counts for a time stamp: never later than now. A stamp from too far in the future becomes 0, which
    is too old for any timeout."""
    return min(t_ns, now_ns) if t_ns <= now_ns + AHEAD_NS else 0


class ScanGate:
    """The obstacle sensor as a condition: commands of programs move the wheels only while the sensor delivers; commands
    by hand don't need it. A silent sensor latches nothing: when it delivers again, motion resumes by itself, from
    zero."""

    def __init__(self, timeout_ns: int, *, on: bool) -> None:
        self._timeout_ns = timeout_ns
        self.on = on
        self._blocks = False
        self.delivered_ns = 0
        """When the sensor last delivered; 0: never yet."""

    def deliver(self, t_ns: int, now_ns: int) -> None:
        self.delivered_ns = max(self.delivered_ns, believed_ns(t_ns, now_ns))

    def silent(self, now_ns: int) -> bool:
        """True if commands of programs must not move the wheels."""
        return self.on and (not self.delivered_ns or now_ns - self.delivered_ns > self._timeout_ns)

    def silent_ns(self) -> int:
        """When the last delivery becomes too old."""
        return self.delivered_ns + self._timeout_ns + 1

    def note(self, now_ns: int, *, blocks: bool) -> Note | None:
        """The note for people when the sensor's silence begins or ends to block the wheels, with the sensor's age; else
        None. While something else blocks the wheels, the sensor does not count as back."""
        if blocks == self._blocks or (not blocks and self.silent(now_ns)):
            return None
        self._blocks = blocks
        age_s = (now_ns - self.delivered_ns) * 1e-9 if self.delivered_ns else 0.0
        if not blocks:
            text = f"scan is back (age {age_s:.2f} s): motion resumes by itself"
            return Note("scan", text, {"state": "back", "age_s": age_s}, level="info")
        if not self.delivered_ns:
            return Note("scan", "no scan yet: programs can't move the wheels", {"state": "silent"})
        return Note(
            "scan", f"no scan for {age_s:.2f} s, so the wheels are told to stop", {"state": "silent", "age_s": age_s}
        )


class Interlocks:
    """Named conditions that clients assert. To enable motion all of them must hold; losing one disables motion."""

    def __init__(self, declared: dict[str, tuple[int, str]]) -> None:
        """`declared`: name -> (timeout in ns, the text of a refusal)."""
        self._declared = declared
        self._asserted_ns: dict[str, int] = {}

    def hear(self, names: list[str], t_ns: int, now_ns: int) -> None:
        """A client asserts these interlocks. Names that the settings don't declare are ignored."""
        for name in self._declared.keys() & names:
            self._asserted_ns[name] = max(self._asserted_ns.get(name, 0), believed_ns(t_ns, now_ns))

    def unmet(self, now_ns: int) -> str:
        """The text of the first interlock that does not hold; empty if all hold."""
        for name, (timeout_ns, refusal) in self._declared.items():
            asserted_ns = self._asserted_ns.get(name)
            if asserted_ns is None or now_ns - asserted_ns > timeout_ns:
                return refusal
        return ""


class Attendance:
    """The operators who are present, if motion needs one (attend.required), by the session that reports them. What
    counts is the moment at which an operator's device proves to have been there, not when the proof arrives."""

    def __init__(self, lease_ns: int, *, on: bool) -> None:
        self.on = on
        self._lease_ns = lease_ns
        self._there: dict[int, tuple[int, str]] = {}
        self._last = ("", DEPARTED)
        """The last operator, and how that operator's presence has ended."""

    def hear(self, session: int, who: str, t_ns: int, now_ns: int) -> None:
        """Record that an operator was present at `t_ns`. A proof that is older than this operator's last one, or older
        than the lease, renews nothing. A session reports one operator at a time: if it names another, the one before
        has left."""
        known_ns, known = self._there.get(session, (0, who))
        proven_ns = believed_ns(t_ns, now_ns)
        if self.on and (known != who or proven_ns > known_ns) and now_ns - proven_ns <= self._lease_ns:
            self._there[session] = proven_ns, who
        elif known != who:
            self.leave(session)

    def leave(self, session: int) -> None:
        """The operator of that session has left, because the session says so or has died."""
        if found := self._there.pop(session, None):
            self._last = found[1], DEPARTED

    def names(self, now_ns: int) -> list[str]:
        """The operators who are present. The others are forgotten."""
        for session, (proven_ns, who) in tuple(self._there.items()):
            if now_ns - proven_ns > self._lease_ns:
                del self._there[session]
                self._last = who, f"was not heard for {(now_ns - proven_ns) // MS} ms"
        return [who for _, who in self._there.values()]

    def due_ns(self) -> int:
        """When the last operator no longer counts as present, if nothing more is heard."""
        return max((proven_ns for proven_ns, _ in self._there.values()), default=0) + self._lease_ns + 1

    def unmet(self, now_ns: int) -> str:
        """Why motion can't be enabled without an operator; empty if it can."""
        return NOBODY_ATTENDS if self.on and not self.names(now_ns) else ""

    def gone(self, now_ns: int) -> Cause | None:
        return causes.OPERATOR_GONE(*self._last) if self.unmet(now_ns) else None
