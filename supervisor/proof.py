"""Proof: what is known about the effect of a stop. Link: whether the board hears what is written to it. Pure.

A stop can reach these levels of proof:

    acknowledged   the board answered a ping that was written after the stop, or reports that it obeys zeros
    observed       the IMU, or the board's reports of its wheels, show that the wheels are still
    logged         nothing more will become known about the stop, so its outcome is logged

No level is ever concluded from another one. For example, a stop does not count as acknowledged because the IMU shows
that the wheels came to rest.
"""

from __future__ import annotations

from failstop.board.interface import BY_IMU, BY_WHEELS
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
    WINDOW_NS,
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
"""A ping that is younger than this may still be answered, so it does not show that the board is deaf. The time between
two pings is longer (schedule.py)."""
ACKNOWLEDGE_NS = 1_500_000_000
"""If the board has not acknowledged a stop after this time, the stop is logged as not acknowledged."""
JUDGED_AFTER_NS = 800_000_000
"""If the wheels were never seen moving, a verdict "the wheels are still" counts only if it was made at least this long
after the stop's cause. This time is longer than one window of IMU samples plus the time for which a verdict is held
(procs/telemetry/still.py)."""
JUDGED_WITHIN_NS = 500_000_000
"""A verdict about the wheels that is older than this does not count. Normally a newer verdict comes within
this time. None comes if telemetry, the IMU or the board's reports have gone silent."""
LEAST_NS = 1_000_000
"""The shortest time that is shown for wheels that came to rest after a stop. A time of 0 would mean that they were
already still before the stop."""
HEEDS_NS = 200_000_000
"""This is for a board that reports which commands it obeys. If the board keeps reporting zero although motion is
written, it counts as deaf after its echo time (Board.echo_ns) plus this time."""
LATE_LOOK_NS = 200_000_000
"""If the supervisor first looks at the IMU's verdict later than this after the stop's cause, for example because it was
held up, it may have missed that the wheels were moving."""


