"""The receiver of the VESC firmware (vedderb/bldc b9d287b), as a state machine: a controller at the port, and another
one on its CAN.

- Bytes are taken one by one (packet.c). A packet is tried when as many bytes have come as its head says; if it fails,
  the same is tried from its second byte on, so nothing behind a wrong head is lost.
- FORWARD passes a payload on (commands.c). A controller on the CAN handles it and answers through the one at the port.
  Where the CAN takes nothing, each waits for 5 ms and is lost (comm_can.c), and no byte is taken meanwhile.
- A controller whose motor was told nothing for 1 s lets it roll (timeout.c); its thread looks every 10 ms. Commands to
  the motor count, also one for the speed that it has; questions and the servo don't.
- A speed of fewer ERPM than the configured least brakes (foc_math.c); `least_erpm` is that, 900 by default in the
  firmware, and 0 here, so that slow robots can be simulated.
- The servo keeps its place (pwm_servo.c).

Not modelled: ramps and currents of the motor. A duty cycle or a current counts as a speed, of UNLIMITED at its largest.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Iterator
from struct import Struct

from failstop.board.facts import USUAL_CAN_ID
from failstop.board.vesc.codec import Motors
from failstop.board.wire import TimedStop, Write
from failstop_lab.boards.line import ReceiverModel
from failstop_lab.boards.one_by_one import OneByOne

MOST_PAYLOAD = 512
BUFFER = MOST_PAYLOAD + 8
BYTE_NS = 10 * 1_000_000_000 // 115_200
TIMEOUT_NS = 1_000_000_000
LOOKS_NS = 10_000_000
TAKE_NS = 2_000
"""To take in one byte."""
CAN_NS = 400_000
"""A frame on the CAN of 500 kbit/s, and the other controller's threads."""
CAN_WAITS_NS = 5_000_000
DEFAULT_LEAST_ERPM = 900
UNLIMITED = 100_000.0
DUTY, CURRENT, BRAKE, RPM, HANDBRAKE, SET_SERVO, STAY_ALIVE, FORWARD = 5, 6, 7, 8, 10, 12, 30, 34
VERSION, VALUES, SELECTED, CURRENT_SHARE = 0, 4, 50, 84
PER_UNIT = {DUTY: UNLIMITED / 100_000, CURRENT: 1.0, CURRENT_SHARE: UNLIMITED / 100_000, RPM: 1.0}
"""What a unit of these commands counts as. A current is in mA, and a duty cycle or a share in 1/100000."""
DECIVOLTS, HEAT = 118, 310
_TYPES = ("h", "h", *"iiii", "h", "i", "h", *"iiiiii", "B", "i", "B", "6s", "i", "i", "B")
"""The type of each value by its bit (commands.c, COMM_GET_VALUES_SELECTIVE), up to the status."""
AT_HEAT, AT_RPM, AT_VOLTS, AT_TACHOMETER, AT_FAULT, AT_ID, AT_STATUS = 0, 7, 8, 13, 15, 17, 21
_VERSION_SAID = bytes((0, 6, 6)) + b"SIM\0" + bytes(12) + bytes((0, 0, 0, 0, 0, 0, 0))


def crc16(data: bytes) -> int:
    """CRC-16 with the polynomial 1021, from 0 (crc.c)."""
    crc = 0
    for value in data:
        crc ^= value << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def wrapped(payload: bytes) -> bytes:
    """A packet as the firmware sends it."""
    return bytes((2, len(payload))) + payload + crc16(payload).to_bytes(2, "big") + b"\3"


