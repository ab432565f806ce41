"""ProcessTable: starts, reaps and restarts the supervisor's children. It publishes the pid of each child to the
processes that watch the child."""

from __future__ import annotations

import os
import signal
from time import monotonic_ns

from failstop.messages import layout, records, segments
from failstop.messages.packing import Note
from failstop.policy.processes import PROCESSES, Process
from failstop.procs.loop import READ
from failstop.shm.futex import BLOCKS, PER_BLOCK
from failstop.shm.heartbeat import HeartbeatReader
from failstop.shm.lifeline import EarlyNews, Lifeline
from failstop.supervisor import starter
from failstop.supervisor.children import DEAD, DOWN, GIVEN_UP, RUNS, STARTING, Child
from failstop.supervisor.port_handover import OwnPort
from failstop.supervisor.run import Run

TRY_AGAIN_NS = 500_000_000
STARVED_EVERY_NS = 10_000_000_000
STARVED_SHOWN_NS = 600_000_000_000
"""How long the status shows the longest silence of a starved process, counted from the newest such silence of any
process."""
GATE_AGAIN_NS = 60_000_000_000
"""A process that has died too often stays down until a reset. But the gate is started again after this time, because
only the gate can receive a request for a reset."""


class ProcessTable:
    """The processes that the supervisor starts and watches. `early.bell` rings when the death of a process is reported
    early (shm/lifeline.py)."""

    def __init__(self, run: Run, port: OwnPort, advice: str) -> None:
        """Create the children, without starting them. Only the supervisor's main thread may call this: from now on, the
        death of the calling thread counts as the supervisor's death. `advice`: what people can do if the machine gives
        a process no processor time."""
        self._run, self._port = run, port
        self._events, self._loop, self._bells = run.events, run.loop, run.bells
        self._life_words = {row.name: run.own.word(f"{row.name}_life") for row in PROCESSES}
        lifelines = segments.attach(run.memory, "lifelines", run.incarnation, write=True)
        self._held = lifelines.futex("held", layout.SUPERVISOR_BLOCK * PER_BLOCK, write=True).hold(PER_BLOCK)
        self._block = layout.SUPERVISOR_BLOCK
        self.early = EarlyNews(lifelines)
        self._words = {"name": run.name, "run": f"{run.incarnation:x}", "dir": run.runtime_dir, "parent": os.getpid()}
        self._environment = starter.environment(run.settings)
        self.children = [
            Child(row, HeartbeatReader(run.views[row.name]), run.loop.timer(), run.settings) for row in PROCESSES
        ]
        self._advice = advice
        self._starved_logged_ns = self._starved_ns = self._starved_times = 0
        self._starved = (0, "")
        """(The longest recent silence of a starved process in ms, the name of the process)."""
        self._notes = {name: run.views[name].ring_reader("notes") for name in (layout.GATE, layout.TELEMETRY)}
        self._by_name = {child.row.name: child for child in self.children}

    def __getitem__(self, name: str) -> Child:
        return self._by_name[name]

    def died(self, ready: dict[int, int]) -> list[Child]:
        """The processes whose death was not handled yet. `ready`: the descriptors that have just woken the loop."""
        return [child for child in self.children if child.life and child.state != DEAD and child.life.died(ready)]

    def reap(self, ready: dict[int, int], now_ns: int) -> None:
        """Reap the processes that have died, and plan their restarts."""
        for child in self.children:
            if child.life and child.life.fd in ready:
                self._loop.forget(child.life.fd)  # the pidfd stays readable until it is reaped, which may take long
            pid = child.pid
            if child.state == DEAD and (death := child.reap()):
                self._log_death(child, pid, death)
                self._plan_restart(child, now_ns)

    def _log_death(self, child: Child, pid: int, death: str) -> None:
        name = child.row.name
        fields: dict[str, str | int] = {"process": name, "pid": pid}
        if child.fence:
            self._events.log("fenced", child.fence.story(name), {**fields, **child.fence.fields()})
        how = f"was {death}" if child.killed else death
        self._events.log("died", f"{name} (pid {pid}) {how}", {**fields, "how": how})

    def _plan_restart(self, child: Child, now_ns: int) -> None:
        name = child.row.name
        starved = child.fence is not None and child.fence.was_starved
        wait_ns = TRY_AGAIN_NS if starved else child.restart_wait_ns(now_ns)
        if wait_ns is not None:
            self._restart_in(child, wait_ns, now_ns)
            return
        child.on(GIVEN_UP)
        text, step = f"{name} died too often, so it stays down and the wheels stay stopped", ""
        if name == layout.GATE:
            child.restart.set(now_ns + GATE_AGAIN_NS)
            text += f"; it is restarted in {GATE_AGAIN_NS / 1e9:g} s, because only it can hear a reset"
        else:
            step = f"fix the cause, then {self._events.command('reset')} restarts it"
        self._events.log("down", text, {"process": name}, step=step)

    def _restart_in(self, child: Child, wait_ns: int, now_ns: int) -> None:
        child.restart.set(now_ns + wait_ns)
        text = f"restarting {child.row.name} {f'in {wait_ns / 1e9:g} s' if wait_ns else 'now'}"
        self._events.log("restarting", text, {"process": child.row.name, "wait_s": wait_ns / 1e9})

    def recall(self, now_ns: int) -> None:
        """Restart the processes that died too often. Call this after a reset."""
        for child in self.children:
            if child.state == DOWN:
                child.recalled()
                self._restart_in(child, 0, now_ns)

    def watch_early(self) -> None:
        """For each process that has just reported that it runs, start a thread that waits for the early report of its
        death (shm/lifeline.py). If the port owner dies, its thread also writes a stop at once."""
        for child in self.children:
            if child.state == STARTING and child.beat.running(child.pid):
                child.on(RUNS)
                self._ring_watchers()
                if child.life:
                    stop = self._port.early_stop if child.row.name == layout.PORT_OWNER else None
                    self.early.watch_block(child.life, child.block, 0, stop, child.row.priority)

    def _ring_watchers(self) -> None:
        """Make the port owner and the stopper read the new pids of the processes that they watch."""
        self._bells[layout.PORT_OWNER].ring()
        self._bells[layout.STOPPER].ring()

    def restart_due(self, now_ns: int) -> None:
        """Restart the processes whose waiting time before the restart is over."""
        for child in self.children:
            if child.restart.due(now_ns):
                child.times_restarted += 1
                self.start(child)

    def start(self, child: Child) -> None:
        """Start a process, and publish its pid to the processes that watch it. The process inherits the port."""
        name, block, pid, life = child.row.name, self._free_block(), 0, None
        try:
            pid = self._spawn(child.row, block)
            life = Lifeline(pid)
            self._loop.watch(life.fd, READ)
        except OSError as error:
            if pid:  # out of descriptors: without its pidfd, nobody would notice the death of this process
                os.kill(pid, signal.SIGKILL)
                starter.reap(pid, 0)
            if life:
                life.close()
            text = f"cannot start {name}: {error}; trying again"
            self._events.log("start_failed", text, {"process": name, "reason": str(error)})
            child.restart.set(monotonic_ns() + TRY_AGAIN_NS)
        else:
            child.started(life, block, monotonic_ns())
            self._life_words[name].set(records.life(pid, block))
            self._ring_watchers()

    def _spawn(self, row: Process, block: int) -> int:
        """Start a process, and return its pid. Its command line has the number of its block of futexes, the descriptors
        that it inherits (-1 for one that is not open), and the number of the port. Raises OSError."""
        known = self._run.descriptors(row.name, self._port.fd)
        given = {key: known[key] for key in row.descriptors}
        words = {**self._words, "block": block, "number": self._port.number, **given}
        arguments = starter.script_command(starter.BOOTSTRAP, row.name, words=words)
        return starter.spawn(arguments, self._environment, [fd for fd in given.values() if fd >= 0])

    def pass_notes(self) -> None:
        """Log the notes for people that the gate and telemetry have written."""
        for process, ring in self._notes.items():
            while entry := ring.next():
                try:
                    note = Note.unpack(entry[2])
                except ValueError:
                    continue  # a damaged note; nothing depends on it
                fields = {"process": process, **note.fields}
                self._events.log(note.kind, note.text, fields, level=note.level, step=note.step)

    def report_spared(self, now_ns: int) -> None:
        """Log each starved process that beats again, with the length of its silence. Call this once per turn."""
        for child in self.children:
            if silent_ns := child.beaten():
                self.log_starved(child.row.name, silent_ns, now_ns)

    def log_starved(self, name: str, silent_ns: int, now_ns: int) -> None:
        """Log that the machine did not run the process `name` for `silent_ns`. The first such silence is logged at
        once. Later ones are logged at most every ten seconds."""
        silent_ms = round(silent_ns / 1e6)
        self._starved = max(self._shown_starved(now_ns), (silent_ms, name), key=lambda starved: starved[0])
        self._starved_times += 1
        self._starved_ns = now_ns
        if self._starved_logged_ns and now_ns - self._starved_logged_ns < STARVED_EVERY_NS:
            return
        self._starved_logged_ns = now_ns
        text = f"the computer is too busy: {name} did not run for {silent_ms} ms; {self._advice}"
        self._events.log("starved", text, {"process": name, "silent_ms": silent_ms, "times": self._starved_times})

    def _shown_starved(self, now_ns: int) -> tuple[int, str]:
        return self._starved if now_ns - self._starved_ns < STARVED_SHOWN_NS else (0, "")

    def starved_record(self) -> dict[str, object]:
        """Fields for clients about starved processes: the longest recent silence of a starved process, and how many
        such silences this run has had."""
        longest_ms, process = self._shown_starved(monotonic_ns())
        shown = {"longest_ms": longest_ms, "process": process} if process else None
        return {"starved": shown, "starved_times": self._starved_times}

    def _free_block(self) -> int:
        """The number of a block of futexes that no living process holds."""
        held = {child.block for child in self.children if child.pid} | {layout.SUPERVISOR_BLOCK}
        self._block = next(b for i in range(1, BLOCKS) if (b := (self._block + i) % BLOCKS) not in held)
        return self._block
