"""Conditions for motion, which clients must confirm again and again: the obstacle sensor, interlocks, and an operator's
presence. Pure. Each confirmation has a time, from the clock of its sender."""

from __future__ import annotations

from failstop.messages.packing import Note
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.procs.loop import MS

AHEAD_NS = 20 * MS
"""How far in the future a time stamp may be. The gate takes the time once per turn of its loop, so a record that was
written during the turn is a little in the future. A stamp that is further in the future comes from another machine's
clock. Its confirmation would count for too long."""
NOBODY_ATTENDS = "nobody attends: press ATTEND on the page, or run `failstop attend`"
DEPARTED = "left"


def believed_ns(t_ns: int, now_ns: int) -> int:
    """Return the time that counts for the time stamp `t_ns`. A time in the future counts as now. If it is more than
    AHEAD_NS in the future, it counts as 0, which is too old for any timeout."""
    return min(t_ns, now_ns) if t_ns <= now_ns + AHEAD_NS else 0


class ScanGate:
    """Lets programs move the wheels only while the obstacle sensor delivers scans. People who drive by hand don't need
    the sensor. If it falls silent, the wheels stop, but nothing is latched. When scans come again, the wheels start
    again from zero by themselves."""

    def __init__(self, timeout_ns: int, *, on: bool) -> None:
        self._timeout_ns = timeout_ns
        self.on = on
        self._blocks = False
        self.delivered_ns = 0
        """The time when the sensor last delivered a scan, or 0 if it has not yet."""

    def deliver(self, t_ns: int, now_ns: int) -> None:
        self.delivered_ns = max(self.delivered_ns, believed_ns(t_ns, now_ns))

    def stand_still(self) -> None:
        """Record that motion was disabled or stopped. It does not resume by itself, so the sensor is not reported as
        back."""
        self._blocks = False

    def silent(self, now_ns: int) -> bool:
        """Return True if the sensor is silent, so programs must not move the wheels."""
        return self.on and (not self.delivered_ns or now_ns - self.delivered_ns > self._timeout_ns)

    def silent_ns(self) -> int:
        """Return the time when the last scan will become too old."""
        return self.delivered_ns + self._timeout_ns + 1

    def note(self, now_ns: int, *, blocks: bool) -> Note | None:
        """Return a note for people if the sensor's silence has just begun to block the wheels, or if the sensor is
        back. Otherwise return None. `blocks`: True if the reason why the wheels are blocked is this silence. If the
        reason has changed, but the sensor is still silent, the sensor is not reported as back."""
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
    """Checks the named conditions that clients confirm. All of them must hold before motion can be enabled, and losing
    one disables motion."""

    def __init__(self, declared: dict[str, tuple[int, str]]) -> None:
        """`declared`: for each interlock's name, its timeout in ns and the text of a refusal."""
        self._declared = declared
        self._asserted_ns: dict[str, int] = {}

    def hear(self, names: list[str], t_ns: int, now_ns: int) -> None:
        """Record that a client has confirmed these interlocks. Names that are not in the settings are ignored."""
        for name in self._declared.keys() & names:
            self._asserted_ns[name] = max(self._asserted_ns.get(name, 0), believed_ns(t_ns, now_ns))

    def unmet(self, now_ns: int) -> str:
        """Return the refusal text of the first interlock that does not hold, or an empty text if all hold."""
        for name, (timeout_ns, refusal) in self._declared.items():
            asserted_ns = self._asserted_ns.get(name)
            if asserted_ns is None or now_ns - asserted_ns > timeout_ns:
                return refusal
        return ""


class Attendance:
    """Records which operators are present, if motion needs an operator (attend.required). Each session reports one
    operator. A proof of presence counts from the time when the operator's device made it."""

    def __init__(self, lease_ns: int, *, on: bool) -> None:
        self.on = on
        self._lease_ns = lease_ns
        self._there: dict[int, tuple[int, str]] = {}
        self._last = ("", DEPARTED)
        """The operator whose presence ended last, and how it ended."""

    def hear(self, session: int, who: str, t_ns: int, now_ns: int) -> None:
        """Record that an operator was present at `t_ns`. This proof is ignored if it is older than the lease, or not
        newer than the operator's last proof. If the session names a new operator, its previous operator has left in any
        case."""
        known_ns, known = self._there.get(session, (0, who))
        proven_ns = believed_ns(t_ns, now_ns)
        if self.on and (known != who or proven_ns > known_ns) and now_ns - proven_ns <= self._lease_ns:
            self._there[session] = proven_ns, who
        elif known != who:
            self.leave(session)

    def leave(self, session: int) -> None:
        """Record that the operator of this session has left, because the session says so or has died."""
        if found := self._there.pop(session, None):
            self._last = found[1], DEPARTED

    def names(self, now_ns: int) -> list[str]:
        """Return the operators who are present. Removes each operator whose last proof is older than the lease."""
        for session, (proven_ns, who) in tuple(self._there.items()):
            if now_ns - proven_ns > self._lease_ns:
                del self._there[session]
                self._last = who, f"was not heard for {(now_ns - proven_ns) // MS} ms"
        return [who for _, who in self._there.values()]

    def due_ns(self) -> int:
        """Return the time from which no operator counts as present, unless a new proof arrives before that time."""
        return max((proven_ns for proven_ns, _ in self._there.values()), default=0) + self._lease_ns + 1

    def unmet(self, now_ns: int) -> str:
        """Return the refusal text if no operator is present although motion needs one, otherwise an empty text."""
        return NOBODY_ATTENDS if self.on and not self.names(now_ns) else ""

    def gone(self, now_ns: int) -> Cause | None:
        return causes.OPERATOR_GONE(*self._last) if self.unmet(now_ns) else None
