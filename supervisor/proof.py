"""Proof: what can be known about a stop after it was answered. Link: what the board's answers prove about the link to
it. Pure.

A stop can reach these levels of proof:

    acknowledged   the board answered a ping that was written after the stop, or reports that it obeys zeros
    observed       the IMU, or the board's reports of its wheels, show that the wheels are still (unstill: they are not)
    logged         nothing more will be known about the stop, so its outcome is logged

The levels are kept apart everywhere. For example, the board may be silent while the IMU sees the wheels come to rest.
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

# The states of the wheels after a stop, as the IMU or the board's reports show them.
WHEELS_UNKNOWN = "unknown"
WHEELS_UNSTILL = "unstill"  # they still move although they should not, and have not been seen still since the stop
WHEELS_STILL = "still"
PONG_NS = 20_000_000
"""A ping younger than this may still be answered. A stop's ping and the ping after it are further apart
(schedule.py)."""
ACKNOWLEDGE_NS = 1_500_000_000
"""If the board has not acknowledged a stop after this time, the stop is logged as not acknowledged."""
JUDGED_AFTER_NS = 800_000_000
"""The IMU's verdict counts for a stop only if it was made this long after the cause. That is longer than one window of
samples plus the time for which the verdict is held (procs/telemetry/still.py)."""
JUDGED_WITHIN_NS = 500_000_000
"""A verdict older than this does not count. Either the IMU or telemetry is silent then."""
LEAST_NS = 1_000_000
"""The shortest time that is shown for wheels that came to rest after a stop. 0 would mean that they were already still
before it."""
HEEDS_NS = 200_000_000
"""If the board obeys motion, it reports so within its echo time. If it still reports zero this long after that, it does
not hear."""
LATE_LOOK_NS = 200_000_000
"""If the supervisor first looks at the IMU's verdict this long after the cause, because it was held up, it may have
missed that the wheels were moving."""


class Proof:
    """The proof of one stop that was answered. All times are CLOCK_MONOTONIC in ns."""

    def __init__(self, stop: Stop, after_ns: int, now_ns: int, unix_s: float, by: tuple[str, str]) -> None:
        """`after_ns`: how long the wheels may take to be still. `unix_s`: the wall clock time at `now_ns`. `by`: what
        acknowledges and what observes the stop (interface.py). If `now_ns` is long after the cause, the board and the
        wheels still get their usual time, counted from `now_ns`."""
        self.stop = stop
        self._by = by
        self.unix_s = unix_s - (now_ns - stop.t_ns) / 1e9
        """The wall clock time when the cause was noticed, for people (Unix time, s)."""
        self.acknowledged_ns: int | None = None
        """The time from the cause to the board's answer, ns. None if the board has not answered."""
        self.observed_ns: int | None = None
        """The time from the cause until the wheels were still, ns. 0 if no motion was observed before the stop either.
        None if the wheels were not observed to be still."""
        self.wheels = WHEELS_UNKNOWN
        self.held = False
        """True if the kernel still held the stop's bytes when the outcome was logged, because the board takes no
        bytes."""
        self.believed = True
        """False until the device to which the stop was written has answered as the board does."""
        self.logged = False
        """True once the outcome of the stop was logged, with everything that can be known."""
        self._was_still = True
        self._looked_ns = 0
        self._after_ns = after_ns
        self._again_ns = stop.t_ns + after_ns
        self._since_ns = now_ns
        """The time from which the board's answers count, and from which the time limits for the proof run."""

    def written_at_last(self, written_ns: int, by: str) -> None:
        """Record when a stop was written that had to wait until the port came back."""
        self.stop.written_ns, self.stop.by = written_ns, by
        self.logged = False
        self._since_ns = written_ns
        self._again_ns = written_ns + self._after_ns

    def ponged(self, sent_ns: int, arrival_ns: int) -> bool:
        """Record that the ping sent at `sent_ns` was answered. Returns True if this acknowledges the stop."""
        if self.acknowledged_ns is not None or sent_ns < self.stop.written_ns or not self.stop.written_ns:
            return False
        self.acknowledged_ns = arrival_ns - self.stop.t_ns
        return True

    def judged(self, still_ns: int, judged_ns: int, now_ns: int) -> bool:
        """Record the verdict of the IMU, or of the board's reports, about the wheels. Returns True if the wheels still
        move although they should be still by now. Later it returns True again each time the same period has passed. The
        caller must then write the stop again.

        `still_ns`: since when the wheels have been still, or 0 if they move. `judged_ns`: when the verdict was made, or
        0 if there has been none.
        """
        self._looked_ns = self._looked_ns or now_ns
        if not self._by[1] or self.observed_ns is not None or now_ns - judged_ns > JUDGED_WITHIN_NS:
            return False
        # The board's reports are about one moment, not about a window of time. So if the wheels came to rest after the
        # cause, they were turning at the cause.
        late = self._by[1] != BY_IMU or self._looked_ns - self.stop.t_ns > LATE_LOOK_NS
        if not still_ns:
            self._was_still = False
            if now_ns >= self._again_ns:
                self._again_ns = now_ns + self._after_ns
                self.wheels = WHEELS_UNSTILL
                return True
        elif not self._was_still or (late and still_ns > self.stop.t_ns):
            # A window of samples may begin before the cause, when the wheels were still turning.
            self.observed_ns = max(LEAST_NS, still_ns - self.stop.t_ns)
        elif judged_ns - self.stop.t_ns >= JUDGED_AFTER_NS:
            self.observed_ns = 0
        self.wheels = self.wheels if self.observed_ns is None else WHEELS_STILL
        return False

    def complete(self, now_ns: int) -> bool:
        """Returns True once, when nothing more will be known about the stop, so its outcome must be logged now."""
        age_ns = now_ns - self._since_ns
        if self.acknowledged_ns is None and age_ns < ACKNOWLEDGE_NS:
            return False
        seen = self.observed_ns is not None or self.wheels == WHEELS_UNSTILL or not self._by[1]
        if not seen and age_ns < self._after_ns + JUDGED_WITHIN_NS:
            return False
        self.logged, before = True, self.logged
        return not before

    def outcome(self, link: str) -> str:
        """The outcome of the stop as text for the journal. `link`: the state of the link."""
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
        """The record about the stop that clients read."""
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
    """The state of the link: whether the board at the open port hears what is written to it, and whether it still sends
    anything. Pure.

    unproven   the board has answered no ping since the port was opened. Nothing is known, so nothing is stopped for it
    alive      the board answers
    deaf       the board answered before and no longer does, or it reports that it obeys zero while motion is written
    silent     the board sent reports before, and now it sends nothing at all. It has no power, or its program has
               ended, or the wire from it is broken. Nobody can tell which, or knows whether it still hears
    unheard    the port was lost and is open again, but the device there has not answered. It may not be the board
    unasked    the board has no pings that it could answer. Nothing is known, and nothing waits for an answer

    Unheard is used if the board was heard before the loss, or if the device may not be the board (finder.py). A board
    can go deaf while it still sends reports, so its reports never prove that it hears.
    """

    def __init__(self, deaf_ns: int, *, asked: bool = True, echo_ns: int = 0) -> None:
        """`deaf_ns`: a board that has not answered for this long is deaf. `asked`: True if the board has pings.
        `echo_ns`: within what time the board reports that it obeys a written command; 0 if it sends no such reports."""
        self._deaf_ns = deaf_ns
        self._asked = asked
        self._heeds_ns = echo_ns + HEEDS_NS if echo_ns else 0
        self._first = LINK_UNPROVEN if asked else LINK_UNASKED
        self._answers = self._first
        """The state of the link according to the board's answers and its reports of obeyed commands, without regard to
        silence."""
        self._silent = self._by_echo = False
        self._heard = False
        """True if the board has answered a ping in this run, or, if it has no pings, has sent anything since its port
        was opened."""
        self._opened_ns = self._listened_ns = 0
        self._held_up_ns = self._unheard_ns = 0
        """When the machine last held up a process that is needed to hear the board; 0 if never."""
        self._true_ns = 0
        """When the newest ping was sent that the whole board has answered. Until then, when the port was opened."""
        self._said_ns = self._patience_ns = 0
        """When the board last sent anything (0 if nothing since the port was opened), and how long it may pause."""
        self._answered_ns = 0
        """When the newest answered ping was sent. Silence counts from there."""
        self._asked_ns = 0
        """When the first ping after the newest answered one was sent; 0 if none has been sent."""
        self._missed = False

    @property
    def state(self) -> str:
        """The state of the link, as one of the words in the class's table."""
        return LINK_SILENT if self._silent else self._answers

    @property
    def believed(self) -> bool:
        """False until the device at the port has shown that it is the board."""
        return self._answers not in (LINK_UNPROVEN, LINK_UNHEARD)

    @property
    def forbids(self) -> bool:
        """True if motion must not be enabled, because the board was heard in this run and is not heard at the moment. A
        device that was never heard is allowed, because some boards send nothing by design. A board that obeyed zero
        while motion was written is allowed too: a stop is latched for it, and after the reset only the next motion
        shows whether the board hears again."""
        known = self._answers == LINK_DEAF and not self._by_echo
        return known or self.state == LINK_SILENT or (self.state == LINK_UNHEARD and self._heard)

    def opened(self, now_ns: int, *, sure: bool = True) -> None:
        """Begin again with a newly opened port, because nothing is known about the device there. `sure`: True if the
        device is known to be the board."""
        self._answers = self._first if sure and not self._heard else LINK_UNHEARD
        self._opened_ns = self._answered_ns = self._listened_ns = self._true_ns = now_ns
        self._asked_ns = self._said_ns = 0
        self._missed = self._silent = self._by_echo = False

    def listen(self, newest_ping_ns: int, now_ns: int = 0) -> None:
        """Record that no process could hear an answer until now. A silence counts only from now on, or from the next
        ping."""
        self._asked_ns = 0
        self._answered_ns = max(self._answered_ns, newest_ping_ns)
        self._listened_ns = max(self._listened_ns, now_ns)

    def answered_in_part(self, newest_ping_ns: int, now_ns: int) -> None:
        """Record that one part of the board (a wheel's servo) does not answer, so no ping is answered as a whole. The
        board does not count as deaf while its other parts answer."""
        if now_ns - self._said_ns < self._deaf_ns:
            self.listen(newest_ping_ns)

    def held_up(self, now_ns: int) -> None:
        """Record that the machine holds up a process that is needed to hear the board. Nobody can tell then whether the
        board was really silent."""
        self._held_up_ns = now_ns

    def _excused(self, since_ns: int, now_ns: int) -> bool:
        """True if the machine may explain a silence that began at `since_ns`. The silence is then counted again from
        now on, and motion is stopped because of it. No board is excused for longer than a healthy service may be held
        up."""
        true_ns = max(self._true_ns, self._said_ns)
        if self._held_up_ns < since_ns or now_ns - true_ns >= LONGEST_NS:
            return False
        self._unheard_ns = now_ns - true_ns
        self.listen(now_ns, now_ns)
        return True

    def pop_unheard(self) -> int:
        """How long nothing was heard from the board while the machine held up the service, ns. Each silence is returned
        once; 0 if there was none."""
        found, self._unheard_ns = self._unheard_ns, 0
        return found

    def said(self, said_ns: int, newest_ping_ns: int) -> None:
        """Record that the board sent something at `said_ns`. It may be of any kind."""
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
        """Check whether the board has gone silent. `patience_ns`: how long it may pause; 0 if it sends nothing except
        answers."""
        self._patience_ns = patience_ns
        since_ns = max(self._said_ns, self._listened_ns)
        if self._said_ns and patience_ns and now_ns - since_ns >= patience_ns and not self._excused(since_ns, now_ns):
            self._silent = True

    def check_echo(self, unheeded_ns: int) -> None:
        """Check whether the board reports that it obeys zero although motion is written. `unheeded_ns`: since when it
        has reported that; 0 if it does not. The check uses the time of the last report, so a pause in the reports makes
        no board deaf."""
        if self._heeds_ns and unheeded_ns and self._said_ns - unheeded_ns >= self._heeds_ns:
            self._answers, self._by_echo = LINK_DEAF, True

    def cleared(self) -> None:
        """Record that no stop is latched. After a stop, a deaf board and a board that hears both report zero. So only
        the next motion shows whether the board hears again."""
        if self._by_echo:
            self._answers, self._by_echo = self._first, False

    def answered(self, sent_ns: int) -> None:
        """Record that the ping sent at `sent_ns` was answered."""
        if sent_ns < self._opened_ns:
            return  # answered by the device that was at the port before it was opened again
        if not self._by_echo:
            self._answers = LINK_ALIVE
        self._heard = True
        self._answered_ns = max(self._answered_ns, sent_ns)
        self._true_ns = max(self._true_ns, sent_ns)
        self._asked_ns = 0

    def missed(self, now_ns: int) -> bool:
        """Returns True once, if the device at a port that was opened again should have answered by now and has not."""
        since_ns = self._asked_ns if self._asked else self._opened_ns
        if self.state != LINK_UNHEARD or self._missed or not since_ns:
            return False
        self._missed = now_ns - since_ns >= self._deaf_ns and not self._excused(since_ns, now_ns)
        return self._missed

    def gone_deaf(self, newest_ping_ns: int, now_ns: int) -> bool:
        """True if the board has just become deaf. `newest_ping_ns`: when the last ping was sent."""
        if self._asked_ns == 0 and newest_ping_ns > self._answered_ns:
            self._asked_ns = newest_ping_ns
        if self.state != LINK_ALIVE or not self._asked_ns:
            return False
        # Half of the deaf time must also have passed since the first unanswered ping, because before that ping the
        # board had nothing to answer.
        if now_ns - self._answered_ns < self._deaf_ns or now_ns - self._asked_ns < self._deaf_ns // 2:
            return False
        if now_ns - newest_ping_ns < PONG_NS or self._may_be_silent(now_ns):
            return False
        if self._excused(self._asked_ns, now_ns):
            return False
        self._answers = LINK_DEAF
        return True

    def _may_be_silent(self, now_ns: int) -> bool:
        """True while a board that normally reports all the time has sent nothing lately. It may be about to count as
        silent, so it does not count as deaf yet."""
        quiet_ns = now_ns - max(self._said_ns, self._listened_ns)
        return 0 < self._patience_ns <= self._deaf_ns and self._said_ns > 0 and quiet_ns >= self._patience_ns // 2
