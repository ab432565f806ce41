"""Servos of Feetech's STS series on one half-duplex bus: three wheels in velocity mode, an arm's in position mode.

Written from the memory table and from what two foreign hosts make and take of the bytes (feetech-servo-sdk 1.0.0,
rustypot 1.13.1); the servos' firmware is not public. Where it is not known the model takes what is worse for the host:

- A servo waits for the rest of a packet for ever, of whatever length: a length that was garbled takes 255 bytes.
- A servo that answers hears nothing, from the end of the question on.
- Bytes of the host and of an answer that meet are both garbled, whoever hears them, and every servo hears all answers.
- Goals stay as they are; nothing ends a speed but another goal.

A sync write is not answered, a write to one id is. Those asked by a sync read answer in the order of their ids in it,
each after its return delay. Speed 0 is the fastest to a servo in position mode. Not modelled: REG WRITE and ACTION.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable, Iterator

from failstop.board.feetech import codec
from failstop.board.wire import TimedStop, Write
from failstop_lab.boards.feetech_joints import ARM_IDS, SUPPLY_AT, TEMPERATURE_AT, Joints
from failstop_lab.boards.feetech_joints import MIDDLE as MIDDLE
from failstop_lab.boards.feetech_joints import POSITION_AT as POSITION_AT
from failstop_lab.boards.line import Receiver, ReceiverModel, Rolling
from failstop_lab.sim.servos import Servos

BYTE_NS = 10_000
PING = 0x01
MEMORY = 71
NEGATIVE = 0x8000
MODE_AT, SPEED_AT, MOVING_AT = 33, 58, 66
DELAY_NS = 30_000
"""From a question to its answer, where the return delay is set to 0."""
LONGEST_DELAY_NS = 510_000
SHORTEST = 2
STEP_NS = 1_000_000
FULL_SPEED = 3000
"""Steps a second of a joint on its way."""
GOAL_BYTES = frozenset((codec.GOAL_SPEED, codec.GOAL_SPEED + 1))


def checked(packet: bytes) -> bool:
    """Whether the check of a whole packet is right."""
    return sum(packet[2:]) & 0xFF == 0xFF


class Ear:
    """A packet as a few servos have heard it, byte by byte; all that heard the same share one."""

    __slots__ = ("ids", "packet")

    def __init__(self, ids: set[int]) -> None:
        self.ids = ids
        self.packet = bytearray()

    def hear(self, value: int) -> bytes:
        """The packet that this byte completes, check included; empty: none yet."""
        packet = self.packet
        size = len(packet)
        if size < 2:
            if value == 0xFF:
                packet.append(value)
            else:
                packet.clear()
        elif size == 2 and value == 0xFF:
            return b""
        elif size == 3 and value < SHORTEST:
            packet.clear()
        else:
            packet.append(value)
            if size > 3 and size == packet[3] + 3:
                whole = bytes(packet)
                packet.clear()
                return whole
        return b""


class Bus(Rolling):
    """The servos. `delay_ns`: of each before its answer; `seed`: of what bytes become that meet; `heard`: what all have
    heard already of a packet that was cut; `turns`: its wheels turn as they are told, and joints go to their goals."""

    def __init__(self, delay_ns: int = DELAY_NS, seed: int = 0, heard: bytes = b"", *, turns: bool = False) -> None:
        self.memory = {servo: bytearray(MEMORY) for servo in (*ARM_IDS, *codec.WHEELS)}
        for servo, memory in self.memory.items():
            memory[SUPPLY_AT], memory[TEMPERATURE_AT] = 118, 31
            memory[MODE_AT] = servo in codec.WHEELS
            for at in (codec.GOAL_POSITION, POSITION_AT):
                memory[at : at + 2] = MIDDLE.to_bytes(2, "little")
        self.turns = turns
        self.wheels: tuple[float, ...] = (0.0,) * len(codec.WHEELS)
        """Goal speeds."""
        self.commands: list[tuple[int, tuple[float, ...]]] = []
        self.said: list[tuple[int, bytes]] = []
        self.collisions = 0
        """Bytes of the host that met an answer."""
        self.broadcast_speeds = 0
        """Writes of a speed that name no id: arm servos would take 0 for their fastest."""
        self.aimed: list[tuple[int, int]] = []
        """When which joint was sent somewhere."""
        self.blocked: set[int] = set()
        """Joints that are held where they are."""
        self.silent: set[int] = set()
        """Servos that obey and answer nothing."""
        self.moved: Callable[[int, int, int, int, int], None] = lambda *_: None
        """Called with each step of a joint: the servo, when and where it began, when and where it ended."""
        self._ears = [Ear(set(self.memory))]
        self._quiet = True
        """Every servo waits for the head of a packet."""
        self._answers: deque[tuple[int, int, bytearray]] = deque()
        """When each begins, whose, its bytes; they do not overlap."""
        self._sent = 0
        """Bytes of the first answer that are out."""
        self._garble = random.Random(seed)
        self._delay_ns = delay_ns
        self._moved_ns = 0
        self.noise(heard, 0)

    def noise(self, data: bytes, at_ns: int) -> None:
        """Bytes on the line that nobody wrote."""
        for value in data:
            self._hear(value, at_ns)

    def byte(self, at_ns: int, value: int) -> None:
        """One byte from the host. It is garbled where an answer is on the line."""
        if not self._answers:
            if value == 0xFF or not self._quiet:
                self._hear(value, at_ns)
            return
        self.until(at_ns - BYTE_NS)
        if self._answers and self._answers[0][0] < at_ns:
            self.collisions += 1
            value = self._garble.randrange(256)
            begin_ns, _, data = self._answers[0]
            for at in range(self._sent, min(len(data), (at_ns - begin_ns) // BYTE_NS + 1)):
                data[at] = self._garble.randrange(256)
        self._hear(value, at_ns)

    def answers_until_ns(self) -> int:
        """When the last answer is over; 0: there is none."""
        return self._answers[-1][0] + len(self._answers[-1][2]) * BYTE_NS if self._answers else 0

    def until(self, at_ns: int) -> None:
        """The answers until then, and the joints' way."""
        while self._answers:
            begin_ns, servo, data = self._answers[0]
            out = min(len(data), max(0, (at_ns - begin_ns) // BYTE_NS))
            for value in data[self._sent : out]:
                self._hear(value, at_ns)
            self._sent = max(self._sent, out)
            if out < len(data):
                break
            self.said.append((begin_ns + len(data) * BYTE_NS, bytes(data)))
            self._answers.popleft()
            self._sent = 0
            self._ears.append(Ear({servo}))
            self._join()
        if self.turns:
            self._move(at_ns)

    def _hear(self, value: int, at_ns: int) -> None:
        for ear in self._ears.copy():
            if packet := ear.hear(value):
                self._accept(packet, ear, at_ns)
        self._join()

    def _join(self) -> None:
        """Make one ear of those that have heard the same."""
        if len(self._ears) == 1:
            self._quiet = not self._ears[0].packet
            return
        found: dict[bytes, Ear] = {}
        for ear in self._ears:
            if other := found.get(bytes(ear.packet)):
                other.ids |= ear.ids
            elif ear.ids:
                found[bytes(ear.packet)] = ear
        self._ears = list(found.values())
        self._quiet = not any(found)

    def _accept(self, packet: bytes, ear: Ear, at_ns: int) -> None:
        """A whole packet, for those who heard it."""
        if not checked(packet):
            return
        to, kind, data = packet[2], packet[4], packet[5:-1]
        asked: list[int] = []
        told = False
        if kind == codec.SYNC_WRITE and to == codec.EVERY_SERVO and len(data) > 2:
            address, size = data[:2]
            for at in range(2, len(data) - size, size + 1):
                if data[at] in ear.ids:
                    told |= self._store(data[at], address, data[at + 1 : at + 1 + size], at_ns)
        elif kind == codec.WRITE and data:
            named = ear.ids if to == codec.EVERY_SERVO else ear.ids & {to}
            self.broadcast_speeds += to == codec.EVERY_SERVO and data[0] in GOAL_BYTES
            for servo in sorted(named):
                told |= self._store(servo, data[0], data[1:], at_ns)
            asked = [] if to == codec.EVERY_SERVO else list(named)
            data = b"\0\0"
        elif kind in (codec.READ, PING) and to in ear.ids:
            asked, data = [to], data if kind == codec.READ else b"\0\0"
        elif kind == codec.SYNC_READ and to == codec.EVERY_SERVO:
            asked = [servo for servo in data[2:] if servo in ear.ids]
        if told:
            self._note(at_ns)
        if len(data) > 1:
            self._answer(asked, data[0], data[1], ear, at_ns)

    def _store(self, servo: int, address: int, data: bytes, at_ns: int) -> bool:
        """Whether it is a wheel's goal speed, or a part of one."""
        if address + len(data) > MEMORY:
            return False
        self.memory[servo][address : address + len(data)] = data
        if address == codec.GOAL_POSITION:
            self.aimed.append((at_ns, servo))
        return servo in codec.WHEELS and not GOAL_BYTES.isdisjoint(range(address, address + len(data)))

    def _note(self, at_ns: int) -> None:
        """Keep the speeds that the wheels are told now."""
        self.wheels = tuple(codec.signed(self.word(wheel, codec.GOAL_SPEED)) for wheel in codec.WHEELS)
        self.commands.append((at_ns, self.wheels))

    def word(self, servo: int, address: int) -> int:
        """Two bytes of a servo's memory, as a number."""
        return int.from_bytes(self.memory[servo][address : address + 2], "little")

    def _answer(self, asked: list[int], address: int, size: int, ear: Ear, at_ns: int) -> None:
        """Those that are asked hear nothing until they have answered."""
        begin_ns = at_ns
        if self._answers:
            begin_ns = self._answers[-1][0] + len(self._answers[-1][2]) * BYTE_NS
        for servo in asked:
            if servo in self.silent:
                continue
            ear.ids.discard(servo)
            if self.turns and servo in codec.WHEELS:
                steps = int(self.reported[codec.WHEELS.index(servo)])
                said = steps if steps >= 0 else -steps | NEGATIVE
                self.memory[servo][SPEED_AT : SPEED_AT + 2] = said.to_bytes(2, "little")
            data = bytearray(codec.packet(servo, 0, bytes(self.memory[servo][address : address + size])))
            begin_ns += self._delay_ns
            self._answers.append((begin_ns, servo, data))
            begin_ns += len(data) * BYTE_NS

    def _move(self, at_ns: int) -> None:
        """Joints, on to their goals, at the speed that they are told."""
        passed_ns = at_ns - self._moved_ns
        if passed_ns < STEP_NS:
            return
        before_ns, self._moved_ns = self._moved_ns, at_ns
        for servo in ARM_IDS:
            memory = self.memory[servo]
            here, goal = self.word(servo, POSITION_AT), self.word(servo, codec.GOAL_POSITION)
            memory[MOVING_AT] = here != goal and memory[codec.TORQUE_SWITCH] == 1 and servo not in self.blocked
            if memory[MOVING_AT]:
                most = (self.word(servo, codec.GOAL_SPEED) or FULL_SPEED) * passed_ns // 1_000_000_000
                begin, here = here, here + max(-most, min(most, goal - here))
                memory[POSITION_AT : POSITION_AT + 2] = here.to_bytes(2, "little")
                self.moved(servo, before_ns, begin, at_ns, here)


def _any_state(rng: random.Random) -> Bus:
    """Any return delay, amid a packet of any length."""
    begun = bytes((255, 255, rng.randrange(254), rng.randrange(256)))
    return Bus(rng.randrange(LONGEST_DELAY_NS), rng.randrange(1 << 30), begun[: rng.randrange(5)])


def _every_state() -> Iterator[Bus]:
    """Amid a packet of every length, after every number of its bytes."""
    for length in range(256):
        yield Bus(heard=bytes((255, 255, 254, length)))
    for heard in (b"\xff", b"\xff\xff", b"\xff\xff\xfe"):
        yield Bus(heard=heard)


def _joints(bus: Receiver, start_ns: int) -> Servos:
    assert isinstance(bus, Bus)
    return Joints(bus, start_ns)


MODEL = ReceiverModel(
    live=lambda: Bus(turns=True),
    any_state=_any_state,
    every_state=_every_state,
    # Lengths that were garbled, and an answer's beginning.
    before=(b"\xff\xff\xfe\xff", b"\xff\xff\x07\x80\x00", b"\xff" * 5, codec.packet(8, 0, bytes(18))[:9]),
    not_enough=TimedStop((Write(0, codec.STOP),), 0, ((0,), (0,), (0,))),
    # A packet of motion that was cut, and another behind it: one check of 256 passes.
    fuses=True,
    stalls=True,
    joints=_joints,
)
