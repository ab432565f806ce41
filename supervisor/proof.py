"""The proof of a stop (what can be known about it once it was answered) and the link (what the board's answers prove).
Pure.

    acknowledged   the board answered a ping that was written after it, or reports that it obeys zeros
    observed       the IMU, or the board's reports of its wheels, say that they are still (unstill: they are not)
    logged         nothing more will be known about it, so the outcome is logged

Levels of proof are kept apart everywhere, because the board may be silent while the IMU sees the wheels come to rest.
"""

from __future__ import annotations

from failstop.board.interface import BY_IMU
from failstop.policy.proofs import (
    ACKNOWLEDGED_BY,
    LINK_ALIVE,
    LINK_DEAF,
    LINK_SILENT,
    LINK_UNASKED,
    LINK_UNHEARD,
    LINK_UNPROVEN,
    NO_IMU,
    NOT_SENT,
    UNMOVED,
    heard_late,
    wheels_seen,
)
from failstop.procs.starved import LONGEST_NS
from failstop.supervisor.stops import Stop

# The wheels after a stop, as the IMU sees them.
WHEELS_UNKNOWN = "unknown"
WHEELS_UNSTILL = "unstill"  # they should be still and are not, and have not been seen still since the stop
WHEELS_STILL = "still"
PONG_NS = 20_000_000
"""A ping younger than this may still be answered; a stop's ping and the next one are further apart (schedule.py)."""
ACKNOWLEDGE_NS = 1_500_000_000
"""A stop that the board has not acknowledged by then is logged as unacknowledged."""
JUDGED_AFTER_NS = 800_000_000
"""The IMU's verdict counts for a stop only if it was made this long after the cause, which is longer than a window of
the judgement plus its hold (procs/telemetry/still.py)."""
JUDGED_WITHIN_NS = 500_000_000
"""A verdict that is older than this does not count, because the IMU or telemetry is silent."""
LEAST_NS = 1_000_000
"""The shortest time to rest that is shown, because 0 means that the wheels were already at rest."""
HEEDS_NS = 200_000_000
"""If the board still reports zero this long after it should have reported that it obeys motion, it does not receive
anything."""
LATE_LOOK_NS = 200_000_000
"""If the supervisor was held up and first looks at the IMU's verdict this long after the cause, it may have missed that
the wheels were moving."""