class Proof:
    """What is known about the effect of one stop. All times are CLOCK_MONOTONIC in ns."""

    def __init__(
        self,
        stop: Stop,
        after_ns: int,
        now_ns: int,
        unix_s: float,
        by: tuple[str, str],
        verdict: tuple[int, int] = (0, 0),
    ) -> None:
        """`after_ns`: how long the wheels may take to come to rest. `unix_s`: the wall clock time at `now_ns`. `by`:
        (how the board acknowledges a stop, what observes the wheels), see interface.py. `verdict`: the newest verdict
        about the wheels, as (still_ns, judged_ns) of judged(), however old it is. The time limits for the outcome count
        from `now_ns`, because the stop's cause may be long ago."""
        self.stop = stop
        self._by = by
        self.unix_s = unix_s - (now_ns - stop.t_ns) / 1e9
        """The wall clock time at which the stop's cause was noticed, as Unix time in s, for people."""
        self.acknowledged_ns: int | None = None
        """The time from the stop's cause to the board's answer, ns. None if the board has not answered."""
        self.observed_ns: int | None = None
        """The time from the stop's cause until the wheels were still, ns. 0 if the wheels were never seen moving, None
        if they were not seen still."""
        self.observed_late = False
        """True if nothing showed the wheels for a while before they were seen still. They may have come to rest before
        `observed_ns`."""
        self.wheels = WHEELS_UNKNOWN
        self.held = False
        """True if the stop's bytes were still in the kernel when the outcome was logged, because the board accepted no
        bytes."""
        self.believed = True
        """False if the device to which the stop was written has not yet answered as the board does, so it may not be
        the board."""
        self.logged = False
        """True if the outcome of the stop was logged."""
        still_ns, judged_ns = verdict
        self._turned: bool | None = None
        """Whether the wheels were turning at the cause or since. None if no verdict shows it."""
        self._turned_ns = 0
        """When the newest verdict that the wheels turn was made, or 0 if none was."""
        if judged_ns and not still_ns:
            self._turned, self._turned_ns = True, judged_ns
        elif judged_ns and still_ns <= stop.t_ns:
            self._turned = False
        self._looked_ns = 0
        self._after_ns = after_ns
        self._again_ns = stop.t_ns + after_ns
        self._since_ns = now_ns
        """When the proof began, or when a delayed stop was finally written. The time limits for the proof count from
        then."""

    def written_at_last(self, written_ns: int, by: str) -> None:
        """Record that the stop was written late, after the port was opened again. The proof then begins again."""
        self.stop.written_ns, self.stop.by = written_ns, by
        self.logged = False
        self._since_ns = written_ns
        self._again_ns = written_ns + self._after_ns

    def ponged(self, sent_ns: int, arrival_ns: int) -> bool:
        """Record the board's answer to bytes that were written at `sent_ns`. The answer came at `arrival_ns`. Returns
        True if it acknowledges the stop."""
        if self.acknowledged_ns is not None or sent_ns < self.stop.written_ns or not self.stop.written_ns:
            return False
        self.acknowledged_ns = arrival_ns - self.stop.t_ns
        return True

    def judged(self, still_ns: int, judged_ns: int, now_ns: int) -> bool:
        """Record a verdict about the wheels, from the IMU or from the board's reports. Returns True if the caller must
        write the stop again, because the wheels still move `after_ns` (see the constructor) after the stop. While they
        keep moving, returns True again after each further `after_ns`.

        `still_ns`: since when the wheels have been still, or 0 if they move. `judged_ns`: when the verdict was made, or
        0 if no verdict was made yet.
        """
        self._looked_ns = self._looked_ns or now_ns
        if not self._by[1] or self.observed_ns is not None or now_ns - judged_ns > JUDGED_WITHIN_NS:
            return False
        if not still_ns:
            self._turned, self._turned_ns = True, judged_ns
            if now_ns >= self._again_ns:
                self._again_ns = now_ns + self._after_ns
                self.wheels = WHEELS_UNSTILL
                return True
        elif self._came_to_rest(still_ns):
            # A window of samples may begin before the cause, when the wheels were still turning.
            self.observed_ns = max(LEAST_NS, still_ns - self.stop.t_ns)
            self.observed_late = still_ns - (self._turned_ns or self.stop.t_ns) > JUDGED_WITHIN_NS
        elif judged_ns - self.stop.t_ns >= JUDGED_AFTER_NS:
            self.observed_ns = 0
        self.wheels = self.wheels if self.observed_ns is None else WHEELS_STILL
        return False

    def _came_to_rest(self, still_ns: int) -> bool:
        """True if the wheels turned at the cause or since, and not only before it. `still_ns`: since when they have
        been still."""
        if self._turned is not None:
            return self._turned and still_ns > self.stop.t_ns - WINDOW_NS
        # The board's reports are about one moment, not about a window of time. So if the wheels came to rest after the
        # cause, they were turning at the cause.
        late = self._by[1] != BY_IMU or self._looked_ns - self.stop.t_ns > LATE_LOOK_NS
        return late and still_ns > self.stop.t_ns

    @property
    def unheeded(self) -> bool:
        """True if the board's reports show that this stop had a motion to end. A board that acknowledges stops by its
        echo has then not obeyed this one, if it has not acknowledged it."""
        return self._by[1] == BY_WHEELS and bool(self._turned)

    def complete(self, now_ns: int) -> bool:
        """Return True if nothing more will become known about the stop, and the caller must log its outcome now. Later
        calls return False, unless written_at_last() begins the proof again."""
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
            had_none = link == LINK_UNASKED and self._by[0] and not self.unheeded
            unheard = UNMOVED if had_none else f"not acknowledged (link {link})"
            heard = f"handed over, {NOT_SENT}" if self.held else unheard
        if self.observed_ns is None:
            unstill = "wheels NOT seen still" if self.wheels == WHEELS_UNSTILL else "not observed"
            seen = unstill if self._by[1] else NO_IMU
        else:
            seen = wheels_seen(self.observed_ns / 1e9, self._by[1], late=self.observed_late)
            seen += late * (self.observed_ns > 0)
        return f"{self.stop.cause}: {heard}, {seen}"

    def fields(self, link: str) -> dict[str, str | float | bool | None]:
        return {
            **self.stop.fields(),
            "epoch": self.stop.epoch,
            "link": link,
            "sent": not self.held,
            **self._proofs(),
            "wheels": self.wheels,
        }

    def as_record(self) -> dict[str, object]:
        """The record about this stop, as clients read it."""
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

    def _proofs(self) -> dict[str, str | float | bool | None]:
        return {
            "acknowledged_us": None if self.acknowledged_ns is None else self.acknowledged_ns / 1e3,
            "acknowledged_by": self._by[0],
            "observed_ms": None if self.observed_ns is None else self.observed_ns / 1e6,
            "observed_by": self._by[1],
            **({"observed_late": True} if self.observed_late else {}),
        }


