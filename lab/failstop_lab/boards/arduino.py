"""The receiver of ros_arduino_bridge on an AVR (joshnewans 210a122), as a state machine.

- Bytes go into a ring that holds 63. When it is full the newest are dropped.
- The main loop takes them one by one: the first letter of a line, then two arguments between spaces. A further space
  changes nothing. A CR runs the line, whatever it is by then; numbers are read by a 16-bit atoi.
- Every line is answered. The firmware waits while the transmitter holds as much as it can, and takes in no byte
  meanwhile.
- 2 s after the last motion line the motors are set to zero.

An argument of more than 15 bytes overwrites its neighbours in memory, which depends on the build: the model ignores
everything up to the next CR, and counts it in `overrun`.
"""

from __future__ import annotations

import random
import re
from collections import deque
from collections.abc import Iterator

from failstop.board.arduino.codec import PERIODS, USUAL_BAUD
from failstop.board.wire import TimedStop, Write
from failstop_lab.boards.line import ReceiverModel, Rolling

BYTE_NS = 175_000
"""At the AVR's real rate for 57600, 16 MHz / 280."""
RING = 63
HELD = 63
"""Bytes of answers, beside the one that is being sent, before the firmware waits. A real transmitter holds one more."""
ARGUMENT = 15
AUTO_STOP_NS = 2_001_000_000
"""More than 2000 ms by the board's clock of whole milliseconds."""
TAKE_NS = 6_000
"""To take in one byte and parse it."""
RUN_NS = 60_000
"""To run a line; a stop sets two motors and both controllers in twice the time."""
_INT = re.compile(rb"[ \t\n\v\f\r]*([+-]?)(\d+)")


def atoi(text: bytes) -> int:
    """As avr-libc's: of 16 bits, wrapped; 0 for what is no number."""
    found = _INT.match(text)
    value = int(found[1] + found[2]) if found else 0
    return (value + 0x8000) % 0x10000 - 0x8000


class Arduino(Rolling):
    """At rest between lines, or in the state of `cmd`, `arg` and `args`."""

    def __init__(self, answer_ns: int = BYTE_NS, *, turns: bool = False) -> None:
        self.cmd = 0
        self.arg = 0
        self.args = [bytearray(), bytearray()]
        self.lost = 0
        """Bytes that found the ring full."""
        self.overrun = 0
        self.speeds = (0, 0)
        """Goals of the speed controllers."""
        self.moving = False
        self.pwm = (0, 0)
        """By a raw line, which switches the controllers off."""
        self.counts = (0, 0)
        """The encoders' counts, which the board answers with."""
        self.baud = USUAL_BAUD
        """What its firmware was built for, and says."""
        self.turns = turns
        """Whether its encoders count as its wheels turn."""
        self._way = [0.0, 0.0]
        self._turned_ns = 0
        self.commands: list[tuple[int, tuple[float, ...]]] = []
        self.said: list[tuple[int, bytes]] = []
        self._ring: deque[tuple[int, int]] = deque()
        self._free_ns = 0
        self._sent_ns = 0
        self._fed_ns = 0
        self._answer_ns = answer_ns

    @property
    def wheels(self) -> tuple[float, ...]:
        """Commands to the wheels: ticks, or the PWM of a raw line."""
        return tuple(map(float, self.speeds if self.moving else self.pwm))

    def byte(self, at_ns: int, value: int) -> None:
        """From the interrupt into the ring."""
        self.until(at_ns - 1)
        if len(self._ring) < RING:
            self._ring.append((at_ns, value))
        else:
            self.lost += 1

    def until(self, at_ns: int) -> None:
        """The main loop until then."""
        while self._ring and max(self._free_ns, self._ring[0][0]) <= at_ns:
            came_ns, value = self._ring.popleft()
            begun_ns = max(self._free_ns, came_ns)
            self._auto_stop(begun_ns)
            self._free_ns = begun_ns + TAKE_NS
            self.take(value)
        if self._free_ns <= at_ns:
            self._auto_stop(at_ns)
        if self.turns:
            self._turn(at_ns)

    def _turn(self, at_ns: int) -> None:
        """A raw line's PWM counts as if it were ticks."""
        passed_s, self._turned_ns = (at_ns - self._turned_ns) / 1e9, at_ns
        self._way = [way + speed * PERIODS * passed_s for way, speed in zip(self._way, self.reported, strict=True)]
        self.counts = (int(self._way[0]), int(self._way[1]))

    def turn_by_hand(self, wheel: int, counts: float) -> None:
        """A person turns a wheel that has no current, by so many counts of its encoder."""
        self._way[wheel] += counts

    def _auto_stop(self, at_ns: int) -> None:
        if at_ns - self._fed_ns >= AUTO_STOP_NS:
            self.moving, self.pwm = False, (0, 0)

    def take(self, value: int) -> None:
        """One byte of a line."""
        if value == 13:
            self._run()
            self.cmd, self.arg, self.args = 0, 0, [bytearray(), bytearray()]
        elif value == 32:
            self.arg = min(self.arg + 1, 2)
        elif self.arg == 0:
            self.cmd = value
        elif len(self.args[self.arg - 1]) < ARGUMENT:
            self.args[self.arg - 1].append(value)
        else:
            self.overrun += 1

    def _run(self) -> None:
        left, right = (atoi(bytes(argument).partition(b"\0")[0]) for argument in self.args)
        self._free_ns += RUN_NS
        if self.cmd == ord("m"):
            self._motion(left, right)
        elif self.cmd == ord("o"):
            self._raw(left, right)
        elif self.cmd == ord("e"):
            self._say(b"%d %d\r\n" % self.counts)
        elif self.cmd == ord("b"):
            self._say(b"%d\r\n" % self.baud)
        elif self.cmd == ord("r"):
            self.speeds = (0, 0)
            self._say(b"OK\r\n")
        else:
            self._say(b"Invalid Command\r\n")

    def _motion(self, left: int, right: int) -> None:
        self._fed_ns = self._free_ns
        self.moving = bool(left or right)
        if not self.moving:
            self.pwm = (0, 0)
            self._free_ns += RUN_NS
        self.speeds = (left, right)
        self.commands.append((self._free_ns, (float(left), float(right))))
        self._say(b"OK\r\n")

    def _raw(self, left: int, right: int) -> None:
        self._fed_ns = self._free_ns
        self.moving, self.speeds, self.pwm = False, (0, 0), (left, right)
        self.commands.append((self._free_ns, (float(left), float(right))))
        self._say(b"OK\r\n")

    def _say(self, answer: bytes) -> None:
        """The transmitter sends while there is something; the firmware waits for room in it."""
        for _ in answer:
            self._free_ns = max(self._free_ns, self._sent_ns - HELD * self._answer_ns)
            self._sent_ns = max(self._sent_ns, self._free_ns) + self._answer_ns
        self.said.append((self._sent_ns, answer))


def _longest_answers(_rng: random.Random) -> Arduino:
    board = Arduino()
    board.counts = (-(2**31), -(2**31))
    return board


def _receivers() -> Iterator[Arduino]:
    yield Arduino()


MODEL = ReceiverModel(
    live=lambda: Arduino(turns=True),
    any_state=_longest_answers,
    every_state=_receivers,
    before=(),
    not_enough=TimedStop((Write(0, b"m 0 0\r"),), 0, ((0,),)),
    fuses=False,
    stalls=True,
)
