"""The supervisor's loop. Only the supervisor raises the epoch, which counts the stops.

Each turn of the loop runs in this order:

1. If the port owner has died, write the stop burst.
2. If any process has died, or has noticed a cause of a stop, raise the epoch and ring the bells of the port owner and
   the gate. The port owner then writes a stop.
3. Start, watch, kill and reap processes.
4. Log and publish what has happened.
"""

from __future__ import annotations

import os
import signal
from time import monotonic_ns, sleep

import msgpack

from failstop.board.interface import SUPERVISOR_ROW
from failstop.messages import layout, records
from failstop.notify import Notify
from failstop.policy import causes
from failstop.policy.processes import HANG_NS, SUPERVISOR_PRIORITY
from failstop.policy.proofs import LINK_UNASKED, LINK_UNPROVEN, WAITS_FOR
from failstop.procs import rights, starved
from failstop.procs.loop import MS
from failstop.procs.schedule import Repeats
from failstop.shm import heartbeat
from failstop.shm.heartbeat import Heartbeat
from failstop.shm.words import Barrier
from failstop.supervisor.blackbox import BlackBox
from failstop.supervisor.children import ALIVE, KILLED, RUNNING, TERMINATED, Child, Fence
from failstop.supervisor.latch import Epochs
from failstop.supervisor.port_handover import OwnPort, PortHandover, outcome
from failstop.supervisor.process_table import ProcessTable
from failstop.supervisor.run import Run
from failstop.supervisor.status import LEASE, Status, advice, lacking
from failstop.supervisor.stop_tracker import StopTracker
from failstop.supervisor.stops import Stop, explained

TICK_NS = 20 * MS
"""The time between two beats of the supervisor. Each beat allows motion for one lease (gate.lease_s), which is three
ticks long by default."""
AT_REST_NS = 2 * TICK_NS
"""The time between two beats of the supervisor while nothing can move. No process checks the lease then, so a longer
time is enough, and it saves processor time."""
BEATS_ALONE = 2
"""While nothing happens, the supervisor only beats for this many ticks, and in the tick after them it also checks
everything. Anything that the supervisor must handle wakes its loop earlier."""
STOP_ANSWER_NS = 5_000_000
"""How long the port owner may take to answer a new epoch with a stop. After this time, the supervisor writes the burst
itself."""
HURRY_NS = 1_000_000
EXCUSE_NS = 60_000_000
"""If the supervisor did not run for this long, it could not watch the other processes, so it excuses their silence. The
value is two ticks less than the shortest deadline of a process."""
CLIENT_SILENT_NS = 150_000_000
"""If the port owner, telemetry or the supervisor was silent for this long, the machine is probably holding it up, and
the board's answers may be read late. A healthy process beats at least ten times per second."""
HEAR_NS = 300_000_000
"""How long the supervisor waits, at most, for the board's answer to the first stop at the end of the service. The ping
that the board answers may be sent up to 50 ms after that stop (schedule.py)."""
END_S = 2.0
"""How long the supervisor waits, at most, for each process that it kills at the end of the service, s. Then it writes
the last burst."""


