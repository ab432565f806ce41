"""The gate's loop. It handles everything new from clients, telemetry and the supervisor, and puts frames into the ring
for the port owner. At each tick (every gate.period_s), it looks at the clients and advances the velocity."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from time import monotonic_ns

from failstop.files import instance, place
from failstop.messages import layout, records
from failstop.messages.packing import Note, pack
from failstop.policy import causes, kinematics, scale
from failstop.policy.causes import Cause, Reply, refused
from failstop.policy.proofs import WAITS_FOR
from failstop.policy.settings import PAD_SOURCE
from failstop.procs.context import Context
from failstop.procs.gate import clients
from failstop.procs.gate.arm.shell import REPORT_NS, Arm
from failstop.procs.gate.clients import ClientTable, News, Slot, bounded, newest_number
from failstop.procs.gate.core import IS_LATCHED, GateCore
from failstop.procs.gate.remarks import SelfReports
from failstop.procs.gate.requests import Request, Requests
from failstop.procs.gate.rest import PERIODS_AT_REST, Rest
from failstop.procs.gate.rings import Frames, GateBox
from failstop.procs.gate.sources import PAD_SESSION, Command
from failstop.procs.gate.turning import TurningWatch
from failstop.procs.loop import MS, NEVER, READ, Loop
from failstop.procs.wheel_servos import WheelServos
from failstop.shm import bell
from failstop.shm.heartbeat import HeartbeatReader
from failstop.shm.words import Barrier

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

PUBLISH_NS = 75_000_000
"""The state is published when it changes, and also when it is this old, so that it comes at 10 Hz or faster. With 100
ms here, a tick that comes a little early would find the state slightly too young. Only the next tick would publish it,
so every other state would come after 120 ms (measured)."""
NO_ARM = "this robot has no arm: its settings name no joints"
ARM_VERBS = range(records.ARM_MOVE, records.ARM_READ + 1)
HEARD = ("sensed", "interlocks", "attended", "arm_goal", "request", "command", "aux")
"""The records of a client in the order in which they are read. Records that may forbid a command come before the
command."""
MOST_RINGS = 20
"""The most wake-ups by clients that are handled between two ticks. With the usual period of 20 ms, this is one wake-up
per millisecond. Eight clients that command at 100 Hz need fewer."""
AUX_EVERY_NS = 10 * MS
"""The shortest time between two client frames that are not motion, so that a flood of them can't fill the line. A frame
that comes sooner is dropped."""
LOOK_AT_ALL_EVERY = 10
"""Once in this many periods, the gate looks at all slots, even at those that seem to be free, and at the clients'
reports about themselves."""


class Gate:
    """The gate. Call turn() once per wake-up."""

    def __init__(self, context: Context) -> None:
        settings = context.settings
        now_ns = monotonic_ns()
        self.heartbeat = context.heartbeat
        self.loop = Loop()
        self._next_tick, self._due, self._arm_due = (self.loop.timer() for _ in range(3))
        self._next_tick.set(now_ns)
        self.period_ns = settings.ns("gate.period_s")
        self._rest = Rest(context, self.loop, self._next_tick, self.period_ns)
        self._board = context.board
        self._max_rps = kinematics.max_wheel_rps(settings) * 1.0005
        self._lease_ns = settings.ns("gate.lease_s")
        bus = context.board.arm
        beside = bool(bus and bus.beside_wheels)
        self.core = GateCore(settings, kinematics.from_settings(settings), now_ns, arm_beside_wheels=beside)
        if context.board.scale_assumed:
            self.core.capped = scale.cap_text(settings)
            self.core.notes.append(Note("scale", self.core.capped))
        self._said = SelfReports(now_ns)
        self._barrier = Barrier()
        self._looked_ns, self._rings, self._ticking = 0, 0, False
        self._aux_ns = 0
        self._turn, self._frame = 0, b""
        """`_turn`: how many times in a row the last motion frame was sent again. `_frame`: that frame."""
        self._each_tick = bool(settings.servos() or settings.interlocks())
        self._published: dict[str, object] = {}
        self._published_ns = 0
        self._attach(context)
        self._watch_others(context)
        self.epoch = self._frames.epoch = self._epoch_word.get()
        self._raised_ns = 0
        self._last = causes.UNKNOWN()
        self.core.limit_to(self._limit_word.get() or 100)
        self.requests = Requests(context, self.core.notes, now_ns)
        self.follow_latch()
        to = (self._frames, self.requests, self.core.notes)
        self.arm = Arm(context, bus, *to, now_ns) if bus and settings.servos() else None
        self._do: dict[int, Callable[[Request, int], Reply | None]] = {
            records.ENABLE: self._enable,
            records.DISABLE: self._disable,
            records.RESET: lambda request, _now_ns: self.requests.ask_reset(request),
            records.LIMIT: self._limit,
            **dict.fromkeys(ARM_VERBS, self._ask_arm),
        }
        """The function that carries out each kind of request. If it returns None, the client gets its reply later."""
        claims_fd = place.opened(instance.claims_path(context.runtime_dir), os.O_RDONLY)
        heard = HEARD if self.arm else tuple(record for record in HEARD if record != "arm_goal")
        self.clients = ClientTable(context.client_slots(), claims_fd, self.loop, context.early, heard)

    def _attach(self, context: Context) -> None:
        """Create the writers of the gate's records, and the bells that it rings."""
        own = context.own
        self._frames = Frames(context)
        self._stops = own.ring_writer("stops")
        self._notes = own.ring_writer("notes")
        self._state = own.latest_writer("state")
        self._said_record = own.latest_writer("said")
        self._box = GateBox(own.ring_writer("box"))
        self._limit_word = own.word("limit")
        self._supervisor_bell = context.bell("supervisor_bell")

    def _watch_others(self, context: Context) -> None:
        """Create the readers of other processes' records, and watch everything that wakes the gate."""
        supervisor, telemetry = context.segment("supervisor"), context.segment("telemetry")
        self._epoch_word = supervisor.word("epoch")
        self._supervisor_heart = HeartbeatReader(supervisor)
        self._ready_word = supervisor.word("ready")
        self._latch, self._link = supervisor.latest_reader("latch"), supervisor.latest_reader("link")
        self._pad_command = telemetry.latest_reader("pad_command")
        self._pad_seq = newest_number(self._pad_command)
        self._pad_requests = telemetry.ring_reader("pad_requests")
        self._wheel_servos = WheelServos(context.settings, telemetry.latest_reader("health"))
        self._turning = TurningWatch(telemetry.latest_reader("wheels"), context.settings.ns("still.after_s"))
        self._client_bell = context.fd("client_bell")
        self.loop.listen(context.bell("bell"), context.early.bell)
        self.loop.watch(self._client_bell, READ)

    def follow_latch(self) -> None:
        """Read the latch that the supervisor has published. Call it at the start too, because a gate may be restarted
        while a stop is latched."""
        self._barrier()
        if entry := self._latch.read():
            since, _, self._raised_ns, cause = records.LATCH.unpack(entry[2])
            self._last = causes.read(cause)
            self.core.follow(self._last if since else None, self.epoch)

    def turn(self, ready: dict[int, int]) -> None:
        now_ns = monotonic_ns()
        decided, still = self.requests.reset_decided(), self._epoch_word.get() == self.epoch
        if still and not decided and self._rest.beats_alone(ready, now_ns):
            self.heartbeat.beat(now_ns)
            return
        self._follow_epoch()
        if decided:
            self.follow_latch()
            self.requests.answer_reset(now_ns)
        self._hear_clients(self.clients.lives_ended(ready), now_ns)
        if self._client_bell in ready:  # last, because a new client may get a descriptor number that was closed above
            self._client_rang(now_ns)
        self._hear_telemetry(now_ns)
        if self.core.enabled:
            self._stop(self.core.attendance.gone(now_ns), now_ns)
        if self._next_tick.due(now_ns):
            self._tick(now_ns)
        elif self._due.due(now_ns):
            # A client that repeats the same command does not ring a bell, so look for it.
            self._hear_clients(self.clients.look(self.clients.active), now_ns)
            self._step(now_ns)
        # When the driver's command will stop counting. The tick has just looked at all clients.
        self._due.set(self.core.due_ns(now_ns) or NEVER)
        if self.arm:
            self._turn_arm(self.arm, now_ns)
        self._send_notes()
        busy = bool(self.arm or self.core.enabled or self.clients.active)
        self._rest.plan_tick(now_ns, busy=busy, rests=self._rests(now_ns))
        self._publish(now_ns)
        self.requests.write()
        self.heartbeat.beat(now_ns)

    def _rests(self, now_ns: int) -> bool:
        """Return True if one tick in two periods is enough. The gate then misses nothing, because clients ring a bell
        for anything new, and the kernel reports a client's death at once."""
        needs = self._each_tick or self._rings >= MOST_RINGS or not self.core.rests(now_ns + self.period_ns)
        return not needs and all(slot.life and slot.life.pid for slot in self.clients.active)

    def _turn_arm(self, arm: Arm, now_ns: int) -> None:
        self._stop(arm.hear(self.core.arm_closed(), now_ns), now_ns)
        waits = self.core.enabled and self.core.arm_waits
        if not waits:
            arm.step(now_ns)
        if request := arm.answer_waiter(now_ns):
            reply = self._allow_motion(now_ns)
            if reply.done and self.core.arm_waits:
                arm.core.forget()
            self.requests.settle(request, reply, now_ns)
        arm.finish_turn(self.core.arm_closed(), now_ns)
        self._arm_due.set(now_ns + REPORT_NS if waits else arm.core.due_ns)

    def _hear_clients(self, news: Iterator[News], now_ns: int) -> None:
        for slot, record, values in news:
            self._hear(slot, record, values, now_ns)

    def _hear(self, slot: Slot, record: str, values: tuple[Any, ...], now_ns: int) -> None:
        """Act on one record of a client, or on the end of its session. `values`: the record's time and content."""
        match record:
            case "command":
                self._command(slot.command(*values), now_ns)
            case "sensed":
                self.core.scan.deliver(values[0], now_ns)
            case "interlocks":
                t_ns, names = values
                self.core.interlocks.hear(names, t_ns, now_ns)
            case "attended":
                self._attend(now_ns, slot, *values)
            case "request":
                self.handle_request(now_ns, slot, *values)
            case "arm_goal":
                self._aim_arm(now_ns, slot, *values)
            case "aux":
                self._forward_aux(now_ns, *values)
            case clients.RENAMED:
                self.core.rename(slot.session, *values)
            case clients.OVER:
                self._client_gone(now_ns, slot, *values)

    def _forward_aux(self, now_ns: int, _written_ns: int, frame: bytes) -> None:
        """Pass on a client's frame that does not move the wheels, for example for the buzzer. The port owner decides
        whether it may be written."""
        if now_ns - self._aux_ns >= AUX_EVERY_NS:
            self._aux_ns = now_ns
            self._frames.put(records.OTHER, frame, now_ns)

    def _client_rang(self, now_ns: int) -> None:
        """Read the clients' records at once. After MOST_RINGS rings, the rest waits for the next tick, so that a flood
        of rings can't take a core from processes of lower priority."""
        rung = self.clients.hinted(bell.receive(self._client_bell))
        self._hear_clients(self.clients.look(rung), now_ns)
        self._rings += 1
        if self._rings == MOST_RINGS:
            self.loop.forget(self._client_bell)

    def _tick(self, now_ns: int) -> None:
        self._ticking = True  # so that new commands are not stepped to one by one, but once at the end of the tick
        self._rest.ticked(now_ns)
        if self._rings >= MOST_RINGS:
            self._client_rang(now_ns)  # a new client may have rung, whose slot is not among the active ones yet
            self.loop.watch(self._client_bell, READ)
        self._rings = 0
        if now_ns - self._looked_ns < LOOK_AT_ALL_EVERY * self.period_ns:
            self._hear_clients(self.clients.look(self.clients.active), now_ns)
        else:
            self._looked_ns = now_ns
            self._hear_clients(self.clients.look(self.clients.slots), now_ns)
            self._pass_remarks(now_ns)
        if self.core.check_interlocks(now_ns):
            self._frames.stop(now_ns)
        self._check_supervisor(now_ns)
        self._check_turning(now_ns)
        self._ticking = False
        self._step(now_ns)
        self._box.tick(now_ns, self.core, self.epoch)

    def _check_supervisor(self, now_ns: int) -> None:
        """Stop if the supervisor has been silent for longer than the lease while motion is enabled. The port owner
        admits no motion then, so the gate must not show motion as enabled."""
        silent_ns = self._supervisor_heart.age_ns(now_ns) if self.core.enabled else 0
        if silent_ns > self._lease_ns:
            self._stop(causes.HANGS(layout.SUPERVISOR, silent_ns // MS), now_ns)

    def _check_turning(self, now_ns: int) -> None:
        """Disable motion if the wheels turn although zero is commanded."""
        core = self.core
        if why := self._turning.check(now_ns, idle=core.enabled and not any(core.velocity)):
            core.stand_still()
            core.notes.append(Note("disabled", f"motion disabled: {why}", {"reason": why}))
            self._frames.stop(now_ns)

    def _pass_remarks(self, now_ns: int) -> None:
        """Pass on the clients' reports about themselves. The gate does not judge them."""
        rows = [(slot.session, slot.index, slot.who(), *said) for slot in self.clients.active if (said := slot.said())]
        if (notes := self._said.update(rows, now_ns)) is not None:
            self.core.notes += notes
            self._said_record.write(pack(self._said.table()), now_ns)

    def _send_notes(self) -> None:
        if self.core.notes:
            for note in self.core.notes:
                self._notes.put(note.pack())
            self.core.notes.clear()
            self._supervisor_bell.ring()

    def _step(self, now_ns: int) -> None:
        enabled = self.core.enabled
        self._stop(self.core.driver_silence(now_ns), now_ns)
        if enabled and not self.core.enabled:
            self._frames.stop(now_ns)
        if speeds := self.core.step(now_ns):
            frame = self._board.motor_speeds(speeds, self._max_rps)
            self._turn, self._frame = (self._turn + 1 if frame == self._frame else 0), frame
            self._frames.put(records.MOTION, self._board.marked(frame, self._turn), now_ns, self.core.epoch)

    def _follow_epoch(self) -> None:
        epoch = self._epoch_word.get()
        if epoch != self.epoch:
            self.epoch = self._frames.epoch = epoch
            self.core.stand_still()
            self.follow_latch()
            if self.arm:
                self.arm.core.stop(IS_LATCHED, self.core.latch)

    def _hear_telemetry(self, now_ns: int) -> None:
        """Handle the gamepad's sticks, and what telemetry requests: to reset a stop, or to pass on a frame that is not
        motion, for example for the buzzer."""
        entry = self._pad_command.read()
        if entry and entry[0] != self._pad_seq:
            self._pad_seq, t_ns, payload = entry
            velocity = records.PAD_COMMAND.unpack(payload)
            self._command(Command(PAD_SESSION, PAD_SOURCE, t_ns, velocity, PAD_SOURCE, records.BY_HAND), now_ns)
        while request := self._pad_requests.next():
            kind, frame = records.PAD_REQUEST.unpack(request[2])
            if kind == records.PAD_RESET:
                self.requests.ask_reset(Request(records.RESET, now_ns))
            elif kind == records.PAD_FRAME:
                self._frames.put(records.OTHER, frame, now_ns)

    def _stop(self, cause: Cause | None, now_ns: int) -> None:
        """If there is a cause, stop: tell the port owner to write the burst, then report the cause to the supervisor.
        The supervisor latches the stop and raises the epoch."""
        if cause and self.core.stop(cause, self.epoch):
            self._stop_all(IS_LATCHED, now_ns, cause)
            self._stops.put(records.STOPPED.pack(self.epoch, now_ns, 0, cause.pack()))
            self._supervisor_bell.ring()

    def _stop_all(self, why: str, now_ns: int, cause: Cause | None = None) -> None:
        self._frames.stop(now_ns)
        if self.arm:
            self.arm.core.stop(why, cause)

    def handle_request(self, now_ns: int, slot: Slot, asked_ns: int, number: int, verb: int) -> None:
        if self.requests.is_answered(slot, number):
            return
        request, enabled = Request(verb, asked_ns, number, slot.session, slot), self.core.enabled
        if (reply := self.requests.refusal(request, self._raised_ns, self._last)) is None:
            reply = self._do[verb](request, now_ns) if verb in self._do else refused(f"unknown request {verb}")
        if reply:
            self.requests.settle(request, reply, now_ns, enabled=enabled)

    def _missing(self, now_ns: int) -> str:
        """Return a text that says why motion can't be enabled yet, for example because a process is not up. Empty if
        the service is ready."""
        silent_ns = self._supervisor_heart.age_ns(now_ns)
        if silent_ns > self._lease_ns:  # the port owner would admit no motion
            return f"the supervisor has been silent for {silent_ns / 1e9:.2f} s, see `failstop status`"
        if self._ready_word.get():
            return ""
        link = self._link.read()
        waits_for = WAITS_FOR.get(link[2].decode()) if link else None
        waits_for = waits_for or self._wheel_servos.waited_for()
        return waits_for or "a process or the port is not up yet, see `failstop status`"

    def _enable(self, request: Request, now_ns: int) -> Reply:
        """Enable motion, if nothing forbids it. If the arm has a drive pose, the arm goes there first. In this case,
        the returned reply only reports progress, and the final reply comes when the arm is there."""
        way = None
        if self.arm and not self.core.enabled and not self.core.refusal(self._missing(now_ns), now_ns):
            way = self.arm.enable(request, now_ns)
        return way or self._allow_motion(now_ns)

    def _allow_motion(self, now_ns: int) -> Reply:
        """Read all new commands, then enable motion if nothing forbids it. This order matters: a program that already
        commands motion is then held until it sends zero or pauses, so it can't drive off."""
        self._hear_clients(self.clients.commands(), now_ns)
        return self.core.enable(self.epoch, self._missing(now_ns), now_ns)

    def _disable(self, _request: Request, now_ns: int) -> Reply:
        """Disable motion. Turning wheels are stopped, but nothing is latched."""
        reply = self.core.disable()
        self._stop_all(reply.text, now_ns)
        return reply

    def _limit(self, request: Request, _now_ns: int) -> Reply:
        _, percent = request.about("speed_limit") or (0, 0)
        reply = self.core.limit_to(percent)
        self._limit_word.set(self.core.limit)
        return reply

    def _ask_arm(self, request: Request, now_ns: int) -> Reply:
        if self.arm is None:
            return refused(NO_ARM)
        if request.verb == records.ARM_HOLD:
            return self.arm.hold(request, now_ns)
        if closed := self.core.arm_closed():
            if self.core.latch is not None:
                return refused(closed, self.core.latch)
            return Reply(records.REFUSED, closed, refused_for=records.FOR_THE_WHEELS)
        done = self.arm.move(request, now_ns)
        if isinstance(done, Reply):
            return done
        self._stop(done, now_ns)
        return refused(IS_LATCHED, done)

    def _command(self, command: Command, now_ns: int) -> None:
        """Handle a new command. If it is allowed, the wheels follow it at once, not at the next tick."""
        self._box.command(command)
        if fault := self.core.accept(command, now_ns):
            self._stop(fault, now_ns)
        elif not self._ticking:
            self._step(now_ns)

    def _attend(self, now_ns: int, slot: Slot, t_ns: int, names: list[str]) -> None:
        """Record that an operator was present at `t_ns`, as this session reports. If `t_ns` is 0, the operator has
        left."""
        if names and t_ns:
            self.core.attendance.hear(slot.session, bounded(names[0], records.WHO_BYTES), t_ns, now_ns)
        elif names:
            self.core.attendance.leave(slot.session)

    def _aim_arm(self, now_ns: int, slot: Slot, t_ns: int, mode: int, values: dict[int, float]) -> None:
        if self.arm:
            self._stop(self.arm.goal(slot, t_ns, mode, values, self.core.arm_closed(), now_ns), now_ns)

    def _client_gone(self, now_ns: int, slot: Slot, parted: bool) -> None:
        """Handle a client that has left or died. If its command was moving the wheels, they stop at once, or follow
        another source."""
        self.core.attendance.leave(slot.session)
        if parted:
            self._said.part(slot.session)
        enabled = self.core.enabled
        if died := self.core.client_gone(slot.session, now_ns, parted=parted):
            self._stop(died, now_ns)
        elif enabled and not self.core.enabled:
            self._frames.stop(now_ns)
        else:
            self._step(now_ns)
        if self.arm:
            self.arm.client_gone(slot.session, now_ns)

    def _publish(self, now_ns: int) -> None:
        """Publish the state when it has changed or is PUBLISH_NS old. A new scan time does not count as a change. Scans
        come all the time, and for each of them every reader would have to unpack the whole state."""
        core = self.core
        driving = core.sources.driving(now_ns)
        driver = driving.session if driving else 0
        state: dict[str, object] = {"arm": self.arm.state(core.arm_closed(), now_ns)} if self.arm else {}
        if core.attendance.on:
            state["attended"] = core.attendance.names(now_ns)
        if unmet := core.interlocks.unmet(now_ns):
            state["unmet"] = unmet
        if core.capped:
            state["capped"] = core.capped
        state |= {
            "enabled": core.enabled,
            "enabled_ns": core.enabled_ns,
            "limit": core.limit,
            "estop": core.latch and core.latch.pack(),
            "blocked": core.blocked(now_ns) or None,
            "body_vel": core.velocity,
            "wheels_rps": core.speeds,
            "epoch": self.epoch,
            "sources": core.sources.table(now_ns),
            "clients": [
                {"slot": slot.index, "name": slot.name, "pid": slot.pid, "driving": slot.session == driver}
                for slot in self.clients.active
            ],
        }
        if state != self._published or now_ns - self._published_ns >= PUBLISH_NS:
            self._published = state
            self._published_ns = now_ns
            self._state.write(pack({**state, "scan_ns": core.scan.delivered_ns}), now_ns)


def run(context: Context) -> int:
    """Run the gate. It does not end by itself; it is killed when the supervisor dies."""
    gate = Gate(context)
    context.run(gate.turn, gate.loop, PERIODS_AT_REST * gate.period_ns)
    return 0
