"""Frozen: the whole service stands while the wheels turn, as with a kernel that is dead. The board's own watchdog is
all that is left, and the wheels' rest is its doing if nobody wrote a stop meanwhile.

The board's reports are read through the port owner's own descriptor (borrowed.py). Where there are none, a person says
when the wheels stand; on a simulated board, the board.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterable
from types import TracebackType

from failstop.board.interface import BY_ECHO
from failstop.board.wire import COAST
from failstop.messages.layout import PORT_OWNER
from failstop_lab.faults.table import FAULT_BY_NAME
from failstop_lab.prove.means import NO_REPORTS
from failstop_lab.prove.run import MOST_S, NS, STAYS_S, PathRun
from failstop_lab.prove.strike import Skipped
from failstop_lab.prove.table import FROZEN, REST_RESOLUTION_S, SLACK_MS
from failstop_lab.sim.client import Event
from failstop_lab.trial import is_ours

EARLY_S = 0.3
"""The last frame that feeds the watchdog may have been written so long before the freeze (0.2 s), and some."""
NOT_STOPPED = "its own watchdog was NOT SEEN TO STOP THE WHEELS"
AFTER_S = 0.6
"""Watched after the thaw, for motion that goes on."""
PERSON_S = 2.0
"""A person sees and says it so late at most."""
THAWED_MS = float(FAULT_BY_NAME[FROZEN].bar_ms or 0.0)
"""From the thaw to the stop of the first to wake."""
GUARD_ENDS_S = 5.0
"""How long the guard may take to end, on a busy machine."""
THAW = """
import os, signal, sys
sys.stdin.read()
for pid in map(int, sys.argv[1:]):
    try:
        os.kill(pid, signal.SIGCONT)
    except ProcessLookupError:
        pass
