"""Children: the processes of the table as the supervisor knows them: their states, deaths, restarts, silences."""

from __future__ import annotations

import signal

from failstop.data import Data
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.policy.processes import Process
from failstop.policy.settings import Settings
from failstop.procs.loop import NEVER, Timer
from failstop.shm.heartbeat import HeartbeatReader
from failstop.shm.lifeline import Lifeline
from failstop.supervisor import starter

_SIGNALS = {found.value: found.name for found in signal.Signals}
_SIGNALS[signal.SIGXCPU] += " (it ran on and on at real-time priority)"
STARTING_NS = 5_000_000_000
"""A process that does not say that it runs within this time is killed."""
LONGEST_WAIT_NS = 2_000_000_000

# The states of a process, in the words that people read.
WAITING = "waiting"  # to be started
DOWN = "down"  # it died too often: not started before a reset
STARTING = "starting"
RUNNING = "running"
HUNG = "hanging"  # silent past its deadline, which the machine explains: not killed for that
FENCED = "fenced"  # killed for hanging, and not gone yet
DEAD = "dead"  # that is known, and answered; still to be reaped

# The events of a process, in the words that people read.
STARTED = "started"
RUNS = "runs"  # it says so itself
SPARED = "spared"  # it is silent, which the machine explains
BEATS = "beats"  # after it was spared: also before it says that it runs, and just before its death is known
KILLED = "killed"  # for hanging
TERMINATED = "died"
REAPED = "reaped"
GIVEN_UP = "given up"  # it died too often
RECALLED = "recalled"  # by a reset

NEXT = {
    WAITING: {STARTED: STARTING, BEATS: WAITING, GIVEN_UP: DOWN},
    DOWN: {STARTED: STARTING, BEATS: DOWN, RECALLED: WAITING},
    STARTING: {RUNS: RUNNING, SPARED: STARTING, BEATS: STARTING, KILLED: FENCED, TERMINATED: DEAD},
    RUNNING: {SPARED: HUNG, BEATS: RUNNING, KILLED: FENCED, TERMINATED: DEAD},
    HUNG: {SPARED: HUNG, BEATS: RUNNING, KILLED: FENCED, TERMINATED: DEAD},
    FENCED: {BEATS: FENCED, TERMINATED: DEAD},
    DEAD: {BEATS: DEAD, REAPED: WAITING},
}
"""The next state of a process, by its state and the event. An event that a state does not name can't happen then: it is
a defect, which leaves the state as it is and stops the robot. A gate that is down is started again after a while, so
DOWN has STARTED too."""
ALIVE = tuple(state for state, after in NEXT.items() if TERMINATED in after)


class Fence(Data):
    """The record of a hung process that was killed, so that nothing that it still wanted to do can happen. Times are
    CLOCK_MONOTONIC in ns; 0: it has not happened."""

    noticed_ns: int
    kill_ns: int
    burst_ns: int
    """When the stop was written on the supervisor's own descriptor, as it is for a port owner."""
    silent_ns: int = 0
    was_starved: bool = False
    """The machine did not run it: no fault of its own."""
    gone_ns: int = 0
    again_ns: int = 0
    """When the stop was written again for its end."""

    def _steps_us(self) -> list[tuple[str, str, float]]:
        """The steps that have happened: for programs, for people, and how long after the notice."""
        words = (("kill", "killed"), ("burst", "stop written"), ("gone", "gone"), ("again", "stop again"))
        times_ns = (self.kill_ns, self.burst_ns, self.gone_ns, self.again_ns)
        return [(*step, (at - self.noticed_ns) / 1e3) for step, at in zip(words, times_ns, strict=True) if at]

    def story(self, name: str) -> str:
        """In words, in ms from the notice."""
        return f"{name} was fenced: {', '.join(f'{told} after {us / 1e3:.1f} ms' for _, told, us in self._steps_us())}"

    def fields(self) -> dict[str, float]:
        """Its times for programs: us from the notice."""
        return {"silent_ms": round(self.silent_ns / 1e6, 1), **{f"{step}_us": us for step, _, us in self._steps_us()}}


