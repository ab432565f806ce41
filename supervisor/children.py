"""Children: the supervisor's view of each process in the table: its state, deaths, restarts and silences."""

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
"""A process that does not report within this time that it runs is killed."""
LONGEST_WAIT_NS = 2_000_000_000

# The states of a process, in the words that people read.
WAITING = "waiting"  # to be started
DOWN = "down"  # it died too often, so it is not started before a reset
STARTING = "starting"
RUNNING = "running"
HUNG = "hanging"  # silent past its deadline, but the machine explains it, so it is not killed
FENCED = "fenced"  # killed for hanging, and not gone yet
DEAD = "dead"  # its death is known and answered; still to be reaped

# The events of a process, in the words that people read.
STARTED = "started"
RUNS = "runs"  # the process reports it
SPARED = "spared"  # it is silent, and the machine explains it
BEATS = "beats"  # after it was spared; also before it reports that it runs, and just before its death is known
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
"""The table of a process: its next state, for each state and event. An event that has no entry for a state can't happen
in it. If it happens all the same, the state stays as it is, and the robot is stopped for the defect. DOWN has an entry
for STARTED, because a gate that is down is started again after a while."""
ALIVE = tuple(state for state, after in NEXT.items() if TERMINATED in after)


class Fence(Data):
    """How a hung process was killed, so that it can do nothing more. Times are CLOCK_MONOTONIC in ns; 0 means that it
    has not happened."""

    noticed_ns: int
    kill_ns: int
    burst_ns: int
    """When the supervisor wrote the stop on its own descriptor, as it does for a hung port owner."""
    silent_ns: int = 0
    was_starved: bool = False
    """True if the machine did not run the process, so the hang was not the process's own fault."""
    gone_ns: int = 0
    again_ns: int = 0
    """When the supervisor wrote the stop again, after the process had ended."""

    def _steps_us(self) -> list[tuple[str, str, float]]:
        """The steps that have happened: the name for programs, the name for people, and how many us after the hang was
        noticed."""
        words = (("kill", "killed"), ("burst", "stop written"), ("gone", "gone"), ("again", "stop again"))
        times_ns = (self.kill_ns, self.burst_ns, self.gone_ns, self.again_ns)
        return [(*step, (at - self.noticed_ns) / 1e3) for step, at in zip(words, times_ns, strict=True) if at]

    def story(self, name: str) -> str:
        """The steps as a sentence, in ms after the hang was noticed."""
        return f"{name} was fenced: {', '.join(f'{told} after {us / 1e3:.1f} ms' for _, told, us in self._steps_us())}"

    def fields(self) -> dict[str, float]:
        """The steps for programs, in us after the hang was noticed."""
        return {"silent_ms": round(self.silent_ns / 1e6, 1), **{f"{step}_us": us for step, _, us in self._steps_us()}}


class Child:
    """One row of the process table, with its current state."""

    def __init__(self, row: Process, beat: HeartbeatReader, restart: Timer, settings: Settings) -> None:
        """`row`: the process in the table; `beat`: its heartbeat; `restart`: the timer for its restart. The deadline of
        a process is never shorter than the lease, because a machine that is too slow for the lease is also too slow for
        a shorter deadline."""
        self.row = row
        self.beat = beat
        self._settings = settings
        self._deadline_ns = max(row.deadline_ns, settings.ns("gate.lease_s"))
        self._deaths: list[int] = []
        """When it died, for the deaths that still count."""
        self.state = WAITING
        self.pid = 0
        """Its pid; 0 while no process exists, because it waits or is down."""
        self.block = 0
        """The index of its block of futexes."""
        self.life: Lifeline | None = None
        self.started_ns = 0
        self.restart = restart
        """The timer for its next start."""
        self.fence: Fence | None = None
        """How it was killed for a hang; None if it was not."""
        self.excused_ns = 0
        """Silence before this time does not count against the process."""
        self._spared_ns = 0
        """Its last sign of life before a silence that the machine explains; 0 if there is no such silence now."""
        self.defects: list[Cause] = []
        """How many impossible events have happened since the robot was last stopped for one."""
        self.times_restarted = 0
        self.last_exit = ""
        self.killed = False
        """True if the process before it was killed by a signal."""

    def on(self, event: str) -> None:
        """Change to the next state after an event. An event that can't happen in this state is counted as a defect."""
        after = NEXT[self.state].get(event)
        if after is None:
            self.defects.append(causes.DEFECT(self.row.name, event, self.state))
            return
        self.state = after

    def started(self, life: Lifeline, block: int, now_ns: int) -> None:
        """Record that the process was just started; `life` reports its death."""
        self.life = life
        self.pid = life.pid
        self.block = block
        self.fence = None
        self.started_ns = now_ns
        self.restart.set(NEVER)
        self._spared_ns = 0
        self.on(STARTED)

    def restart_wait_ns(self, now_ns: int) -> int | None:
        """Record a death and return how long to wait before the restart. The first death in the window restarts at
        once, later ones after a doubling wait. After the limit it returns None: the process stays down and the service
        stopped until a reset, so that it doesn't crash in a loop."""
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
        """True once it has reported that it runs, whether or not the machine lets it run now."""
        return self.state in (RUNNING, HUNG)

    def heard_ns(self) -> int:
        return max(self.beat.ns.get(), self.started_ns)

    def allowed_ns(self) -> int:
        """How long the process may be silent, ns. The time is longer until it has reported that it runs."""
        return self._deadline_ns if self.running() else STARTING_NS

    def spare(self, now_ns: int, silent_ns: int) -> None:
        """Excuse a silence that the machine explains: give the process as long again, from now. `silent_ns` is the
        judged silence; the process may beat meanwhile."""
        self.excused_ns = now_ns
        self._spared_ns = self._spared_ns or now_ns - silent_ns
        self.on(SPARED)

    def beaten(self) -> int:
        """How long a spared process was silent (ns), returned once when it beats again; else 0."""
        silent_ns = self.heard_ns() - self._spared_ns if self._spared_ns else 0
        if silent_ns:
            self._spared_ns = 0
            self.on(BEATS)
        return silent_ns

    def overdue_ns(self) -> int:
        """When the process counts as hanging unless it beats before; NEVER if no beat is expected."""
        if KILLED not in NEXT[self.state]:
            return NEVER
        sign_ns = self.beat.ns.get() if self.running() else self.started_ns
        return max(sign_ns, self.excused_ns) + self.allowed_ns()

    def kill(self, wait_s: float) -> None:
        """Kill the process, and reap it if it ends within `wait_s`."""
        if self.life:
            self.life.kill()
            self.life.wait(wait_s)
            if self.state in ALIVE:
                self.on(TERMINATED)
            self.reap()

    def reap(self) -> str:
        """Reap the dead process and return how it died, in words; empty if it can't be reaped yet, for example while a
        debugger holds it."""
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
