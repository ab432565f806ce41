"""Damiao's motors and the slcan adapter in front of them, as a state machine.

The adapter is a CANable (canable-fw 8ca5d39, canable2-fw b158aa7: slcan.c, usbd_cdc_if.c, can.c):

- It keeps the characters of a line, and begins again at the start of its buffer when that is full. At a carriage return
  it runs what its buffer holds. It never looks how long the line is, so a line that was cut takes the rest from older
  ones, and an empty line is the last command again. Characters are made digits in place, whatever they are.
- Frames wait in a queue. A frame for which it has no room is dropped, the newest first. Where nobody on the CAN takes a
  frame the queue stands, and is sent when somebody does, old frames first.

The motors' firmware is closed. They do what the manuals say (DM-H3510 V1.0, DM-J4310P-2EC V1.3), and where these are
silent, what is worst: a speed that is told to a disabled motor holds when it is enabled, questions don't feed its
watchdog, a frame without data sets nothing, and a speed that is no number is UNLIMITED. A motor comes up disabled, in
its MIT mode, without a watchdog.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Iterator
from math import isfinite
from struct import Struct

from failstop.board.wire import TimedStop, Write
from failstop_lab.boards.line import ReceiverModel
from failstop_lab.boards.one_by_one import OneByOne

BUFFERS = (30, 155)
"""Characters that the first and the second CANable keep (SLCAN_MTU)."""
QUEUE = 27
"""Frames that wait in the first one (TXQUEUE_LEN, of which it wastes one)."""
CAN_NS = 135_000
"""A frame of 8 bytes on a CAN of 1 Mbit/s, with its stuffed bits."""
REPLY_NS = 100_000
TICK_NS = 50_000
UNLIMITED = 1e6
IS_OFF, IS_ON, OVER_HEATED, LOST = 0, 1, 11, 13
TIMEOUT, MODE, P_MAX, V_MAX, T_MAX = 9, 10, 21, 22, 23
MIT, BY_SPEED = 1, 3
SCALES = {P_MAX: 12.5, V_MAX: 45.0, T_MAX: 10.0}
"""The scales of reports (DM-H6215)."""
HEAT = 31
_FLOAT, _COUNT = Struct("<f"), Struct("<I")


def digit_of(value: int) -> int:
    """What the adapter makes of a character, in 8 bits."""
    if value >= ord("a"):
        return (value - ord("a") + 10) & 255
    if value >= ord("A"):
        return (value - ord("A") + 10) & 255
    return (value - ord("0")) & 255


def said(can_id: int, data: bytes) -> bytes:
    """The line in which the adapter passes a frame on."""
    return b"t" + b"%03X" % can_id + b"%d" % len(data) + data.hex().upper().encode() + b"\r"


class Adapter:
    """Characters in, frames for the CAN out."""

    def __init__(self, heard: bytes = b"", buffer: int = BUFFERS[0]) -> None:
        """`heard`: what it has taken before; `buffer`: how many characters it keeps."""
        self._kept = [0] * (buffer + 32)
        self._most = buffer
        self._at = 0
        self.bitrate = -1
        self.open = False
        for value in heard:
            self.byte(value)

    def byte(self, value: int) -> tuple[int, bytes] | None:
        """The frame that this character completes: its id, and as much data as it has."""
        if value == ord("\r"):
            length, self._at = self._at, 0
            return self._run(length)
        if self._at >= self._most:
            self._at = 0
        self._kept[self._at] = value
        self._at += 1
        return None

    def _run(self, length: int) -> tuple[int, bytes] | None:
        kept = self._kept
        for index in range(1, length):
            kept[index] = digit_of(kept[index])
        command = chr(kept[0])
        if command == "O":
            self.open = True
        elif command == "C":
            self.open = False
        elif command == "S" and not self.open and kept[1] <= 8:
            self.bitrate = kept[1]
        elif command in "tT":
            size = 3 if command == "t" else 8
            can_id = 0
            for index in range(1, size + 1):
                can_id = can_id * 16 + kept[index]
            count = kept[size + 1]
            if count > 8:
                return None
            digits = kept[size + 2 : size + 2 + 2 * count]
            data = bytes((high << 4) + low & 255 for high, low in zip(digits[::2], digits[1::2], strict=True))
            # A standard id has 11 bits.
            return (can_id & 0x7FF, data) if command == "t" else None
        return None


class Motor:
    """A motor of the manual."""

    def __init__(self, number: int, *, armed: bool = False) -> None:
        """`armed`: it is enabled, in the mode of speeds, and has no watchdog that would help a stop."""
        self.number = number
        self.status = IS_ON if armed else IS_OFF
        self.mode = BY_SPEED if armed else MIT
        self.told = 0.0
        self.ticks = 0
        self.fed_ns = 0
        self.unplugged = False
        """It hears nothing and says nothing."""
        self.broken = False
        """It can't be enabled: the reason for which it switched itself off is still there."""

    @property
    def speed(self) -> float:
        """That it turns at."""
        return self.told if self.status == IS_ON else 0.0

    def until(self, at_ns: int) -> None:
        """Its watchdog."""
        if self.status == IS_ON and self.ticks and at_ns - self.fed_ns > self.ticks * TICK_NS:
            self.status = LOST

    def restart(self) -> None:
        """Its power was off."""
        self.__init__(self.number)  # type: ignore[misc]

    def takes(self, can_id: int, data: bytes, at_ns: int) -> bool:
        """A frame that is for it, and no register's; True if it was told a speed."""
        self.fed_ns = at_ns
        if can_id == self.number and data[:7] == b"\xff" * 7 and len(data) == 8:
            command = data[7]
            if command == 0xFC and self.status in (IS_OFF, IS_ON):
                self.status = IS_OFF if self.broken else IS_ON
            elif (command == 0xFD and self.status in (IS_OFF, IS_ON)) or (
                command == 0xFB and self.status not in (IS_OFF, IS_ON)
            ):
                self.status = IS_OFF
            return False
        if can_id >> 8 == 2 and self.mode == BY_SPEED and len(data) >= 4:
            (speed,) = _FLOAT.unpack(data[:4])
            self.told = speed if isfinite(speed) else UNLIMITED
            return True
        return False

    def register(self, data: bytes) -> bytes:
        """The answer to a frame about its registers; empty: it has none."""
        kind, index, value = data[2], data[3], data[4:]
        if kind == 0x55:
            if index == TIMEOUT:
                (self.ticks,) = _COUNT.unpack(value)
            elif index == MODE:
                self.mode = _COUNT.unpack(value)[0]
            return data
        if kind != 0x33:
            return b""
        known = {TIMEOUT: _COUNT.pack(self.ticks), MODE: _COUNT.pack(self.mode)}
        known |= {end: _FLOAT.pack(size) for end, size in SCALES.items()}
        return data[:4] + known.get(index, bytes(4))

    def report(self, speed: float) -> bytes:
        """A motor's report: its status, and a speed."""
        most = SCALES[V_MAX]
        level = min(4095, max(0, int((speed + most) / (2 * most) * 4095 + 0.5)))
        position, torque = 0x8000, 0x7FF
        head = (self.number | self.status << 4, position >> 8, position & 255, level >> 4)
        return bytes((*head, (level & 15) << 4 | torque >> 8, torque & 255, HEAT, HEAT))


