"""The port owner's loop. It handles causes of stops first, then motion, then the bytes that the board has sent.

Between noticing a cause and writing the burst, nothing blocks, logs or builds bytes. That is possible because the burst
was built at the start and the port is already open.
"""

from __future__ import annotations

from collections import deque
from time import monotonic_ns

from failstop.board.interface import PORT_OWNER_ROW
from failstop.messages import layout, records
from failstop.policy import causes, kinematics
from failstop.policy.causes import Cause
from failstop.policy.processes import HANG_NS
from failstop.procs.context import Context
from failstop.procs.loop import MS, NEVER, Loop
from failstop.procs.peer import Parent, Peer
from failstop.procs.port_owner import admission, requests
from failstop.procs.port_owner.admission import Admission, BusSchedule, DatedFrame
from failstop.procs.port_owner.motion_writer import MotionWriter
from failstop.procs.port_owner.port import OpenPort
from failstop.procs.port_owner.port_writer import PortWriter
from failstop.procs.port_owner.requests import RequestPipe
from failstop.procs.schedule import REFRESH, REPEAT, Repeats
from failstop.procs.suspend import SuspendWatch
from failstop.shm.lifeline import give_way
from failstop.shm.words import Barrier

TICK_NS = 33 * MS
"""The longest time between two turns, in ns. It is a third of the port owner's deadline (policy/processes.py), the time
for which it may be silent. Anything that it must notice sooner rings a bell or sets a timer."""
OTHER_BACKLOG = 128
"""A frame that is not motion is written only if at most this many bytes are still on their way to the board. A stop
behind these bytes has to wait up to 1.3 ms for them."""
MOST_OTHERS = 8
"""How many frames that are not motion may wait. They wait while the line must be silent, because some boards need a
pause between two frames. If there are more, the oldest are dropped."""