class Proof:
    """The proof of one stop that was answered. Times are CLOCK_MONOTONIC in ns."""

    def __init__(self, stop: Stop, after_ns: int, now_ns: int, unix_s: float, by: tuple[str, str]) -> None:
        """`after_ns`: how long the wheels may take to be still; `unix_s`: the wall clock now. If now is long after the
        cause, board and wheels have the usual time from now on. `by`: what acknowledges and what observes the stop
        (interface.py)."""
        self.stop = stop
        self._by = by
        self.unix_s = unix_s - (now_ns - stop.t_ns) / 1e9
        """The wall clock when the cause was noticed, for people (Unix time, s)."""
        self.acknowledged_ns: int | None = None
        """The time from the cause to the board's answer, ns."""
        self.observed_ns: int | None = None
        """The time from the cause until the wheels were still, ns. 0: the IMU had not felt them moving before the stop
        either."""
        self.wheels = WHEELS_UNKNOWN
        self.held = False
        """True if the kernel still held the bytes of the stop when the stop was logged, because the board takes
        none."""
        self.believed = True
        """False until the device to which its bytes were written has answered as the board does."""
        self.logged = False
        """True once everything that can be known about the stop was logged."""
        self._was_still = True
        self._looked_ns = 0
        self._after_ns = after_ns
        self._again_ns = stop.t_ns + after_ns
        self._since_ns = now_ns
        """From this time on the board's answers and its obedience count."""

    def written_at_last(self, written_ns: int, by: str) -> None:
        """Record when the stop was written, if it had to wait for the port to come back."""
        self.stop.written_ns, self.stop.by = written_ns, by
        self.logged = False
        self._since_ns = written_ns
        self._again_ns = written_ns + self._after_ns

    def ponged(self, sent_ns: int, arrival_ns: int) -> bool:
        """Record that a ping was answered; True when this acknowledges the stop."""
        if self.acknowledged_ns is not None or sent_ns < self.stop.written_ns or not self.stop.written_ns:
            return False
        self.acknowledged_ns = arrival_ns - self.stop.t_ns
        return True

    def judged(self, still_ns: int, judged_ns: int, now_ns: int) -> bool:
        """Record the IMU's verdict: since when the wheels are still (0: they move), judged at `judged_ns` (0: never
        yet). Returns True when the wheels still move although the time for that is over, and again each time as much
        time has passed: the stop must then be written again."""
        self._looked_ns = self._looked_ns or now_ns
        if not self._by[1] or self.observed_ns is not None or now_ns - judged_ns > JUDGED_WITHIN_NS:
            return False
        # The board's reports are about one moment, not a window: wheels that came to rest after the cause were turning.
        late = self._by[1] != BY_IMU or self._looked_ns - self.stop.t_ns > LATE_LOOK_NS
        if not still_ns:
            self._was_still = False
            if now_ns >= self._again_ns:
                self._again_ns = now_ns + self._after_ns
                self.wheels = WHEELS_UNSTILL
                return True
        elif not self._was_still or (late and still_ns > self.stop.t_ns):
            # A window may begin before the cause: the wheels were turning then.
            self.observed_ns = max(LEAST_NS, still_ns - self.stop.t_ns)
        elif judged_ns - self.stop.t_ns >= JUDGED_AFTER_NS:
            self.observed_ns = 0
        self.wheels = self.wheels if self.observed_ns is None else WHEELS_STILL
        return False

    def complete(self, now_ns: int) -> bool:
        """True, once, when nothing more will be known about the stop, so that it is time to log the outcome."""
        age_ns = now_ns - self._since_ns
        if self.acknowledged_ns is None and age_ns < ACKNOWLEDGE_NS:
            return False
        seen = self.observed_ns is not None or self.wheels == WHEELS_UNSTILL or not self._by[1]
        if not seen and age_ns < self._after_ns + JUDGED_WITHIN_NS:
            return False
        self.logged, before = True, self.logged
        return not before

    def outcome(self, link: str) -> str:
        """The outcome for the journal. `link`: the state of the link."""
        late = heard_late(self.stop.cause.named().get("process"))
        if self.acknowledged_ns:
            heard = f"acknowledged by {ACKNOWLEDGED_BY[self._by[0]]} after {self.acknowledged_ns / 1e6:.1f} ms{late}"
        else:
            unheard = UNMOVED if link == LINK_UNASKED and self._by[0] else f"not acknowledged (link {link})"
            heard = f"handed over, {NOT_SENT}" if self.held else unheard
        if self.observed_ns is None:
            unstill = "wheels NOT seen still" if self.wheels == WHEELS_UNSTILL else "not observed"
            seen = unstill if self._by[1] else NO_IMU
        else:
            seen = wheels_seen(self.observed_ns / 1e9, self._by[1]) + late * (self.observed_ns > 0)
        return f"{self.stop.cause}: {heard}, {seen}"

    def fields(self, link: str) -> dict[str, str | float | None]:
        return {
            **self.stop.fields(),
            "epoch": self.stop.epoch,
            "link": link,
            "sent": not self.held,
            **self._proofs(),
            "wheels": self.wheels,
        }

    def as_record(self) -> dict[str, object]:
        """The stop as clients see it."""
        return {
            "cause": self.stop.cause.pack(),
            "latched": (self.stop.behind or self.stop).cause.pack(),
            "noticed_by": self.stop.noticed_by,
            "noticed_ns": self.stop.t_ns,
            "written_by": self.stop.by,
            "t": self.unix_s,
            "epoch": self.stop.epoch,
            "sent": not self.held or self.acknowledged_ns is not None,
            "believed": self.believed or self.acknowledged_ns is not None,
            "written_us": max(0, self.stop.written_ns - self.stop.t_ns) / 1e3 if self.stop.written_ns else None,
            **self._proofs(),
        }

    def _proofs(self) -> dict[str, str | float | None]:
        return {
            "acknowledged_us": None if self.acknowledged_ns is None else self.acknowledged_ns / 1e3,
            "acknowledged_by": self._by[0],
            "observed_ms": None if self.observed_ns is None else self.observed_ns / 1e6,
            "observed_by": self._by[1],
        }