class Damiao(OneByOne):
    """The adapter and its motors. `heard`: what the adapter has taken before; `armed`: the motors obey, and have no
    watchdogs; `turns`: they turn as they are told; `joined`: as of OneByOne."""

    def __init__(
        self,
        heard: bytes = b"",
        count: int = 2,
        *,
        armed: bool = False,
        turns: bool = False,
        joined: bool = True,
        buffer: int = BUFFERS[0],
    ) -> None:
        super().__init__(joined=joined)
        self.motors = [Motor(number + 1, armed=armed) for number in range(count)]
        self.adapter = Adapter(heard, buffer)
        self.adapter.open = armed
        self.turns = turns
        self.can_dead = False
        """Nobody takes frames from the CAN: its plug at the adapter is out, or the motors have no power."""
        self.dropped = 0
        """Frames for which the adapter had no room."""
        self.said: list[tuple[int, bytes]] = []
        self._waiting: deque[tuple[int, bytes]] = deque()
        self._sends_ns = 0
        """When the CAN is free, if frames wait."""

    @property
    def wheels(self) -> tuple[float, ...]:
        """What the motors turn at."""
        return tuple([motor.speed for motor in self.motors])

    def byte(self, at_ns: int, value: int) -> None:
        """A character for the adapter."""
        self.until(at_ns)
        frame = self.adapter.byte(value)
        if frame is None:
            return
        if len(self._waiting) >= QUEUE:
            self.dropped += 1
            return
        if not self._waiting:
            self._sends_ns = max(self._sends_ns, at_ns) + CAN_NS
        self._waiting.append(frame)

    def until(self, at_ns: int) -> None:
        """Frames on the CAN, and the motors' watchdogs, until then."""
        while self._waiting and self.adapter.open and self._sends_ns <= at_ns:
            if self.can_dead or all(motor.unplugged for motor in self.motors):
                self._sends_ns = at_ns + CAN_NS
                break
            sent_ns = self._sends_ns
            can_id, data = self._waiting.popleft()
            self._watch(sent_ns)
            self._sent(can_id, data, sent_ns)
            self._sends_ns = sent_ns + CAN_NS
        self._watch(at_ns)
        self.pass_commands(at_ns)

    def disconnect_motor(self, *, on: bool) -> None:
        """The last motor's plug."""
        self.motors[-1].unplugged = on

    def _watch(self, at_ns: int) -> None:
        for motor in self.motors:
            motor.until(at_ns)

    def _sent(self, can_id: int, data: bytes, at_ns: int) -> None:
        for wheel, motor in enumerate(self.motors):
            if motor.unplugged:
                continue
            if can_id == 0x7FF:
                if len(data) == 8 and data[0] == motor.number and not data[1]:
                    answer = motor.register(data) or (motor.report(self._turning(wheel)) if data[2] == 0xCC else b"")
                    self._says(motor, answer, at_ns)
            elif can_id & 0xFF == motor.number:
                was = motor.speed
                if motor.takes(can_id, data, at_ns) or motor.speed != was:
                    self.commanded(wheel, at_ns)
                self._says(motor, motor.report(self._turning(wheel)), at_ns)

    def _turning(self, wheel: int) -> float:
        return self.reported[wheel] if self.turns else 0.0

    def _says(self, motor: Motor, data: bytes, at_ns: int) -> None:
        if data:
            self.said.append((at_ns + REPLY_NS, said(0x10 + motor.number, data)))