class Packets:
    """packet.c: bytes in, payloads out."""

    def __init__(self, heard: bytes = b"") -> None:
        """`heard`: bytes of a packet that is not complete."""
        self.kept = bytearray()
        self._left = 0
        for value in heard:
            self.byte(value)

    def byte(self, value: int) -> list[bytes]:
        """The payloads that this byte completes."""
        if len(self.kept) >= BUFFER:
            self.kept = bytearray()
            self._left = 0
        self.kept.append(value)
        if self._left > 1:
            self._left -= 1
            return []
        found: list[bytes] = []
        while True:
            taken, self._left = self._tried(found)
            if not taken:
                return found
            del self.kept[:taken]

    def _tried(self, found: list[bytes]) -> tuple[int, int]:
        """How many bytes are done with, and else how many more are needed."""
        data = self.kept
        if not data:
            return 0, 1
        begin = data[0]
        if begin not in (2, 3):
            return 1, 0
        if len(data) < begin:
            return 0, begin - len(data)
        size = int.from_bytes(data[1:begin], "big")
        if size < (1 if begin == 2 else 255) or size > MOST_PAYLOAD:
            return 1, 0
        end = begin + size + 3
        if len(data) < end:
            return 0, end - len(data)
        payload = bytes(data[begin : begin + size])
        if data[end - 1] != 3 or crc16(payload) != int.from_bytes(data[end - 3 : end - 1], "big"):
            return 1, 0
        found.append(payload)
        return end, 0


class Motor:
    """A controller and its motor."""

    def __init__(self, can_id: int) -> None:
        self.can_id = can_id
        self.speed = 0.0
        """What it is told, in ERPM."""
        self.steps = 0.0
        """Steps of its tachometer."""
        self.fed_ns = 0
        self.rolls_free = True
        """By its own timeout, or a current of zero: nothing brakes it."""
        self.fault = 0
        """While it has a fault, it drops every command for its motor, and its motor rolls. It still answers."""
        self.late = False
        """By the last run of the thread of the timeouts: its timeout is over."""