class Link:
    """Link: whether the board at one opened port hears what is written to it, and whether it still says anything. Pure.

    unproven   it has never answered a ping since the port was opened: nothing is known, nothing is stopped for
    alive      it answers
    deaf       it has answered before and answers no more, or it reports that it obeys zero while motion is written
    silent     it has reported before, and now it says nothing at all: it has no power, its program has ended, or the
               wire from it is broken. From here these look the same, and nobody knows whether it hears
    unheard    the port was lost, and the device that is there now has not answered: it may be another one
    unasked    it has no ping, so that it can answer none: nothing is known, and nothing is waited for

    Unheard is for a board that was heard before the loss, and for a device that may not be the board (finder.py).
    A board can go deaf while its telemetry goes on, so what it reports never proves that it hears.
    """

    def __init__(self, deaf_ns: int, *, asked: bool = True, echo_ns: int = 0) -> None:
        """`asked`: the board has pings. `echo_ns`: how soon at the latest the board reports that it obeys a command
        that was written; 0: it reports none."""
        self._deaf_ns = deaf_ns
        self._asked = asked
        self._heeds_ns = echo_ns + HEEDS_NS if echo_ns else 0
        self._first = LINK_UNPROVEN if asked else LINK_UNASKED
        self._answers = self._first
        """The state of the link according to the board's answers and its echo alone."""
        self._silent = self._by_echo = False
        self._heard = False
        """True if the board has answered in this run. For a board that can't be asked: if it has reported."""
        self._opened_ns = self._listened_ns = 0
        self._held_up_ns = self._unheard_ns = 0
        """When the machine last held up a process that asks, listens or judges; 0: never."""
        self._true_ns = 0
        """When the newest ping was sent that the whole board has answered, or when the port was opened."""
        self._said_ns = self._patience_ns = 0
        """When the board last sent anything (0: nothing since the port was opened), and how long it may pause."""
        self._answered_ns = 0
        """When the newest ping was sent that has an answer."""
        self._asked_ns = 0
        """When the oldest ping after it was sent; 0: none yet."""
        self._missed = False

    @property
    def state(self) -> str:
        """The state of the link, as one of the words above."""
        return LINK_SILENT if self._silent else self._answers

    @property
    def believed(self) -> bool:
        """False until the device at the port has shown that it is the board."""
        return self._answers not in (LINK_UNPROVEN, LINK_UNHEARD)

    @property
    def forbids(self) -> bool:
        """True if motion must not be enabled: the board was heard in this run and is not heard now. A device that was
        never heard is allowed, because some boards say nothing by design. After an echo of zeros a stop is latched, and
        after its reset only the next motion shows whether the board hears again."""
        known = self._answers == LINK_DEAF and not self._by_echo
        return known or self.state == LINK_SILENT or (self.state == LINK_UNHEARD and self._heard)

    def opened(self, now_ns: int, *, sure: bool = True) -> None:
        """Begin again with another port: nothing is known about the device there. `sure`: it is known to be the
        board."""
        self._answers = self._first if sure and not self._heard else LINK_UNHEARD
        self._opened_ns = self._answered_ns = self._listened_ns = self._true_ns = now_ns
        self._asked_ns = self._said_ns = 0
        self._missed = self._silent = self._by_echo = False

    def listen(self, newest_ping_ns: int, now_ns: int = 0) -> None:
        """Nobody could hear an answer until now, so a silence counts from now on at the earliest, or from the next
        ping."""
        self._asked_ns = 0
        self._answered_ns = max(self._answered_ns, newest_ping_ns)
        self._listened_ns = max(self._listened_ns, now_ns)

    def answered_in_part(self, newest_ping_ns: int, now_ns: int) -> None:
        """Record that one of the board's parts does not answer, so no question is answered as a whole. The board does
        not count as deaf while its other parts answer."""
        if now_ns - self._said_ns < self._deaf_ns:
            self.listen(newest_ping_ns)

    def held_up(self, now_ns: int) -> None:
        """Record that the machine does not run a process that asks, listens or judges, so nobody knows whether the
        board was really silent."""
        self._held_up_ns = now_ns

    def _excused(self, since_ns: int, now_ns: int) -> bool:
        """True if the machine may explain a silence that began then. The silence must then be counted again, and motion
        is stopped for it. No board is excused for longer than a healthy service may be held up."""
        true_ns = max(self._true_ns, self._said_ns)
        if self._held_up_ns < since_ns or now_ns - true_ns >= LONGEST_NS:
            return False
        self._unheard_ns = now_ns - true_ns
        self.listen(now_ns, now_ns)
        return True

    def pop_unheard(self) -> int:
        """For how long nothing was heard from the board while the machine held up the service, ns; returned once. 0 if
        there was no such silence."""
        found, self._unheard_ns = self._unheard_ns, 0
        return found

    def said(self, said_ns: int, newest_ping_ns: int) -> None:
        """Record that the board sent something, of any kind, at `said_ns`."""
        if said_ns <= max(self._said_ns, self._opened_ns):
            return
        self._said_ns = said_ns
        if self._silent:
            self._silent = False
            self.listen(newest_ping_ns)
        if not self._asked:
            self._heard = True
            if self._answers == LINK_UNHEARD:
                self._answers = LINK_UNASKED

    def check_silence(self, patience_ns: int, now_ns: int) -> None:
        """Check whether the board has gone silent. `patience_ns`: how long it may pause; 0: it sends only answers."""
        self._patience_ns = patience_ns
        since_ns = max(self._said_ns, self._listened_ns)
        if self._said_ns and patience_ns and now_ns - since_ns >= patience_ns and not self._excused(since_ns, now_ns):
            self._silent = True

    def check_echo(self, unheeded_ns: int) -> None:
        """Check whether the board obeys zero although motion is written. `unheeded_ns`: since when it reports that; 0:
        it does not. The last report stays true for its own time, so a pause in the reports makes no board deaf."""
        if self._heeds_ns and unheeded_ns and self._said_ns - unheeded_ns >= self._heeds_ns:
            self._answers, self._by_echo = LINK_DEAF, True

    def cleared(self) -> None:
        """Record that nothing is latched. After a stop, a deaf board and a hearing one both report zero, so only the
        next motion tells whether it hears again."""
        if self._by_echo:
            self._answers, self._by_echo = self._first, False

    def answered(self, sent_ns: int) -> None:
        """Record that the ping sent at `sent_ns` was answered."""
        if sent_ns < self._opened_ns:
            return  # answered by the device that was at the port before
        if not self._by_echo:
            self._answers = LINK_ALIVE
        self._heard = True
        self._answered_ns = max(self._answered_ns, sent_ns)
        self._true_ns = max(self._true_ns, sent_ns)
        self._asked_ns = 0

    def missed(self, now_ns: int) -> bool:
        """True, once, when the device at a port that was opened again should have answered by now."""
        since_ns = self._asked_ns if self._asked else self._opened_ns
        if self.state != LINK_UNHEARD or self._missed or not since_ns:
            return False
        self._missed = now_ns - since_ns >= self._deaf_ns and not self._excused(since_ns, now_ns)
        return self._missed

    def gone_deaf(self, newest_ping_ns: int, now_ns: int) -> bool:
        """True when the board has just become deaf; `newest_ping_ns`: when the last ping was sent."""
        if self._asked_ns == 0 and newest_ping_ns > self._answered_ns:
            self._asked_ns = newest_ping_ns
        if self.state != LINK_ALIVE or not self._asked_ns:
            return False
        # Half of the time must have passed since a ping that it should have answered: before that ping it had nothing
        # to answer.
        if now_ns - self._answered_ns < self._deaf_ns or now_ns - self._asked_ns < self._deaf_ns // 2:
            return False
        if now_ns - newest_ping_ns < PONG_NS or self._may_be_silent(now_ns):
            return False
        if self._excused(self._asked_ns, now_ns):
            return False
        self._answers = LINK_DEAF
        return True

    def _may_be_silent(self, now_ns: int) -> bool:
        """True while a board that normally reports all the time has sent nothing lately. It may turn out to be silent,
        so it does not count as deaf yet."""
        quiet_ns = now_ns - max(self._said_ns, self._listened_ns)
        return 0 < self._patience_ns <= self._deaf_ns and self._said_ns > 0 and quiet_ns >= self._patience_ns // 2