def _any_state(rng: random.Random) -> Damiao:
    """A state of one CANable or the other: between lines, after a line that has left any digits in the buffer."""
    before = b"t" + b"".join(b"%X" % rng.randrange(16) for _ in range(rng.randrange(21))) + b"\r"
    return Damiao(before if rng.random() < 0.5 else b"", armed=True, buffer=rng.choice(BUFFERS))


def _every_state() -> Iterator[Damiao]:
    """Amid a line of any length, of the digits that would be the worst speed, or of a command to all motors."""
    for buffer in BUFFERS:
        for length in range(buffer + 1):
            yield Damiao((b"t2018" + b"F" * buffer)[:length], armed=True, buffer=buffer)
            shut = Damiao((b"t001" + b"8FFFFFFFFFFFFFFFC\rt2" + b"7" * buffer)[:length], armed=True, buffer=buffer)
            shut.adapter.open = False
            yield shut


MODEL = ReceiverModel(
    live=lambda: Damiao(turns=True),
    with_motors=lambda count: Damiao(count=count, turns=True),
    any_state=_any_state,
    every_state=_every_state,
    # Other programs' lines, whole and cut, and empty ones.
    before=(
        b"\r",
        b"\r\r\r",
        b"V\r",
        b"t2018",
        b"t2018FFFF7F7F",
        b"t0018FFFFFFFFFFFFFFFC\r",
        b"T000002018",
        b"\a\0\xff",
    ),
    # For the first motor alone.
    not_enough=TimedStop((Write(0, b"t20180000000000000000\r"),), 0, ((0,), (0,), (0,))),
    fuses=True,
    stalls=True,
)