"""
"""Its standard input ends with whoever froze them, however that comes about."""


class Freeze:
    """A context manager: within it these processes stand. Afterwards they go on, also if this process is killed."""

    def __init__(self, pids: Iterable[int]) -> None:
        self._pids = [pid for pid in pids if pid > 0 and is_ours(pid)]
        self.begun_ns = self.thawed_ns = 0
        """When the first was stopped, and when the first went on (CLOCK_MONOTONIC)."""
        self._guard: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Freeze:
        words = [sys.executable, "-I", "-S", "-c", THAW, *map(str, self._pids)]
        # A signal to this process's group, as Ctrl-C is, must not end it before.
        self._guard = subprocess.Popen(words, stdin=subprocess.PIPE, start_new_session=True)
        self.begun_ns = time.monotonic_ns()
        try:
            for pid in self._pids:
                os.kill(pid, signal.SIGSTOP)
        except BaseException:
            self.thaw()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.thaw()

    def thaw(self) -> None:
        """Let them go on, all at once."""
        self.thawed_ns = time.monotonic_ns()
        for pid in self._pids:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)
        if self._guard:
            try:
                self._guard.communicate(timeout=GUARD_ENDS_S)
            except subprocess.TimeoutExpired:  # it hangs, and everything it is there for is done
                self._guard.kill()
                self._guard.communicate()
            self._guard = None


def entered() -> bool:
    """Whether a person has pressed Enter."""
    return bool(select.select((sys.stdin,), (), (), 0.0)[0]) and bool(sys.stdin.readline())


class FrozenRun(PathRun):
    """As any other path, but that nobody writes a stop: within the freeze the board stops the wheels itself."""

    _unread = ""
    """Why the board's reports are not read meanwhile; empty: they are."""
    _stood_ns = 0
    """The simulated board's word, or else a person's, of when the wheels stood."""
    _thawed_ns = 0

    def _stop(self) -> None:
        stand, result = self.stand, self.result
        with Freeze(self._pids.values()) as freeze:
            self.cause_ns = freeze.begun_ns
            self._verdict = self.sight.verdict(self.cause_ns)
            self._unread = stand.watch.borrow_port(self._pids[PORT_OWNER]) if self.sight.by else NO_REPORTS
            if self._unread and not stand.board:
                self._ask_person()
            result.bar_s = self._bar_s()
            stand.run(stand.means.watchdog_s + MOST_S, self._stands)
            self.judge()
        self._thawed_ns = freeze.thawed_ns
        stand.watch.let_go()
        self._judge_thawed()

    def _ask_person(self) -> None:
        """Have a person say when the wheels stand. Raises Skipped without one."""
        if not self.ask:
            raise Skipped(self._unread)
        while entered():
            pass  # keys that were pressed before
        self.ask("the whole service is frozen: press Enter as soon as the wheels have stopped")

    def _bar_s(self) -> float:
        """A board that takes the current away does not say for how long the wheels roll."""
        means, result = self.stand.means, self.result
        slack_s = SLACK_MS[result.simulated] / 1000
        person_s = PERSON_S if self._unread and not self.stand.board else 0.0
        seen_s = self.sight.rest_bar_s(self.path, self.velocity) or self.path.rest_bar_s(self.velocity)
        bar_s = seen_s + slack_s + person_s
        return max(bar_s, means.watchdog_s + MOST_S) if means.does == COAST else bar_s

    def _stands(self) -> bool:
        """The wheels have stood for a while."""
        board, now_ns = self.stand.board, time.monotonic_ns()
        if not self._stood_ns and (not any(board.wheels()) if board else bool(self._unread) and entered()):
            self._stood_ns = now_ns
        seen = self._stood_ns > 0 if self._unread else self._verdict.still(self.stand.watch.samples)
        self._rest_seen_ns = (self._rest_seen_ns or now_ns) if seen else 0
        return seen and now_ns > self._rest_seen_ns + STAYS_S * NS

    def judge(self) -> None:
        """Within the freeze: who stopped the wheels, and when they stood."""
        result, watchdog_s = self.result, self.stand.means.watchdog_s
        before = self._before()
        if self.stand.board and self._stood_ns:
            result.board_ms = (self._stood_ns - self.cause_ns) / 1e6
        seen = self._stood_ns > 0 if self._unread else self._verdict.still(self.stand.watch.samples)
        if not seen:
            silent = not self._unread and not self._after()
            result.wrong.append(f"the {self.sight.source} is silent" if silent else NOT_STOPPED)
        elif self._unread:
            result.rest_s = (self._stood_ns - self.cause_ns) / NS
            self._judge_bar()
        else:
            self._judge_rest(before)
        if result.rest_s is not None and result.rest_s < watchdog_s - EARLY_S:
            result.doubt(f"at rest after {result.rest_s:.2f} s: its own watchdog acts after {watchdog_s:g}")
        watch = self.stand.watch
        if written := [by for t_ns, by in watch.written if t_ns >= self.cause_ns]:
            result.doubt(f"{written[0]} wrote a stop: it was not frozen in time")
        if self.stand.means.acknowledged_by == BY_ECHO:
            self._judge_echo()

    def _judge_echo(self) -> None:
        """The board says that it obeys zeros, though nobody has written any."""
        result = self.result
        echo_ns = min((t_ns for t_ns in self.stand.watch.obeys_zeros if t_ns >= self.cause_ns), default=None)
        if echo_ns is None or self._unread:
            result.wrong += [] if self._unread else ["the board did not report that it obeys zero speed"]
            return
        result.acknowledged_ms = (echo_ns - self.cause_ns) / 1e6
        bar_ms = self.path.reaction_bar_ms(simulated=result.simulated) + REST_RESOLUTION_S * 1000
        if result.acknowledged_ms > bar_ms:
            result.doubt(f"its own watchdog acted after {result.acknowledged_ms:.0f} ms, the bar is {bar_ms:.0f}")

    def _judge_thawed(self) -> None:
        """Nothing moves again, though the commands go on: the first to wake stops, and that is latched."""
        stand, result = self.stand, self.result
        verdict = self.sight.verdict(self._thawed_ns)
        stand.run(AFTER_S)
        if not stand.run(MOST_S, lambda: verdict.still(stand.watch.samples)):
            result.wrong.append("THE WHEELS DID NOT COME TO REST")
            result.runaway = True
        written = [t_ns for t_ns, _ in stand.watch.written if t_ns >= self._thawed_ns]
        late_ms = (min(written) - self._thawed_ns) / 1e6 if written else None
        bar_ms = THAWED_MS + SLACK_MS[result.simulated]
        if late_ms is None:
            result.wrong.append("NO STOP written after the thaw")
        elif late_ms > bar_ms:
            result.doubt(f"after the thaw a stop was written after {late_ms:.0f} ms, the bar is {bar_ms:.0f}")
        if stand.board:
            self._judge_frames(stand.board.events())
        self._judge_latch()

    def _judge_frames(self, events: list[Event]) -> None:
        """On the simulated board's side of the wire."""
        result = self.result
        if any(event.is_stop for event in events if self.cause_ns <= event.arrival_ns < self._thawed_ns):
            result.doubt("a stop came while everything was frozen")
        after = [event for event in events if event.arrival_ns >= self._thawed_ns]
        stop = next((event.index for event in after if event.is_stop), None)
        if stop is None:
            result.wrong.append("the board has seen NO STOP after the thaw")
        elif motion := sum(event.is_motion for event in after if event.index > stop):
            result.wrong.append(f"{motion} motion frames after the stop")