class Link:
    """The state of the link to the board: whether the board at the open port hears what is written to it, and whether
    it sends anything. Pure.

    unproven   the board has answered no ping since the port was opened. Perhaps it does not hear. Motion is allowed
    alive      the board answers
    deaf       the board answered earlier and now does not, or it reports that it obeys zero while motion is written
    silent     the board sent reports earlier and now sends nothing. Perhaps it has no power, or its program has ended,
               or the wire from it is broken. Nobody can tell which, or whether the board still hears
    unheard    the port was lost and is open again, but the device at the port has not answered. It may not be the board
    unasked    the board has no pings, so it can't answer. Nobody knows whether it hears. Motion is allowed

    After a loss of the port, the state is unheard if the board was heard earlier in this run, or if the device may not
    be the board (finder.py). A deaf board may still send reports, so reports never prove that it hears.
    """

    def __init__(self, deaf_ns: int, *, asked: bool = True, echo_ns: int = 0) -> None:
        """`deaf_ns`: if the board has not answered for this long, it is deaf. `asked`: True if the board has pings.
        `echo_ns`: how long the board may take to report that it obeys a command; 0 if it sends no such reports."""
        self._deaf_ns = deaf_ns
        self._asked = asked
        self._heeds_ns = echo_ns + HEEDS_NS if echo_ns else 0
        self._first = LINK_UNPROVEN if asked else LINK_UNASKED
        self._answers = self._first
        """The state of the link, judged only by the board's answers and its reports about obeyed commands. It is never
        the state silent, which `_silent` records."""
        self._silent = self._by_echo = False
        self._heard = False
        """True if the board was heard in this run: it has answered a ping or, if it has no pings, has sent anything."""
        self._opened_ns = self._listened_ns = 0
        self._held_up_ns = self._unheard_ns = 0
        """`_held_up_ns`: when the machine last held up a process that is needed to hear the board, or 0. `_unheard_ns`:
        the length of the newest excused silence (_excused()), until pop_unheard() returns it."""
        self._true_ns = 0
        """When the newest answered ping was sent. If no ping was answered since the port was opened, the time when the
        port was opened."""
        self._said_ns = self._patience_ns = 0
        """`_said_ns`: when the board last sent anything, or 0 if it has sent nothing since the port was opened.
        `_patience_ns`: how long the board may pause between two reports."""
        self._answered_ns = 0
        """The start of the board's time without an answer. Normally this is the time when the newest answered ping was
        sent. It is later if the port was opened after that, or if no answer could be read for a while."""
        self._asked_ns = 0
        """When the first ping that the board has not answered was sent; 0 if no ping waits for an answer."""
        self._missed = False

    @property
    def state(self) -> str:
        """The state of the link, as one of the words in the table of this class."""
        return LINK_SILENT if self._silent else self._answers

    @property
    def believed(self) -> bool:
        """True if the device at the open port counts as the board. This is so if it has answered, or if it has no pings
        and is not unheard."""
        return self._answers not in (LINK_UNPROVEN, LINK_UNHEARD)

    @property
    def forbids(self) -> bool:
        """True if motion must not be enabled, because the board was heard in this run and is not heard now.

        A device that was never heard does not prevent motion, because some boards send nothing by design. A board that
        obeyed zero although motion was written does not prevent motion either. It has already caused a stop, and after
        the reset only new motion can show whether the board hears again.
        """
        known = self._answers == LINK_DEAF and not self._by_echo
        return known or self.state == LINK_SILENT or (self.state == LINK_UNHEARD and self._heard)

    def opened(self, now_ns: int, *, sure: bool = True) -> None:
        """Record that a port was opened. Nothing is known about the device at this port, so the link's state begins
        again. `sure`: True if the device is certainly the board."""
        self._answers = self._first if sure and not self._heard else LINK_UNHEARD
        self._opened_ns = self._answered_ns = self._listened_ns = self._true_ns = now_ns
        self._asked_ns = self._said_ns = 0
        self._missed = self._silent = self._by_echo = False

    def listen(self, newest_ping_ns: int, now_ns: int = 0) -> None:
        """Ignore that the board was silent until `now_ns`, and that pings up to `newest_ping_ns` have no answer. Call
        this if the board's answers could not be read until now."""
        self._asked_ns = 0
        self._answered_ns = max(self._answered_ns, newest_ping_ns)
        self._listened_ns = max(self._listened_ns, now_ns)

    def answered_in_part(self, newest_ping_ns: int, now_ns: int) -> None:
        """Record that a wheel's servo does not answer, so no ping can be answered completely. The board does not count
        as deaf as long as its other parts answer."""
        if now_ns - self._said_ns < self._deaf_ns:
            self.listen(newest_ping_ns)

    def held_up(self, now_ns: int) -> None:
        """Record that the machine holds up a process that is needed to hear the board. During this time, nobody can
        tell whether the board is really silent."""
        self._held_up_ns = now_ns

    def _excused(self, since_ns: int, now_ns: int) -> bool:
        """Excuse the board's silence since `since_ns` if the machine has held up the service in that time. Returns True
        if the silence is excused. pop_unheard() then returns the silence's length, and the next silence is measured
        from `now_ns`. A silence of LONGEST_NS or longer is not excused."""
        true_ns = max(self._true_ns, self._said_ns)
        if self._held_up_ns < since_ns or now_ns - true_ns >= LONGEST_NS:
            return False
        self._unheard_ns = now_ns - true_ns
        self.listen(now_ns, now_ns)
        return True

    def pop_unheard(self) -> int:
        """Return the length of the newest silence that was excused because the machine held up the service, ns. Returns
        0 if no silence was excused since the last call."""
        found, self._unheard_ns = self._unheard_ns, 0
        return found

    def said(self, said_ns: int, newest_ping_ns: int) -> None:
        """Record that the board sent something at `said_ns`. `newest_ping_ns`: when the newest ping was sent."""
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
        """Check whether the board has gone silent. `patience_ns`: how long the board may pause between two reports; 0
        if it sends only answers to pings."""
        self._patience_ns = patience_ns
        since_ns = max(self._said_ns, self._listened_ns)
        if self._said_ns and patience_ns and now_ns - since_ns >= patience_ns and not self._excused(since_ns, now_ns):
            self._silent = True

    def check_echo(self, unheeded_ns: int) -> None:
        """Mark the board as deaf if it has reported for long enough that it obeys zero although motion is written.
        `unheeded_ns`: when the first of these reports came; 0 if there is none. A pause in the reports does not make
        the board deaf."""
        if self._heeds_ns and unheeded_ns and self._said_ns - unheeded_ns >= self._heeds_ns:
            self._answers, self._by_echo = LINK_DEAF, True

    def cleared(self) -> None:
        """Record that no stop is latched. A board that was deaf because it obeyed zero then no longer counts as deaf,
        because only the next motion can show whether it hears again."""
        if self._by_echo:
            self._answers, self._by_echo = self._first, False

    def answered(self, sent_ns: int) -> None:
        """Record that the board has answered the ping that was sent at `sent_ns`."""
        if sent_ns < self._opened_ns:
            return  # answered by the device that was at the port before it was opened again
        if not self._by_echo:
            self._answers = LINK_ALIVE
        self._heard = True
        self._answered_ns = max(self._answered_ns, sent_ns)
        self._true_ns = max(self._true_ns, sent_ns)
        self._asked_ns = 0

    def missed(self, now_ns: int) -> bool:
        """Return True if the device at a reopened port has not answered in time. After that, return False until a port
        is opened again."""
        since_ns = self._asked_ns if self._asked else self._opened_ns
        if self.state != LINK_UNHEARD or self._missed or not since_ns:
            return False
        self._missed = now_ns - since_ns >= self._deaf_ns and not self._excused(since_ns, now_ns)
        return self._missed

    def gone_deaf(self, newest_ping_ns: int, now_ns: int) -> bool:
        """Check whether the board, which answered earlier, has become deaf. Returns True if this call has changed the
        state to deaf. `newest_ping_ns`: when the newest ping was sent."""
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
        """True if the board normally sends reports all the time and has sent none lately. It will probably count as
        silent soon, so it must not count as deaf."""
        quiet_ns = now_ns - max(self._said_ns, self._listened_ns)
        return 0 < self._patience_ns <= self._deaf_ns and self._said_ns > 0 and quiet_ns >= self._patience_ns // 2