class Supervisor:
    """The supervisor. Call turn() at each wake-up, and then rest(), which sleeps until the next wake-up."""

    def __init__(self, run: Run, port: OwnPort, notify: Notify) -> None:
        self._run, self._port = run, port
        self.loop, self._events = run.loop, run.events
        self._granted = rights.request_rights(SUPERVISOR_PRIORITY)
        self.heartbeat = Heartbeat(run.own, os.getpid(), self._granted, monotonic_ns())
        self._advice = advice(realtime=bool(self._granted & heartbeat.REALTIME), managed=notify.active)
        self.processes = ProcessTable(run, port, self._advice)
        self.children = self.processes.children
        self.epochs = Epochs(run)
        self.tracker = StopTracker(run, self.epochs.latch, port.board, port.holds, self._motion)
        self.blackbox = BlackBox(run, self._motion)
        self.handover = PortHandover(run, port, self.processes)
        self.status = Status(run, notify, self.processes, self.epochs, self.handover)
        self._gate_record = run.views[layout.GATE].latest_reader("state")
        self._moving_word = run.views[layout.PORT_OWNER].word("moving")
        self._busy_word = run.views[layout.GATE].word("busy")
        self._barrier = Barrier()
        self._written_word = run.own.word("written_ns")
        self._port_owner_written = run.views[layout.PORT_OWNER].word("written_ns")
        self._stops = {name: run.views[name].ring_reader("stops") for name in (layout.PORT_OWNER, layout.GATE)}
        self.status.publish(self.status.missing(stopping=False))
        self._unanswered: Stop | None = None
        self._due = self.loop.timer()
        """The timer for the next time limit, at which the port owner must have answered a stop, or a process must have
        beaten."""
        self._turned_ns = self._watched_ns = monotonic_ns()
        self._repeats = Repeats(self.loop.timer(), port.board.repeats_ns[SUPERVISOR_ROW], self._turned_ns)
        self._repeats.restart(self._turned_ns)
        self.ending = False
        self.broken = False
        """True if the service can't go on. It then ends as soon as the last stop has been answered."""
        self.loop.listen(run.bells[layout.SUPERVISOR], self.processes.early.bell)

    def end(self, _number: int, _frame: object) -> None:
        """Handle SIGTERM and SIGINT: wake the loop, which then ends the service."""
        self.ending = True
        self._run.bells[layout.SUPERVISOR].ring()

    def turn(self, ready: dict[int, int]) -> None:
        now_ns = monotonic_ns()
        self._stop_for_news(ready, now_ns)
        held_up = self._is_held_up(now_ns)
        listening = self._listening() and (not held_up or self._motion())
        self._raise_epoch(self.tracker.poll(now_ns, listening=listening, held_up=held_up))
        self.processes.reap(ready, now_ns)
        self.processes.watch_early()
        self._follow_port(ready, now_ns)
        self._record_answer(now_ns)
        if not self._unanswered and self.epochs.decide_reset():  # once the last stop is written
            self.processes.recall(now_ns)
        self.processes.report_spared(now_ns)
        self._fence_hangs(now_ns)
        self._stop_alone(now_ns)
        self._check_names(now_ns)
        self.processes.restart_due(now_ns)
        self._raise_epoch([Stop(now_ns, layout.SUPERVISOR, it.defects.pop()) for it in self.children if it.defects])
        self.processes.pass_notes()
        self._publish(now_ns)
        self.blackbox.poll(now_ns, ready=self.status.ever)
        self.heartbeat.beat(now_ns)
        self._events.flush(now_ns, hold=self._unanswered is not None)
        late_ns = [self._unanswered.answer_by_ns] if self._unanswered else []
        self._due.set(min([*late_ns, *(child.overdue_ns() for child in self.children)]))

    def rest(self) -> dict[int, int]:
        """Sleep until something happens or a timer is due. Returns the descriptors that are ready."""
        for _ in range(BEATS_ALONE):
            ready = self.loop.wait(self._tick_ns())
            now_ns = monotonic_ns()
            late = now_ns - self._turned_ns >= EXCUSE_NS
            if ready or late or self._unanswered or now_ns >= self.loop.due_ns():
                return ready
            self._watched_ns, self._turned_ns = self._turned_ns, now_ns
            self.heartbeat.beat(now_ns)
        return self.loop.wait(self._tick_ns())

    def _tick_ns(self) -> int:
        return TICK_NS if self._busy_word.get() or self._moving_word.get() else AT_REST_NS

    def _stop_for_news(self, ready: dict[int, int], now_ns: int) -> None:
        """Stop the robot if a process has died or has noticed a cause of a stop. If the port owner has died, write the
        burst before the epoch is raised."""
        gap_ns = now_ns - self._turned_ns
        # True if a signal suspended this process since the last turn: SIGCONT has continued it, and is blocked
        # (entry.py).
        continued = gap_ns >= EXCUSE_NS and signal.sigtimedwait((signal.SIGCONT,), 0)
        suspended_ns = gap_ns if continued else 0
        dead = self.processes.died(ready)
        port_owner = self.processes[layout.PORT_OWNER]
        written_ns = self._burst() if port_owner in dead else 0
        for child in dead:
            if child.fence:
                child.fence.gone_ns, child.fence.again_ns = now_ns, written_ns if child is port_owner else 0
        self._raise_epoch(self._collect(dead, now_ns, written_ns, suspended_ns) + self._held_up(now_ns, suspended_ns))

    def _burst(self) -> int:
        """Write the burst on the supervisor's own descriptor. Returns the time of the write, ns, or 0 if it failed."""
        written, now_ns = self._port.burst(), monotonic_ns()
        self._repeats.restart(now_ns)
        return self._wrote(now_ns) if written else 0

    def _wrote(self, written_ns: int) -> int:
        """Record that a burst was written on the supervisor's own descriptor at `written_ns`. Returns that time."""
        self.epochs.owed_ns = 0
        self._written_word.set(written_ns)
        self.blackbox.wrote(written_ns)
        return written_ns

    def _follow_port(self, ready: dict[int, int], now_ns: int) -> None:
        """Handle the loss and the return of the port. Writes the burst if the thread that opened the port could not
        write it."""
        stranger, sure = self.handover.misplaced, self.handover.sure
        if self.handover.lost(ready, now_ns):
            self.tracker.link.opened(now_ns, sure=sure)
            if stranger:  # the port owner still has the wrong device open, and takes it for the board
                self._raise_epoch([Stop(now_ns, layout.SUPERVISOR, causes.DEVICE_LOST())])
        opened_ns = self.handover.opened(now_ns)
        if opened_ns is not None:
            self._repeats.restart(now_ns)
            written_ns = self._wrote(opened_ns) if opened_ns else self._burst()
            self.handover.log_return(now_ns, written=written_ns > 0)
            self.tracker.opened(written_ns, now_ns, sure=self.handover.sure)
        if self.tracker.link.believed:
            self.handover.believe()
        if where := self.handover.where:
            self._run.follow_port(*where)
        self.handover.make_up(now_ns)

    def _stop_alone(self, now_ns: int) -> None:
        """While no running port owner has the port open, repeat the newest stop on the supervisor's own descriptor.
        After the repeats, write the burst again every ZERO_EVERY_NS (procs/schedule.py)."""
        served = self.processes[layout.PORT_OWNER].running() and self.handover.has(layout.PORT_OWNER)
        self._repeats.wait(self._port.free_ns)
        if served:
            self._repeats.end()  # this port owner stops by itself, and motion may have been commanded since
        elif self._repeats.pop(now_ns) and self._port.burst():
            self._wrote(monotonic_ns())

    def _held_up(self, now_ns: int, suspended_ns: int) -> list[Stop]:
        """Check whether the supervisor itself did not run for a while. If so, excuse the other processes' silence in
        that time. Returns a list with one stop if the supervisor did not run for HANG_NS or longer and _motion() is
        True. If _motion() is False, such a gap is only logged, and the list is empty. `suspended_ns`: how long a signal
        suspended the supervisor since its previous turn; 0 if no signal did."""
        self._watched_ns, self._turned_ns = self._turned_ns, now_ns
        gap_ns = now_ns - self._watched_ns
        if gap_ns >= EXCUSE_NS:
            for child in self.children:
                child.excused_ns = now_ns
        if gap_ns < HANG_NS or not self.status.ever:
            return []
        cause = explained(causes.HELD_UP(gap_ns // MS), suspended_ns)
        if self._motion():
            return [Stop(now_ns, layout.SUPERVISOR, cause)]
        if suspended_ns:
            self._events.log("suspended", str(cause), {"silent_ms": gap_ns // MS})
        else:
            self.processes.log_starved(layout.SUPERVISOR, gap_ns, now_ns)
        return []

    def _check_names(self, now_ns: int) -> None:
        """Stop the robot and end the service if a name of its shared memory or pipes was removed (Run.lost())."""
        if cause := self._run.lost(now_ns):
            self.broken = True
            self._raise_epoch([Stop(now_ns, layout.SUPERVISOR, cause)])
        self.ending |= self.broken and self._unanswered is None

    def _listening(self) -> bool:
        """True while the port owner can write pings and telemetry can decode the answers. Otherwise, an unanswered ping
        does not prove that the board is deaf."""
        asks, hears = self.processes[layout.PORT_OWNER], self.processes[layout.TELEMETRY]
        return self._port.fd >= 0 and asks.state == hears.state == RUNNING

    def _is_held_up(self, now_ns: int) -> bool:
        """True if the machine holds up the port owner, telemetry or the supervisor, so that the board's answers are
        read late."""
        asks, hears = self.processes[layout.PORT_OWNER], self.processes[layout.TELEMETRY]
        heard_ns = min(asks.heard_ns(), hears.heard_ns(), self._watched_ns)
        return now_ns - heard_ns >= CLIENT_SILENT_NS

    def _collect(self, dead: list[Child], now_ns: int, burst_ns: int, suspended_ns: int) -> list[Stop]:
        """The stops for all causes that other processes have noticed, and for all processes in `dead`. `burst_ns`: when
        the supervisor wrote the burst for the port owner's death; 0 if it did not."""
        stops = []
        for process, ring in self._stops.items():
            while entry := ring.next():
                _, cause_ns, written_ns, cause = records.STOPPED.unpack(entry[2])
                stops.append(Stop(cause_ns, process, explained(causes.read(cause), suspended_ns), written_ns))
        for child in dead:
            child.on(TERMINATED)
            death = causes.DIED(child.row.name)
            if death not in (stop.cause for stop in stops):
                stops.append(Stop(now_ns, layout.SUPERVISOR, death, burst_ns))
        return stops

    def _raise_epoch(self, stops: list[Stop]) -> None:
        """Raise the epoch for stops that came at the same time. The port owner then has STOP_ANSWER_NS to answer. Does
        nothing if `stops` is empty."""
        if not stops:
            return
        self.epochs.raise_for(stops, monotonic_ns())
        if self._unanswered is None:
            self._unanswered = min(stops, key=lambda stop: stop.t_ns)
            self._unanswered.answer_by_ns = monotonic_ns() + STOP_ANSWER_NS
        latch = self.epochs.latch
        if latch.stop and latch.since == self.epochs.number:
            self.tracker.latched(latch.stop)
            if not self.ending:
                self.blackbox.latched(latch.stop, self.epochs.number)
        for stop in stops:
            if stop is not self._unanswered:
                self.tracker.also(stop)
        self._run.bells[layout.TELEMETRY].ring()  # so that it reads the board's answer

    def _record_answer(self, now_ns: int) -> None:
        """Record the port owner's answer to the new epoch, if it has come. If the port owner is dead or late, the
        supervisor writes the burst itself."""
        stop = self._unanswered
        if stop is None:
            return
        port_owner = self.processes[layout.PORT_OWNER]
        found = stop.who_wrote(
            answered=self.epochs.answered(),
            may_answer=port_owner.state in ALIVE and now_ns < stop.answer_by_ns,
            port_owner_ns=self._port_owner_written.get(),
        )
        if found is None:
            return
        by, written_ns = found
        self._unanswered = None
        stop.answered_by(by, written_ns or self._burst(), self.epochs.latch.stop or stop, self.epochs.number)
        self.tracker.answered(stop, ending=self.ending)

    def _motion(self) -> bool:
        """True if motion is enabled in the current epoch, or if the port owner has written motion and no complete burst
        after it.

        Read all other values that your decision needs before you call this. Then no motion is missed, because the port
        owner publishes that it writes motion before it checks the epoch for the last time.
        """
        self._barrier()
        if self._moving_word.get():
            return True
        entry = self._gate_record.read()
        gate = msgpack.unpackb(entry[2]) if entry else {}
        return bool(gate.get("enabled")) and gate["epoch"] == self.epochs.number

    def _fence_hangs(self, now_ns: int) -> None:
        """Handle each process that has missed its deadline. A timer wakes the supervisor exactly at the deadline."""
        for child in self.children:
            if now_ns >= child.overdue_ns():
                is_starved = starved.look(child.pid, child.beat, child.allowed_ns(), self._run.bells[child.row.name])
                silent_ns = now_ns - child.heard_ns()
                if now_ns >= child.overdue_ns():  # otherwise it has just beaten
                    self._answer_silence(child, now_ns, silent_ns, is_starved=is_starved)

    def _answer_silence(self, child: Child, now_ns: int, silent_ns: int, *, is_starved: bool) -> None:
        """Handle the silence of a process as the table says. A starved process is silent only because the machine does
        not run it.

            motion    starved port owner          other starved process       hanging process
            enabled   stopped, latched, killed    stopped, latched            stopped, latched, killed
            disabled  logged                      logged                      stopped, latched, killed

        A starved process is normally not killed, because a new process would be starved too. But a starved port owner
        could still write a frame after the burst, so it is killed while motion is enabled.

        A process that was starved for longer than starved.LONGEST_NS is killed too. But such a death does not count
        towards the limit for restarts. After a kill, the supervisor notices the death and restarts the process.
        """
        name = child.row.name
        kind = causes.STARVED if is_starved else causes.HANGS
        stop = Stop(now_ns, layout.SUPERVISOR, kind(name, silent_ns // MS))
        motion = self._motion()
        spared = is_starved and silent_ns < child.allowed_ns() + starved.LONGEST_NS
        if spared and not (motion and name == layout.PORT_OWNER):
            child.spare(now_ns, silent_ns)
            if motion:
                self._raise_epoch([stop])
            return
        # Kill before the burst. A port owner that wakes up between the burst and its kill could write one more frame.
        os.kill(child.pid, signal.SIGKILL)
        kill_ns = monotonic_ns()
        stop.written_ns = self._burst() if name == layout.PORT_OWNER else 0
        self._raise_epoch([stop])
        child.fence = Fence(now_ns, kill_ns, stop.written_ns, silent_ns, was_starved=is_starved)
        child.on(KILLED)

    def _publish(self, now_ns: int) -> None:
        """Publish why motion can't be enabled yet, and notify the service manager."""
        link = self.tracker.link
        missing = self.status.missing(stopping=self._unanswered is not None)
        missing = missing or (WAITS_FOR[link.state] if link.forbids else "") or self.tracker.wheel_servos.waited_for()
        if self.status.publish(missing):
            self.heartbeat.state(heartbeat.BEAT_RUNNING, now_ns)
            for what, text in lacking(self._granted, self._advice, self._run.settings[LEASE]):
                self._events.log("rights", text, {"what": what})
        self.status.log_waiting(missing, now_ns)
        if self.epochs.answered():
            self.epochs.owed_ns = 0
        self.status.notify_manager(now_ns, missing, self.epochs.owed_ns if self._port.fd >= 0 else 0)

    def finish(self) -> bool:
        """End the service. The port owner writes a first stop, and the supervisor waits for the board's answer. Then it
        kills every process, and writes a second stop on its own descriptor.

        Returns True if the second stop was sent and the board has answered the first one. A board that has never
        answered, or has no pings, need not answer.
        """
        stop = Stop(monotonic_ns(), layout.SUPERVISOR, causes.STOPPING())
        self._raise_epoch([stop])
        while self._unanswered:
            stop, now_ns = self._unanswered, monotonic_ns()
            if now_ns >= stop.answer_by_ns:  # it hangs, maybe while it writes motion; the burst must come after that
                self.processes[layout.PORT_OWNER].kill(0)
            self._record_answer(now_ns)
            if self._unanswered:
                sleep(HURRY_NS / 1e9)  # the loop's wait would return at once, because nobody handles the dead any more
        heard_ns = self._hear(stop.written_ns)
        link = self.tracker.link.state
        self.status.notify.stopping(f"{outcome(written=stop.written_ns > 0)}; ending every process")
        self.heartbeat.state(heartbeat.BEAT_STOPPING, monotonic_ns())
        for child in reversed(self.children):
            child.kill(END_S)
        self._follow_port({}, monotonic_ns())  # the port may have come back meanwhile
        written = self._burst() > 0
        self._port.repeat(self._port.board.repeats_ns[SUPERVISOR_ROW])
        sent = written and self._port.drain()
        self.tracker.ended(heard_ns, link, written=written, sent=sent)
        self._events.flush()
        self.blackbox.finish()
        return sent and (heard_ns > 0 or link in (LINK_UNPROVEN, LINK_UNASKED))

    def _hear(self, stop_ns: int) -> int:
        """Wait until the board acknowledges the stop that was written at `stop_ns` (0 if no stop was written). The port
        owner must still run to send pings, and telemetry must still run to read the answers.

        Returns how long the acknowledgement took, ns, or 0 if it did not come in time. The time limit is HEAR_NS, or
        twice Board.echo_ns for a board without pings.
        """
        echo_ns = 2 * self._port.board.echo_ns
        until_ns = monotonic_ns() + (echo_ns if self.tracker.link.state == LINK_UNASKED else HEAR_NS)
        while stop_ns and (now_ns := monotonic_ns()) < until_ns and self._listening() and not self._is_held_up(now_ns):
            self.tracker.poll(now_ns, listening=True)
            sent_ns, arrival_ns = self.tracker.heard
            if sent_ns >= stop_ns:
                return arrival_ns - stop_ns
            self._watched_ns = now_ns
            self.heartbeat.beat(now_ns)
            sleep(HURRY_NS / 1e9)
        return 0