class PortOwner:
    """The port owner: owns the port and writes all frames to it. Call turn() once per wake-up."""

    def __init__(self, context: Context) -> None:
        settings, board = context.settings, context.board
        self.heartbeat = context.heartbeat
        self.loop = Loop()
        self.board = board
        self.admission = Admission(board, settings.ns("gate.lease_s"), kinematics.max_wheel_rps(settings) * 1.001)
        self.bus = BusSchedule(board.arm, settings.servos())
        self._stops_servos = bool(board.arm and board.arm.stops(settings.servos()))
        self.repeats = Repeats(self.loop.timer(), board.repeats_ns[PORT_OWNER_ROW], monotonic_ns())
        self._held: DatedFrame | None = None
        """The motion frame that waits until the line has been silent, because some boards need a pause between two
        frames. None if no frame waits. The timer `_line` is set to the end of the silence."""
        self._line = self.loop.timer()
        self.suspend = SuspendWatch()
        self._lapse = self.loop.timer()
        """A timer that is set while something moves. It is due when a lease ends, or when the gate has sent no new
        motion for too long."""
        self._arm_due = self.loop.timer()
        """A timer that is due when the next waiting frame for the arm may be written."""
        self._others: deque[bytes] = deque(maxlen=MOST_OTHERS)
        """Frames that are not motion and that wait to be written. The timer `_others_due` is set to the time when the
        first one may be written."""
        self._others_due = self.loop.timer()
        self._barrier = Barrier()
        self._moved_ns = 0
        self._arm_moved = False
        """True if a servo was moved since the last stop."""
        self._silence_ns = 2 * settings.ns("gate.refresh_s")
        self._stuck = False
        self.wire = PortWriter(context.fd("port"), board, self.bus.servos)
        self.port = OpenPort(context, self.loop, self.wire, monotonic_ns())
        self.motion_writer = MotionWriter(context, self.wire, self.port)
        self._attach(context)
        self._watch_others(context)
        self.epoch = self._epoch_word.get()
        self._burst()
        self._stopped_word.set(self.epoch)
        self.wire.keep(context.own.ring_writer("box"))
        self.port.begin(monotonic_ns())

    def _attach(self, context: Context) -> None:
        """Create the writers of the port owner's records, and the bells that it rings."""
        own = context.own
        self._pid_word, self._pid = (word := own.word("beat_pid")), word.get()
        self._stopped_word = own.word("stopped_epoch")
        self._written_word = own.word("written_ns")
        self._moving_word = own.word("moving")
        self._stops = own.ring_writer("stops")
        self._supervisor_bell = context.bell("supervisor_bell")

    def _watch_others(self, context: Context) -> None:
        """Create the readers of other processes' records, and watch everything that wakes the port owner."""
        supervisor = context.segment("supervisor")
        self._epoch_word = supervisor.word("epoch")
        self._latch = supervisor.latest_reader("latch")
        self._supervisor_beat = supervisor.word("beat_ns")
        self._frames = context.segment("gate").ring_reader("frames")
        self._causes = context.segment("telemetry").ring_reader("causes")
        self.loop.listen(context.bell("bell"), context.early.bell)
        self._requests = RequestPipe(context.fd("stop"), self.loop)
        self._parent = Parent(context, self.loop, 0, self.wire, early=True)
        names = (layout.GATE, layout.TELEMETRY, layout.STOPPER)
        self._peers = tuple(Peer(name, context, self.loop, self.wire) for name in names)
        self._gate, self._telemetry = self._peers[:2]

    def turn(self, ready: dict[int, int]) -> bool:
        """Handle one wake-up. Returns False when it is time to exit."""
        now_ns = monotonic_ns()
        if self._requests.asked(ready, now_ns):
            self._stop_request(now_ns)
        self._hear_causes()
        self._answer_deaths(ready, now_ns)
        self._follow_epoch(now_ns)
        self._check_suspend(now_ns)
        self._check_leases(now_ns)
        self._check_drain(now_ns)
        self._forward_frames()
        self._follow_port(ready, now_ns)
        self.motion_writer.check_restart(now_ns)
        self._repeat(now_ns)
        self.port.configure(now_ns)
        self.port.ask(now_ns)
        self.port.watch(heard=self._telemetry.runs())
        self.heartbeat.beat(now_ns)
        return not self._parent.leave(now_ns)

    def stop(self, cause_ns: int, cause: Cause) -> None:
        """Stop for a cause that the port owner itself has noticed. Write the burst, publish the cause, and refuse
        motion until the supervisor has raised the epoch."""
        self.wire.burst()
        self._own_stop(cause_ns, monotonic_ns(), cause)

    def _own_stop(self, cause_ns: int, written_ns: int, cause: Cause) -> None:
        """Record a burst that was written for a cause which the port owner itself has noticed, and publish the cause.
        The stop belongs to the newest epoch, even if _follow_epoch() has not noticed this epoch yet."""
        epoch = self._epoch_word.get()
        self.admission.stopped(epoch, written_ns)
        written_ns = self._stopped(written_ns)
        self._stops.put(records.STOPPED.pack(epoch, cause_ns, written_ns, cause.pack()))
        self._supervisor_bell.ring()

    def _burst(self) -> None:
        """Write a stop without publishing a cause. Use it if the supervisor knows the cause already, or if the stop
        needs none."""
        self.wire.burst()
        self._stopped(monotonic_ns())

    def _stopped(self, written_ns: int) -> int:
        """Record that a burst was written at `written_ns`. Returns this time, or 0 if the kernel did not take the whole
        burst."""
        self.admission.wheels_move = self._arm_moved = False
        self.bus.waiting.clear()
        self._pop_held()
        self._lapse.set(NEVER)
        self.repeats.restart(written_ns)
        self.port.pings.stopped(written_ns)
        self.motion_writer.stopped()
        self.port.commands(self.board.burst, written_ns)
        if self.wire.lost or self.wire.unsent:
            return 0
        self._written_word.set(written_ns)
        # A board that needs a pause between two frames may lose a stop that follows too soon. So after motion, the word
        # `moving` is cleared only when the stop was repeated.
        if not (self.board.after_ns and self._moved_ns):
            self._moving_word.set(0)
        return written_ns

    def _stop_request(self, now_ns: int) -> None:
        self.wire.burst()
        written_ns = monotonic_ns()
        give_way()
        self._own_stop(now_ns, written_ns, self._requests.accept(now_ns))

    def _hear_causes(self) -> None:
        """Stop for each cause that telemetry has sent, for example for a pressed button. An empty cause only repeats
        the stop (_stop_again)."""
        while entry := self._causes.next():
            if not entry[2]:
                self._stop_again()
                continue
            self.wire.burst()
            self._own_stop(entry[1], monotonic_ns(), causes.read(entry[2]))

    def _stop_again(self) -> None:
        """Write the stop of the wheels again, without a cause and without stopping the arm. While the line must be
        silent, write nothing, because the next zero frame stops the wheels too."""
        if self.wire.free_ns <= monotonic_ns():
            self.motion_writer.disarm()
            self.wire.frame(self.board.burst, backlog=OTHER_BACKLOG)

    def _answer_deaths(self, ready: dict[int, int], now_ns: int) -> None:
        self.wire.heed()
        dead = [peer for peer in self._peers if peer.died(ready)]
        orphaned = self._parent.died(ready)
        if not dead and not orphaned:
            return
        self.wire.burst()
        written_ns = monotonic_ns()
        # Handle the supervisor's death first, even if others were reported earlier, because they may follow from it.
        if orphaned or (not self._parent.orphaned_ns and self._parent.life.dead()):
            self._own_stop(now_ns, written_ns, causes.DIED(layout.SUPERVISOR))
            self._parent.drop(now_ns)
        for peer in dead:
            self._own_stop(now_ns, written_ns, peer.death)
            peer.drop()

    def _follow_epoch(self, now_ns: int) -> None:
        """Answer a new epoch, which means that there was a stop. Write a burst, unless the port owner has stopped by
        itself in the previous epoch and no motion was written since. If a process was started again, watch the new one,
        and stop if the death of the previous one was not noticed."""
        epoch = self._epoch_word.get()
        if epoch != self.epoch:
            if went_back := self.admission.follow(epoch, self.epoch):
                self.stop(now_ns, went_back)
            just_stopped = self.admission.stopped_in >= self.epoch and not self.admission.wheels_move
            self.epoch = epoch
            if not just_stopped:
                self._burst()
            self._stopped_word.set(epoch)
            self._supervisor_bell.ring()
        for peer in self._peers:
            if peer.follow():
                self.stop(now_ns, peer.death)

    def _check_suspend(self, now_ns: int) -> bool:
        """Stop if the machine has slept. Someone may have moved the robot meanwhile, and frames from before the sleep
        look younger than they are (procs/suspend.py). Returns True if it has slept."""
        if slept_ns := self.suspend.slept_ns():
            self.stop(now_ns, causes.SUSPENDED(slept_ns / 1e9))
        return slept_ns > 0

    def _check_leases(self, now_ns: int) -> None:
        """While the wheels may move, stop if the lease of the gate or of the supervisor has ended, if this process was
        silent for too long, or if the gate sends no new motion. Otherwise set a timer to the next time when a lease or
        the gate's motion runs out."""
        if not self.admission.wheels_move:
            return
        if lapse := self.admission.lapsed(self._gate.heart.ns.get(), self._supervisor_beat.get(), now_ns):
            self.stop(now_ns, lapse)
        elif (silent_ns := now_ns - self.heartbeat.last_ns) >= HANG_NS:
            self.stop(now_ns, causes.HANGS(layout.PORT_OWNER, silent_ns // MS))
        elif now_ns - self._moved_ns > self._silence_ns:
            # The gate still beats but sends no new frames. The board would obey the last frame forever.
            self.stop(now_ns, causes.MUTE((now_ns - self._moved_ns) // MS))
        else:
            self._await_lapse()

    def _await_lapse(self) -> None:
        lapses_ns = self.admission.lapses_ns(self._gate.heart.ns.get(), self._supervisor_beat.get())
        self._lapse.set(min(lapses_ns, self._moved_ns + self._silence_ns + 1))

    def _check_drain(self, now_ns: int) -> None:
        """If the port does not drain, stop the robot, but only the first time that this is noticed. Call it before
        anything new is written, because new bytes have not had time to drain."""
        stuck = self.wire.stuck(now_ns)
        if stuck and not self._stuck:
            self.stop(now_ns, causes.STUCK())
        self._stuck = stuck

    def _forward_frames(self) -> None:
        """Read all frames that the gate has sent, and write those that may be written. Only the newest motion frame
        counts. A stop that the gate requests drops all earlier motion."""
        motion = self._pop_held()
        while entry := self._frames.next():
            _, frame_ns, payload = entry
            epoch, kind, body = records.FRAME.unpack(payload)
            if kind == records.MOTION:
                motion = (body, epoch, frame_ns)
            elif kind == records.WRITE_BURST:
                motion = None
                self.bus.waiting.clear()
                self._gate_stop()
            elif kind == records.ARM:
                self.bus.waiting.append((body, epoch, frame_ns))
            elif kind == records.DROP_ARM:
                self.bus.waiting.clear()
            else:
                self._others.append(body)
                self._forward_others()
        if self._others:
            self._forward_others()
        self._forward_arm()
        if motion:
            self._forward_motion(motion)

    def _gate_stop(self) -> None:
        """Write the burst that the gate has requested. If nothing moves and the last burst is younger than REST_NS,
        skip it, so that clients which keep disabling motion can't fill the line."""
        now_ns = monotonic_ns()
        if self.admission.wheels_move or self._arm_moved or now_ns - self._written_word.get() >= requests.REST_NS:
            self._burst()

    def _forward_others(self) -> None:
        """Write the waiting frames that are not motion, unless the line must be silent. Drops frames that are neither
        pings nor allowed by the board's rules (check_aux)."""
        while self._others and self.wire.free_ns <= monotonic_ns():
            frame = self._others.popleft()
            if frame in self.board.pings:
                self.port.ask_for_a_client(self.board.pings.index(frame))
            elif self.board.check_aux(frame) == "":
                self.wire.frame(frame, backlog=OTHER_BACKLOG)
        self._others_due.set(self.wire.free_ns if self._others else NEVER)

    def _forward_arm(self) -> None:
        """Write the waiting frames for the arm, in order, if they are admitted. A frame that has to wait holds up the
        frames behind it."""
        due_ns = NEVER
        while self.bus.waiting:
            move, now_ns = self.bus.waiting[0], monotonic_ns()
            verdict = self._decide(move, now_ns, self.bus)
            if verdict == admission.ADMIT:
                due_ns = self.bus.due_ns(move[0], now_ns, wheels_move=self.admission.wheels_move)
                due_ns = max(due_ns, self.wire.free_ns)
                if now_ns < due_ns < NEVER:
                    break
            self.bus.waiting.popleft()
            if verdict != admission.ADMIT:
                self._refuse(verdict, now_ns)
            elif due_ns != NEVER:
                self._write_arm(move)
            due_ns = NEVER
        self._arm_due.set(due_ns)

    def _write_arm(self, move: DatedFrame) -> None:
        """Write a frame for the servos. The word `moving` is set only during the write, because a servo's movement ends
        by itself."""
        before = self._moving_word.get()
        self._moving_word.set(1)
        self._barrier()
        now_ns = monotonic_ns()
        if self._epoch_word.get() != self.epoch:
            self._follow_epoch(now_ns)
        elif (
            self.admission.current(move, self.epoch, now_ns)
            and not self._check_suspend(now_ns)
            and self.wire.frame(move[0], backlog=OTHER_BACKLOG)
            and self.bus.wrote(move[0], now_ns)
        ):
            self._arm_moved = True
            if self._stops_servos:  # otherwise the repeated zero leaves the arm alone, and goes on
                self.repeats.end()
            self._requests.wake()
        if not (before or self.wire.unsent or self.wire.lost):
            self._moving_word.set(0)

    def _decide(self, motion: DatedFrame, now_ns: int, rules: Admission | BusSchedule) -> int | Cause:
        """Decide whether a frame may be written, by the tables of admission.py. Call it just before the write, because
        a frame may have become too old since the wake-up."""
        requested = self._requests.waits()
        gate_ns = self._gate.heart.ns.get() if self._gate.life else None
        beat_ns = self._supervisor_beat.get()
        return self.admission.decide(motion, self.epoch, now_ns, gate_ns, beat_ns, rules, requested=requested)

    def _refuse(self, verdict: int | Cause, now_ns: int) -> None:
        """Handle a frame that was not admitted: stop if the verdict says so, otherwise only drop the frame."""
        if verdict == admission.STAND_STILL:
            self._burst()
        elif verdict == admission.STOP_ASKED:
            self._stop_request(now_ns)
        elif not isinstance(verdict, int):
            self.stop(now_ns, verdict)

    def _forward_motion(self, motion: DatedFrame) -> None:
        """Decide about a motion frame, and write it if it is admitted. While the line must be silent, hold the frame
        and decide later."""
        now_ns = monotonic_ns()
        if self._waits_for_line(motion, now_ns):
            return
        verdict = self._decide(motion, now_ns, self.admission)
        if verdict != admission.ADMIT:
            self._refuse(verdict, now_ns)
        # The frame that sets the watchdog is sent before the first motion is written: a stop would wait for both.
        elif self.admission.wheels_move or (self.motion_writer.arm() and not self._waits_for_line(motion, now_ns)):
            self._write_motion(motion)

    def _waits_for_line(self, motion: DatedFrame, now_ns: int) -> bool:
        """Hold a motion frame until the line has been silent. Returns False if it is silent already."""
        if self.wire.free_ns <= now_ns:
            return False
        self._held = motion
        self._line.set(self.wire.free_ns)
        return True

    def _pop_held(self) -> DatedFrame | None:
        """Return the motion frame that waits for the line, or None, and stop waiting for it."""
        motion, self._held = self._held, None
        if motion:
            self._line.set(NEVER)
        return motion

    def _write_motion(self, motion: DatedFrame) -> None:
        """Write an admitted motion frame. Set the word `moving`, then check epoch and time once more, then write.

        Other processes rely on this order. If one of them has raised the epoch and then reads 0 in `moving`, no
        outdated frame is about to be written. So the other process need not kill a port owner that is starved at this
        point.
        """
        self._moving_word.set(1)
        self._barrier()
        now_ns = monotonic_ns()
        frame = motion[0]
        if self._epoch_word.get() != self.epoch:
            self._follow_epoch(now_ns)
        elif not self.admission.current(motion, self.epoch, now_ns):
            self._burst()
        elif self._check_suspend(now_ns):
            return
        elif impossible := self._impossible(motion[2]):
            self.stop(now_ns, impossible)
        else:
            self._write_admitted(frame, now_ns)

    def _write_admitted(self, frame: bytes, now_ns: int) -> None:
        stands, turned = frame == self.board.stop, self.motion_writer.turning
        if self.motion_writer.write(frame, now_ns, first=not self.admission.wheels_move):
            self.admission.wheels_move = True
            self._moved_ns = now_ns
            self._await_lapse()
            self._requests.wake()  # from now on, the next stop request is noticed at once
            self.repeats.end()
        elif stands:
            # A stop must not wait for the next refresh. A burst may also follow bytes that are held back.
            self.wire.burst()
        if stands and turned:
            # The board may lose this frame, as it may lose any stop, and the gate sends its next one a whole refresh
            # later.
            self.repeats.restart(now_ns)

    def _impossible(self, frame_ns: int) -> Cause | None:
        """Return the cause of a stop if an admitted motion frame breaks an invariant, or None if it may be written.
        `frame_ns`: when the gate made the frame."""
        latch, alone = self._latch.read(), self._pid_word.get() == self._pid
        latched_in = records.LATCH.unpack(latch[2])[0] if latch else 0
        return self.admission.impossible(frame_ns, self.epoch, latched_in, alone=alone)

    def _follow_port(self, ready: dict[int, int], now_ns: int) -> None:
        """Read from the port, and write what the kernel did not take earlier. If the port is lost, stop with the cause
        DEVICE_LOST. Adopt a port that the supervisor has sent and has already written a stop to."""
        if self.wire.fd >= 0:
            self.port.serve(ready)
            if self.wire.lost:
                self._port_lost(now_ns)
        while sent := self._parent.control.newer(ready, self.port.number + 1):
            if self.wire.fd >= 0:
                self._port_lost(now_ns)
            self.port.adopt(sent, now_ns)
            self._stopped(monotonic_ns())
            self.port.begin(now_ns)

    def _port_lost(self, now_ns: int) -> None:
        self.port.lose()
        self.stop(now_ns, causes.DEVICE_LOST())
        self.port.publish(now_ns)

    def _repeat(self, now_ns: int) -> None:
        self.repeats.wait(self.wire.free_ns)
        due = self.repeats.pop(now_ns)
        if self.admission.wheels_move:
            # The repeats belong to a zero frame from the gate. The gate itself sends that frame again, so no refresh.
            if due == REPEAT:
                self._stop_again()
            elif due == REFRESH:
                self.repeats.end()
        elif due:
            self.motion_writer.disarm()
            if due == REFRESH:
                self.wire.frame(self.board.refresh)
            elif self.wire.burst():
                self._moving_word.set(0)


def run(context: Context) -> int:
    """Run until the supervisor has died and the stop for its death is written. To end the service, the supervisor kills
    the port owner instead."""
    owner = PortOwner(context)
    context.run(owner.turn, owner.loop, TICK_NS)
    owner.wire.close()
    return 0