class Vesc(OneByOne):
    """Both controllers. `heard`: bytes of a packet that is not complete; `turns`: the motors turn as they are told;
    `joined`: as of OneByOne."""

    def __init__(
        self, heard: bytes = b"", least_erpm: float = 0.0, *, turns: bool = False, joined: bool = True
    ) -> None:
        super().__init__(joined=joined)
        self.motors = [Motor(0), Motor(USUAL_CAN_ID)]
        self.least_erpm = least_erpm
        self.turns = turns
        self.can_dead = False
        """The plug of the CAN is out."""
        self.servo: int | None = None
        """Where it was sent, in thousandths of its way."""
        self.served: list[tuple[int, int]] = []
        """When it was sent where."""
        self.said: list[tuple[int, bytes]] = []
        self._packets = Packets(heard)
        self._coming: deque[tuple[int, int]] = deque()
        self._free_ns = 0
        self._looked_ns = 0
        self._turned_ns = 0

    @property
    def wheels(self) -> tuple[float, ...]:
        """Commands to the motors."""
        return tuple([motor.speed for motor in self.motors])

    def byte(self, at_ns: int, value: int) -> None:
        """Into the buffer of the serial driver."""
        self.until(at_ns - 1)
        self._coming.append((at_ns, value))

    def until(self, at_ns: int) -> None:
        """Bytes and timeouts until then."""
        while self._coming and max(self._free_ns, self._coming[0][0]) <= at_ns:
            came_ns, value = self._coming.popleft()
            self._free_ns = max(self._free_ns, came_ns) + TAKE_NS
            self._look(self._free_ns)
            self.take(value, self._free_ns)
        self._look(at_ns)
        self.pass_commands(at_ns)
        if self.turns:
            passed_s, self._turned_ns = (at_ns - self._turned_ns) / 1e9, at_ns
            for motor, speed in zip(self.motors, self.reported, strict=True):
                motor.steps += speed / 10 * passed_s

    def take(self, value: int, at_ns: int) -> None:
        """A byte, in the thread that handles packets."""
        for payload in self._packets.byte(value):
            self._forward(payload, at_ns)

    def disconnect_motor(self, *, on: bool) -> None:
        """The plug of the CAN."""
        self.can_dead = on

    def turn_by_hand(self, wheel: int, counts: float) -> None:
        """A person turns a motor, by so many steps of its tachometer."""
        self.motors[wheel].steps += counts

    def _look(self, at_ns: int) -> None:
        """The thread of the timeouts, if it has run since the last look."""
        ran_ns = at_ns - at_ns % LOOKS_NS
        if ran_ns <= self._looked_ns:
            return
        self._looked_ns = ran_ns
        for motor in self.motors:
            motor.late = ran_ns - motor.fed_ns > TIMEOUT_NS
            if motor.late:
                motor.speed, motor.rolls_free = 0.0, True

    def _forward(self, payload: bytes, at_ns: int) -> None:
        if payload[0] != FORWARD:
            self._accept(self.motors[0], payload, at_ns)
        elif self.can_dead:
            self._free_ns += CAN_WAITS_NS
        elif len(payload) > 2 and payload[1] in (self.motors[1].can_id, 255):
            self._accept(self.motors[1], payload[2:], at_ns + CAN_NS)

    def _accept(self, motor: Motor, payload: bytes, at_ns: int) -> None:
        command, data = payload[0], payload[1:]
        if command in PER_UNIT or command in (BRAKE, HANDBRAKE):
            motor.fed_ns = at_ns
            if motor.fault:
                motor.speed, motor.rolls_free = 0.0, True
                self.commanded(self.motors.index(motor), at_ns)
                return
            value = int.from_bytes(data[:4].ljust(4, b"\0"), "big", signed=True) * PER_UNIT.get(command, 0.0)
            motor.rolls_free = command in (CURRENT, CURRENT_SHARE) and not value
            motor.speed = 0.0 if command == RPM and abs(value) < self.least_erpm else value
            self.commanded(self.motors.index(motor), at_ns)
        elif command == STAY_ALIVE:
            motor.fed_ns = at_ns
        elif command == SET_SERVO and motor is self.motors[0]:
            self.servo = int.from_bytes(data[:2].ljust(2, b"\0"), "big", signed=True)
            self.served.append((at_ns, self.servo))
        elif command == VERSION:
            self.said.append((at_ns, wrapped(_VERSION_SAID)))
        elif command == VALUES:
            self.said.append((at_ns, wrapped(bytes((VALUES,)) + self._values(motor, 0x3FFFFF))))
        elif command == SELECTED:
            mask = int.from_bytes(data[:4].ljust(4, b"\0"), "big")
            self.said.append((at_ns, wrapped(bytes((SELECTED,)) + mask.to_bytes(4, "big") + self._values(motor, mask))))

    def _values(self, motor: Motor, mask: int) -> bytes:
        wheel = self.motors.index(motor)
        steps = (int(motor.steps // 1) + 2**31) % 2**32 - 2**31
        known = {
            AT_HEAT: HEAT,
            AT_RPM: int(self.reported[wheel]) if self.turns else 0,
            AT_VOLTS: DECIVOLTS,
            AT_TACHOMETER: steps,
            AT_FAULT: motor.fault,
            AT_ID: motor.can_id,
            AT_STATUS: int(motor.late),
        }
        said = b""
        for bit, kind in enumerate(_TYPES):
            if mask >> bit & 1:
                said += bytes(6) if kind == "6s" else Struct(f">{kind}").pack(known.get(bit, 0))
        return said


def _any_state(rng: random.Random) -> Vesc:
    """Between packets: a garbled length is in every_state()."""
    return Vesc()


def _every_state() -> Iterator[Vesc]:
    """Amid a packet of every length that a head may have, right behind the head."""
    for length in range(1, 256):
        yield Vesc(bytes((2, length)))
    for length in range(255, MOST_PAYLOAD + 1):
        yield Vesc(bytes((3, *length.to_bytes(2, "big"))))
    for heard in (b"\2", b"\3", b"\3\1", b"\2\2\2", b"\3\2\0" + b"\2\xff" * 60):
        yield Vesc(heard)


MODEL = ReceiverModel(
    live=lambda: Vesc(turns=True),
    any_state=_any_state,
    every_state=_every_state,
    # Other programs' packets, whole and cut.
    before=(
        b"\2",
        b"\2\5",
        wrapped(bytes((STAY_ALIVE,))),
        wrapped(b"\6\0\0\0\0"),
        wrapped(bytes((SET_SERVO, 1, 244)))[:5],
        b"\3\3\3\2\2\2",
    ),
    # For the motor at the port alone.
    not_enough=TimedStop((Write(0, Motors().rest),), 0, ((0,), (0,), (0,))),
    fuses=False,
    stalls=True,
    # A receiver that waits for 255 bytes more gets the rest of them with the next repeat.
    cut_ns=28_000_000,
    pending_ns=140_000_000,
)
