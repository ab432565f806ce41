"""The gate's loop: news from clients and the supervisor, a tick every period, frames into the ring."""

from __future__ import annotations

import os
from time import monotonic_ns

from failstop.board.interface import BOARD
from failstop.files import instance, place
from failstop.messages import box, layout, records
from failstop.messages.packing import pack
from failstop.policy import causes, kinematics
from failstop.policy.causes import Cause
from failstop.policy.reply import Reply
from failstop.procs.context import Context
from failstop.procs.gate.arm.shell import Arm
from failstop.procs.gate.clients import ClientTable, Slot, seen
from failstop.procs.gate.core import IS_LATCHED, GateCore
from failstop.procs.gate.remarks import Said
from failstop.procs.gate.requests import Requests
from failstop.procs.gate.sources import PAD, PAD_SESSION, Command
from failstop.procs.loop import NEVER, READ, Loop
from failstop.shm import bell
from failstop.shm.cell import RingWriter
from failstop.shm.heartbeat import HeartbeatReader
from failstop.shm.words import Barrier

PUBLISH_NS = 80_000_000
"""State goes out when it changes, and at the first tick when it is this old: 10 Hz or faster. At 100 ms a tick that
comes a little early leaves it to the next one: 120 ms at every other time (measured)."""
MS = 1_000_000
MOST_RINGS = 20
"""Wake-ups by clients between two ticks: one a millisecond, as eight clients at 100 Hz would not need."""
LOOK_AT_ALL_EVERY = 10
"""Ticks between two looks at slots that nobody is known to hold, and at what clients say of themselves."""


