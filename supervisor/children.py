"""Children: the supervisor's record of each process in the process table: its state, deaths, restarts and silences."""

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
"""How long a process may take to start. If it does not report within this time that it runs, it is killed."""
LONGEST_WAIT_NS = 2_000_000_000

# The states of a process, as words that people read.
WAITING = "waiting"  # to be started
DOWN = "down"  # it died too often, so it is not started before a reset
STARTING = "starting"
RUNNING = "running"
HUNG = "hanging"  # silent past its deadline, but the machine explains the silence, so the process is not killed
FENCED = "fenced"  # killed for hanging, and not gone yet
DEAD = "dead"  # its death was noticed and answered, but it is not reaped yet

# The events in the life of a process, as words that people read.
STARTED = "started"
RUNS = "runs"  # the process reports that it runs
SPARED = "spared"  # it is silent, and the machine explains the silence
BEATS = "beats"  # it beats again after it was spared; also before it reports that it runs, and just before its death
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
"""For each state of a process, the next state after each event. An event without an entry should be impossible in that
state. If it happens, failstop has a bug: the process keeps its state, and the robot is stopped. DOWN has an entry for
STARTED, because a gate that is down is started again after a minute."""
ALIVE = tuple(state for state, after in NEXT.items() if TERMINATED in after)


class Fence(Data):
    """The kill of a process that was silent for too long, step by step. Times are CLOCK_MONOTONIC in ns; 0 means that
    the step has not happened."""

    noticed_ns: int
    kill_ns: int
    burst_ns: int
    """When the supervisor wrote the stop on its own descriptor, right after the kill. It writes the stop only if the
    killed process is the port owner. Otherwise 0."""
    silent_ns: int = 0
    was_starved: bool = False
    """True if the machine did not run the process, so the process itself was not at fault."""
    gone_ns: int = 0
    again_ns: int = 0
    """When the supervisor wrote the stop a second time, after the killed port owner was gone."""

    def _steps_us(self) -> list[tuple[str, str, float]]:
        """The steps that have happened, as (name for programs, name for people, time). The time is counted from the
        moment when the hang was noticed, in us."""
        words = (("kill", "killed"), ("burst", "stop written"), ("gone", "gone"), ("again", "stop again"))
        times_ns = (self.kill_ns, self.burst_ns, self.gone_ns, self.again_ns)
        return [(*step, (at - self.noticed_ns) / 1e3) for step, at in zip(words, times_ns, strict=True) if at]

    def story(self, name: str) -> str:
        """The steps as a sentence for people. Each time is in ms, counted from the moment when the hang was noticed."""
        return f"{name} was fenced: {', '.join(f'{told} after {us / 1e3:.1f} ms' for _, told, us in self._steps_us())}"

    def fields(self) -> dict[str, float]:
        """The length of the silence in ms, and the steps in us from the moment when the hang was noticed, as fields for
        programs."""
        return {"silent_ms": round(self.silent_ns / 1e6, 1), **{f"{step}_us": us for step, _, us in self._steps_us()}}


class Child:
    """One process of the process table, with its current state."""

    def __init__(self, row: Process, beat: HeartbeatReader, restart: Timer, settings: Settings) -> None:
        """`row`: the process's row in the process table. `beat`: its heartbeat. `restart`: the timer for its restart.
        `settings`: if the lease (gate.lease_s) is longer than the deadline in the row, the lease is used as the
        deadline. A user sets such a lease on a machine that is too slow for the row's deadline."""
        self.row = row
        self.beat = beat
        self._settings = settings
        self._deadline_ns = max(row.deadline_ns, settings.ns("gate.lease_s"))
        self._deaths: list[int] = []
        """The times of the process's recent deaths. After too many deaths, the process is not restarted."""
        self.state = WAITING
        self.pid = 0
        """The pid of the process. 0 before the process is started, and after it was reaped."""
        self.block = 0
        """The number of the block of futexes that the process holds."""
        self.life: Lifeline | None = None
        self.started_ns = 0
        self.restart = restart
        """The timer for the next start of the process."""
        self.fence: Fence | None = None
        """The record of the kill if the process was killed because it was silent for too long, otherwise None."""
        self.excused_ns = 0
        """The process's silence up to this time is excused. 0 if no silence is excused."""
        self._spared_ns = 0
        """The time of the process's last beat if it is silent because the machine does not run it, otherwise 0."""
        self.defects: list[Cause] = []
        """A cause of a stop for each event that should have been impossible. The supervisor stops the robot for each
        cause, and removes it from the list."""
        self.times_restarted = 0
        self.last_exit = ""
        self.killed = False
        """True if the newest death of the process was by a signal."""

    def on(self, event: str) -> None:
        """Change to the state that NEXT names for this event. If NEXT has no entry for the event, record a defect."""
        after = NEXT[self.state].get(event)
        if after is None:
            self.defects.append(causes.DEFECT(self.row.name, event, self.state))
            return
        self.state = after

    def started(self, life: Lifeline, block: int, now_ns: int) -> None:
        """Record that the process was just started. `life`: the lifeline that reports its death. `block`: the number of
        the block of futexes that it holds."""
        self.life = life
        self.pid = life.pid
        self.block = block
        self.fence = None
        self.started_ns = now_ns
        self.restart.set(NEVER)
        self._spared_ns = 0
        self.on(STARTED)

    def restart_wait_ns(self, now_ns: int) -> int | None:
        """Record a death, and return how long to wait before the restart, ns. Only the deaths in the last
        restart.window_s count. The wait is 0 after the first death, restart.backoff_s after the second, and doubles
        with each further death, up to LONGEST_WAIT_NS. Returns None if at least restart.deaths deaths count: the
        process must then stay down."""
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
        """True if the process has reported that it runs, even while the machine gives it no processor time."""
        return self.state in (RUNNING, HUNG)

    def heard_ns(self) -> int:
        return max(self.beat.ns.get(), self.started_ns)

    def allowed_ns(self) -> int:
        """How long the process may be silent, ns. While it starts, it may be silent for longer."""
        return self._deadline_ns if self.running() else STARTING_NS

    def spare(self, now_ns: int, silent_ns: int) -> None:
        """Excuse a silence, because the machine did not run the process. From `now_ns` on, the process may be silent
        for allowed_ns() once more. `silent_ns`: the length of the silence. The process may have beaten since this
        length was measured."""
        self.excused_ns = now_ns
        self._spared_ns = self._spared_ns or now_ns - silent_ns
        self.on(SPARED)

    def beaten(self) -> int:
        """Return the length of an excused silence, ns, if the process has beaten again since the last call. Otherwise
        return 0."""
        silent_ns = self.heard_ns() - self._spared_ns if self._spared_ns else 0
        if silent_ns:
            self._spared_ns = 0
            self.on(BEATS)
        return silent_ns

    def overdue_ns(self) -> int:
        """The time by which the process must beat. While the process is starting: the time by which it must report that
        it runs. NEVER if neither is expected."""
        if KILLED not in NEXT[self.state]:
            return NEVER
        sign_ns = self.beat.ns.get() if self.running() else self.started_ns
        return max(sign_ns, self.excused_ns) + self.allowed_ns()

    def kill(self, wait_s: float) -> None:
        """Kill the process, and reap it if it is gone within `wait_s`."""
        if self.life:
            self.life.kill()
            self.life.wait(wait_s)
            if self.state in ALIVE:
                self.on(TERMINATED)
            self.reap()

    def reap(self) -> str:
        """Reap the dead process, and return how it died as text. Returns an empty text if the process can't be reaped
        yet, for example because a debugger holds it."""
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
