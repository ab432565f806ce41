"""Steps: what a row of the fault table does to processes - killed, stopped, continued, put into an endless loop.

Processes that die together stand still first. Otherwise one that is killed a few microseconds after another still stops
the wheels before it dies. A signal only asks a process to stand still: each of its threads goes on until the kernel has
stopped it, so that is waited for.
"""

from __future__ import annotations

import contextlib
import errno
import os
import random
import signal
import time
from collections.abc import Callable

from failstop_lab.faults import ptrace
from failstop_lab.faults.fault import CONTINUE, CRASH, HANG, KILL, SPIN, Fault
from failstop_lab.trial import TrialError, is_ours, state_in

SIGNALS = {KILL: signal.SIGKILL, CRASH: signal.SIGSEGV, HANG: signal.SIGSTOP}
STILL = ("T", "t", "Z", "X")
"""States of proc(5) in which a thread runs none of its program: stopped, stopped by a tracer, or ended."""
APART_S = 0.005
AT_ONCE_S = 0.02
"""Within so long all must stand still; the shortest deadline of a process that hangs is 60 ms."""
BETWEEN_LOOKS_S = 0.0002
STOPPED_ON_S = (0.04, 0.14)
"""How long the hung stay stopped after the stop is due: less than it takes to fence them."""


def stands_still(pid: int) -> bool:
    """Whether every thread of the process has been stopped by a signal, or has ended."""
    folder = f"/proc/{pid}/task"
    try:
        return all(state_in(f"{folder}/{thread}/stat") in STILL for thread in os.listdir(folder))
    except FileNotFoundError:
        return True


class NotAtOnce(TrialError):
    """So much time went by between steps that must be at once that it would be another fault."""


class Steps:
    """The steps of one injection: at once, or if the row allows it within 5 ms, in any order; what is continued was
    stopped for longer."""

    def __init__(
        self,
        fault: Fault,
        chance: random.Random,
        kill: Callable[[int, int], None] = os.kill,
        stands: Callable[[int], bool] = stands_still,
    ) -> None:
        """`kill` sends a signal; `stands` tells whether a process stands still."""
        self._fault = fault
        self._chance = chance
        self._kill = kill
        self._stands = stands
        self._order = list(fault.steps)
        chance.shuffle(self._order)
        self._order.sort(key=lambda step: step[0] == CONTINUE)

    def perform(self, pids: dict[str, int], wait: Callable[[float], object]) -> int:
        """Take them; `wait` lets the clients go on for so many seconds. Returns when it began (CLOCK_MONOTONIC ns).
        Raises NotAtOnce."""
        spread_s = self._chance.choice((0.0, APART_S)) / max(1, len(self._order) - 1)
        if self._fault.at_once:
            spread_s = 0.0
        if not spread_s and len(self._order) > 1:
            self._stand_still([pids[process] for process in self._fault.struck(KILL)])
        begun_ns = time.monotonic_ns()
        for number, (action, process) in enumerate(self._order):
            if action == CONTINUE and self._order[number - 1][0] != CONTINUE:
                wait((self._fault.bar_ms or 0.0) / 1000 + self._chance.uniform(*STOPPED_ON_S))
            elif number and spread_s:
                time.sleep(self._chance.uniform(0.0, spread_s))
            self._do(action, pids[process])
        return begun_ns

    def _stand_still(self, pids: list[int]) -> None:
        begun_s = time.monotonic()
        for pid in pids:
            self._do(HANG, pid)
        while (took_s := time.monotonic() - begun_s) <= AT_ONCE_S and not all(map(self._stands, pids)):
            time.sleep(BETWEEN_LOOKS_S)
        if took_s > AT_ONCE_S:
            for pid in pids:
                self._do(CONTINUE, pid)
            raise NotAtOnce(f"the machine needed {1000 * took_s:.0f} ms to stop {len(pids)} processes at once")

    def undo(self, pids: dict[str, int]) -> None:
        """Continue what is still stopped."""
        for process in self._fault.struck(HANG):
            if process in pids and is_ours(pids[process]):
                self._do(CONTINUE, pids[process])

    def _do(self, action: str, pid: int) -> None:
        if pid <= 0:  # it has just died by itself; to a signal, 0 is everybody here
            raise ProcessLookupError(errno.ESRCH, "the process is not running")
        if action == SPIN:
            ptrace.spin(pid)
        elif action == CONTINUE:
            # It may have been fenced.
            with contextlib.suppress(ProcessLookupError):
                self._kill(pid, signal.SIGCONT)
        else:
            self._kill(pid, SIGNALS[action])