class GateBox:
    """The gate's part of the black box: one record a tick, of the newest command and of what became of it."""

    def __init__(self, ring: RingWriter) -> None:
        self._ring = ring
        self._newest: Command | None = None
        self._count = 0

    def command(self, command: Command) -> None:
        """A command came, good or bad."""
        self._newest = command
        self._count += 1

    def tick(self, now_ns: int, core: GateCore, epoch: int) -> None:
        """The end of a tick."""
        command = self._newest
        flags = box.ENABLED if core.enabled else 0
        age_us, source, who = box.LONGEST, b"", b""
        velocity: tuple[float, ...] = (0.0, 0.0, 0.0)
        if command is not None:
            age_us = min(max(0, now_ns - command.t_ns) // 1000, box.LONGEST)
            velocity = tuple(map(box.single, command.velocity))
            source, who = command.source.encode(), command.who.encode("utf-8", "replace")[: box.WHO_BYTES]
            flags |= (box.MANUAL if command.manual else 0) | (
                box.DRIVES if core.sources.driving(now_ns) is command else 0
            )
        block = box.BLOCK.get(core.blocked(now_ns), 1)
        numbers = (*velocity, *core.velocity, *core.speeds)
        count, self._count = min(self._count, 255), 0
        self._ring.put(box.GATE.pack(epoch & box.LONGEST, block, flags, count, age_us, *numbers, source, who), now_ns)


class Gate:
    """The process's state; one turn() a wake-up."""

    def __init__(self, context: Context) -> None:
        settings = context.settings
        now_ns = monotonic_ns()
        self.heartbeat = context.heartbeat
        self.loop = Loop()
        self._next_tick, self._due = self.loop.timer(), self.loop.timer()
        self._next_tick.set(now_ns)
        self.period_ns = settings.ns("gate.period_s")
        self._max_rps = kinematics.max_wheel_rps(settings) * 1.0005
        self._lease_ns = settings.ns("gate.lease_s")
        self.core = GateCore(settings, kinematics.from_settings(settings), now_ns)
        self._said = Said(now_ns)
        self._barrier = Barrier()
        self._ticks = self._rings = 0
        self._published: dict[str, object] = {}
        self._published_ns = 0
        self._attach(context)
        self._watch_others(context)
        self.epoch = self._epoch_word.get()
        self.raised_ns = 0
        """When the epoch was raised last."""
        self.last = causes.UNKNOWN()
        """The cause of the last stop."""
        self.requests = Requests(self, context, now_ns)
        self.follow_latch()
        self.arm = Arm(self, context, self.loop.timer(), now_ns) if settings.servos() else None
        claims_fd = place.opened(instance.claims_path(context.runtime_dir), os.O_RDONLY)
        self.clients = ClientTable(context.client_slots(), claims_fd, self.loop, context.early, self)

    def _attach(self, context: Context) -> None:
        """Make the writers of its records, and the bells that it rings."""
        own = context.own
        self._frames = own.ring_writer("frames")
        self._stops = own.ring_writer("stops")
        self._notes = own.ring_writer("notes")
        self._state = own.latest_writer("state")
        self._said_record = own.latest_writer("said")
        self._box = GateBox(own.ring_writer("box"))
        self._port_owner_bell = context.bell("port_owner_bell")
        self.supervisor_bell = context.bell("supervisor_bell")

    def _watch_others(self, context: Context) -> None:
        """Make the readers of others' records, and watch what wakes it."""
        supervisor, telemetry = context.segment("supervisor"), context.segment("telemetry")
        self._epoch_word = supervisor.word("epoch")
        self._supervisor_heart = HeartbeatReader(supervisor)
        self._latch = supervisor.latest_reader("latch")
        self._pad_command = telemetry.latest_reader("pad_command")
        self._pad_seq = seen(self._pad_command)
        self._pad_requests = telemetry.ring_reader("pad_requests")
        self._client_bell = context.fd("client_bell")
        self._bells = (context.bell("bell"), context.early.bell)
        for fd in (*(each.fd for each in self._bells), self._client_bell):
            self.loop.watch(fd, READ)

    def follow_latch(self) -> None:
        """Read the supervisor's latch, as a gate that was restarted does too."""
        self._barrier()
        if entry := self._latch.read():
            since, _, self.raised_ns, cause = records.LATCH.unpack(entry[2])
            self.last = causes.read(cause)
            self.core.follow(self.last if since else None, self.epoch)

    def turn(self, ready: dict[int, int]) -> None:
        """Handle one wake-up."""
        now_ns = monotonic_ns()
        bell.clear_rung(self._bells, ready)
        self._follow_epoch()
        self.requests.follow_resets(now_ns)
        self.clients.lives_ended(ready, now_ns)
        if self._client_bell in ready:  # last: who joins may get the number of a descriptor that was closed above
            self._client_rang(now_ns)
        self._follow_telemetry(now_ns)
        self._check_attendance(now_ns)
        if self._next_tick.due(now_ns):
            self._tick(now_ns)
        elif self._due.due(now_ns):
            self.clients.look_at_active(now_ns)  # one that repeats its command has not rung for it
            self._step(now_ns)
        # When what drives the wheels stops counting, as this turn saw it: it is not forgotten until the tick.
        self._due.set(self.core.due_ns(now_ns) or NEVER)
        if self.arm:
            self.arm.turn(now_ns)
        self._tell()
        self.publish(now_ns)
        self.heartbeat.beat(now_ns, self.epoch)

    def _client_rang(self, now_ns: int) -> None:
        """News from clients, at once. Who rings without end is heard at the ticks: at real-time priority a flood would
        take a core from everybody below."""
        self.clients.rung(bell.take(self._client_bell), now_ns)
        self._rings += 1
        if self._rings == MOST_RINGS:
            self.loop.forget(self._client_bell)

    def _hear_clients(self) -> None:
        if self._rings >= MOST_RINGS:
            bell.take(self._client_bell)  # every slot in use is looked at in this tick anyway
            self.loop.watch(self._client_bell, READ)
        self._rings = 0

    def _tick(self, now_ns: int) -> None:
        """The periodic part; a tick that was missed is left out, not made up for."""
        self._hear_clients()
        self._next_tick.set(max(self._next_tick.ns + self.period_ns, now_ns + self.period_ns // 2))
        self._ticks += 1
        if self._ticks % LOOK_AT_ALL_EVERY:
            self.clients.look_at_active(now_ns)
        else:
            self.clients.look_at_all(now_ns)
            self._follow_said(now_ns)
        if self.core.check_interlocks(now_ns):
            self.send(records.STOP, b"", now_ns)
        self._check_supervisor(now_ns)
        self._step(now_ns)
        self._box.tick(now_ns, self.core, self.epoch)

    def _check_attendance(self, now_ns: int) -> None:
        """Motion goes on only while an operator is there, where the settings ask for one."""
        if self.core.enabled and (gone := self.core.attendance.gone(now_ns)):
            self.stop(gone, now_ns)

    def _check_supervisor(self, now_ns: int) -> None:
        """The port owner admits nothing without it: then nobody is to be told that motion is enabled."""
        silent_ns = self._supervisor_heart.age_ns(now_ns) if self.core.enabled else 0
        if silent_ns > self._lease_ns:
            self.stop(causes.HANGS(layout.SUPERVISOR, silent_ns // MS), now_ns)

    def _follow_said(self, now_ns: int) -> None:
        """Pass on clients' remarks on themselves, unjudged."""
        rows = [(slot.session, slot.index, slot.who(), *said) for slot in self.clients.active if (said := slot.said())]
        if (notes := self._said.follow(rows, now_ns)) is not None:
            self.core.notes += notes
            self._said_record.write(pack(self._said.table()), now_ns)

    def _tell(self) -> None:
        """Pass on what people are told."""
        if self.core.notes:
            for note in self.core.notes:
                self._notes.put(note.pack())
            self.core.notes.clear()
            self.supervisor_bell.ring()

    def _step(self, now_ns: int) -> None:
        if speeds := self.core.step(now_ns):
            frame = BOARD.motor_speeds(speeds, self._max_rps)
            self._frames.put(records.FRAME.pack(self.core.epoch, records.MOTION, frame), now_ns)
            self._port_owner_bell.ring()

    def _follow_epoch(self) -> None:
        """Somebody stopped."""
        epoch = self._epoch_word.get()
        if epoch != self.epoch:
            self.epoch = epoch
            self.core.stand_still()
            self.follow_latch()
            if self.arm:
                self.arm.core.stop(IS_LATCHED)

    def _follow_telemetry(self, now_ns: int) -> None:
        """The gamepad's sticks, and what telemetry asks for: a reset, or a frame that is not motion."""
        entry = self._pad_command.read()
        if entry and entry[0] != self._pad_seq:
            self._pad_seq, t_ns, payload = entry
            velocity = records.PAD_COMMAND.unpack(payload)
            self.client_command(Command(PAD_SESSION, PAD, t_ns, velocity, manual=True, source=PAD), now_ns)
        while request := self._pad_requests.next():
            kind, frame = records.PAD_REQUEST.unpack(request[2])
            if kind == records.PAD_RESET:
                self.requests.ask_reset((None, 0, 0, now_ns))
            elif kind == records.PAD_FRAME:
                self.send(records.OTHER, frame, now_ns)

    def send(self, kind: int, body: bytes, now_ns: int) -> None:
        """A frame of the current epoch for the port owner, or STOP."""
        self._frames.put(records.FRAME.pack(self.epoch, kind, body), now_ns)
        self._port_owner_bell.ring()

    def stop(self, cause: Cause, now_ns: int) -> None:
        """Latch a stop: burst at once, then the news to the supervisor, which raises the epoch."""
        if self.core.stop(cause, self.epoch):
            self._stop_all(IS_LATCHED, now_ns)
            self._stops.put(records.STOPPED.pack(self.epoch, now_ns, 0, cause.pack()))
            self.supervisor_bell.ring()

    def disable(self, now_ns: int) -> Reply:
        """Forbid motion; what moves is stopped, and nothing latched."""
        reply = self.core.disable()
        self._stop_all(reply.text, now_ns)
        return reply

    def _stop_all(self, why: str, now_ns: int) -> None:
        self.send(records.STOP, b"", now_ns)
        if self.arm:
            self.arm.core.stop(why)

    def client_command(self, command: Command, now_ns: int) -> None:
        """A new command moves the wheels at once, not at the next tick."""
        self._box.command(command)
        if fault := self.core.take(command, now_ns):
            self.stop(fault, now_ns)
        else:
            self._step(now_ns)

    def client_holds(self, slot: Slot, now_ns: int) -> None:
        """Take a client's assertions: the sensor's deliveries, interlocks."""
        core = self.core
        if sensed := slot.latest("sensed"):
            core.scan.deliver(sensed[0], now_ns)
        if asserted := slot.latest("interlocks"):
            core.interlocks.hold(asserted[1], asserted[0], now_ns)
        if found := slot.attended():
            proven_ns, who = found
            if proven_ns:
                core.attendance.hear(slot.session, who, proven_ns, now_ns)
            else:
                core.attendance.leave(slot.session)
        if self.arm:
            self.arm.goal(slot, now_ns)

    def client_gone(self, slot: Slot, now_ns: int) -> None:
        """It has left, or its claim is gone: if it was the one that drives, the wheels stand at once."""
        self.core.attendance.leave(slot.session)
        enabled = self.core.enabled
        if died := self.core.client_gone(slot.session, now_ns, parted=slot.parted()):
            self.stop(died, now_ns)
        elif enabled and not self.core.enabled:
            self.send(records.STOP, b"", now_ns)
        else:
            self._step(now_ns)
        if self.arm:
            self.arm.client_gone(slot.session, now_ns)

    def publish(self, now_ns: int) -> None:
        """Publish the state when it has changed, and at least every PUBLISH_NS. The sensor's last delivery, which is
        new at every tick, waits for that: whoever reads the state would unpack it at every tick too."""
        core = self.core
        driving = core.sources.driving(now_ns)
        driver = driving.session if driving else 0
        state: dict[str, object] = {"arm": self.arm.state(now_ns)} if self.arm else {}
        if core.attendance.on:
            state["attended"] = core.attendance.names(now_ns)
        if unmet := core.interlocks.unmet(now_ns):
            state["unmet"] = unmet
        state |= {
            "enabled": core.enabled,
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
    """Run forever: the gate dies with the supervisor."""
    gate = Gate(context)
    context.run(gate.turn, gate.loop, gate.period_ns)
    return 0