class Child:
    """One row of the process table as it is now."""

    def __init__(self, row: Process, beat: HeartbeatReader, restart: Timer, settings: Settings) -> None:
        """A machine that can't run one process sooner runs no other sooner, so no deadline is shorter than a lease."""
        self.row = row
        self.beat = beat
        self._settings = settings
        self._deadline_ns = max(row.deadline_ns, settings.ns("gate.lease_s"))
        self._deaths: list[int] = []
        """Times of its deaths, as long as they count."""
        self.state = WAITING
        self.pid = 0
        """0: there is none, since it waits or is down."""
        self.block = 0
        """The block of futexes that it holds."""
        self.life: Lifeline | None = None
        self.started_ns = 0
        self.restart = restart
        """When it is to be started again, if it is not started yet."""
        self.fence: Fence | None = None
        """It was killed for hanging: when and how."""
        self.excused_ns = 0
        """Silence before this is not its own."""
        self._spared_ns = 0
        """Its last sign of life before a silence that the machine explains, and that lasts; 0: there is none such."""
        self.defects: list[Cause] = []
        """Events that cannot happen and did, since they were last stopped for."""
        self.times_restarted = 0
        self.last_exit = ""
        self.killed = False
        """Its predecessor was killed by a signal."""

    def on(self, event: str) -> None:
        """Follow an event to the next state; one that can't happen in this state is kept as a defect."""
        after = NEXT[self.state].get(event)
        if after is None:
            self.defects.append(causes.DEFECT(self.row.name, event, self.state))
            return
        self.state = after

    def started(self, life: Lifeline, block: int, now_ns: int) -> None:
        """It was just started; `life`: the news of its death."""
        self.life = life
        self.pid = life.pid
        self.block = block
        self.fence = None
        self.started_ns = now_ns
        self.restart.set(NEVER)
        self._spared_ns = 0
        self.on(STARTED)

    def restart_wait_ns(self, now_ns: int) -> int | None:
        """It has died: the first time in the window it is restarted at once, the next after a doubling wait, and after
        the limit (None) it is down, and the service stopped, until people reset, rather than loop."""
        window_ns, backoff_ns = self._settings.ns("restart.window_s"), self._settings.ns("restart.backoff_s")
        self._deaths = [t for t in self._deaths if now_ns - t < window_ns] + [now_ns]
        count = len(self._deaths)
        if count >= self._settings["restart.deaths"]:
            return None
        return 0 if count == 1 else min(backoff_ns << min(count - 2, 16), LONGEST_WAIT_NS)

    def recalled(self) -> None:
        self._deaths.clear()
        self.on(RECALLED)

    def running(self) -> bool:
        """True when it has said that it runs, whether or not the machine lets it."""
        return self.state in (RUNNING, HUNG)

    def heard_ns(self) -> int:
        return max(self.beat.ns.get(), self.started_ns)

    def allowed_ns(self) -> int:
        """How long it may be silent: when it runs, or until it says so."""
        return self._deadline_ns if self.running() else STARTING_NS

    def spare(self, now_ns: int, silent_ns: int) -> None:
        """Its silence is the machine's: as long again from now on. `silent_ns`: as judged; it may beat meanwhile."""
        self.excused_ns = now_ns
        self._spared_ns = self._spared_ns or now_ns - silent_ns
        self.on(SPARED)

    def beaten(self) -> int:
        """Once it has beaten again after it was spared: how long it was silent (ns); else 0."""
        silent_ns = self.heard_ns() - self._spared_ns if self._spared_ns else 0
        if silent_ns:
            self._spared_ns = 0
            self.on(BEATS)
        return silent_ns

    def overdue_ns(self) -> int:
        """When it counts as hanging unless it beats before; NEVER: there is nothing to wait for."""
        if KILLED not in NEXT[self.state]:
            return NEVER
        sign_ns = self.beat.ns.get() if self.running() else self.started_ns
        return max(sign_ns, self.excused_ns) + self.allowed_ns()

    def kill(self, wait_s: float) -> None:
        """End it, and collect it if it has ended within `wait_s`."""
        if self.life:
            self.life.kill()
            self.life.wait(wait_s)
            if self.state in ALIVE:
                self.on(TERMINATED)
            self.reap()

    def reap(self) -> str:
        """Collect the dead process; returns how it died, in words; empty: not yet, as while a debugger holds it."""
        if (code := starter.reap(self.pid)) is None:
            return ""
        self.killed = code < 0
        self.last_exit = f"killed by {_SIGNALS.get(-code, -code)}" if self.killed else f"exited with code {code}"
        if self.life:
            self.life.close()
            self.life = None
        self.pid = 0
        self.on(REAPED)
        return self.last_exit
