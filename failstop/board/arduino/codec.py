"""Lines of ros_arduino_bridge: a letter, arguments between spaces, and a CR; each line gets an answer line.

Firmware source: joshnewans 210a122 and hbrobotics a960c8a. A line has no checksum, so its form must protect it:

- The stop begins with a CR, which ends any line that was cut before. Without it, the stop would be read as more digits
  of the cut line, which would then be executed.
- Both speeds carry their sign, and a comma ends the first one. The firmware's atoi ends at either, so neither two glued
  lines nor two speeds whose space was lost can join their digits into a larger speed: three bytes must be lost for
  that. A letter in place of the comma could become the command.
- Speeds have at most three digits, so that a cut line with a whole one after it fits the firmware's 16 bytes per
  argument.

A lost digit makes a wheel slower. A lost minus makes it turn the other way at the same speed; no form of this line can
prevent that.
"""

from __future__ import annotations

import re

from failstop.board.lines import LineReader, MotionLine
from failstop.board.wire import Answer, Sample, Wheels

STOP = b"\rm 0 0\r"
BAUD_RATE = b"b\r"
"""A question without side effects; its answer is 57600."""
POSITIONS = b"e\r"
LIMIT = 999.0
UNIT = "encoder ticks per 33 ms"
PERIODS = 30
"""Periods of the speed controllers per second."""
COUNTS = 3436
"""Encoder counts per turn of a wheel, the default of diffdrive_arduino."""

PINS = (4, 7, 8, 11, 14, 15, 16, 17)
"""Pins of an Uno that drive no motor and read no encoder in the firmware's default wiring: the L298's PWM is on 5, 6, 9
and 10 and its enables on 12 and 13, encoders are on 2, 3, A4 (18) and A5 (19), and the port on 0 and 1."""
_AUX = re.compile(rb"([wxc]) (\d{1,2}) (\d{1,3})\r")
_MOST = {b"w": 1, b"x": 255, b"c": 1}
_LINE = re.compile(rb"m ([+-]\d{1,3}), ([+-]\d{1,3})\r")
_COUNTS = re.compile(r"(-?\d{1,10}) (-?\d{1,10})")
LONGEST_ANSWER = 32
"""Bytes: two counts of 11 characters, and some more."""


def _written(left: float, right: float) -> bytes:
    return f"m {int(left):+d}, {int(right):+d}\r".encode()


MOTION = MotionLine(_LINE, _written, LIMIT, "ticks")
REST = MOTION.frame((0.0, 0.0), 0.0)


def check_aux(frame: bytes) -> str:
    """Why these bytes must not be written as a line that sets a pin: w (digital), x (PWM) or c (its direction)."""
    found = _AUX.fullmatch(frame)
    if not found:
        return "no line that sets a pin"
    command, pin, value = found[1], int(found[2]), int(found[3])
    if pin not in PINS:
        return f"pin {pin} may drive a motor"
    return "" if value <= _MOST[command] else f"{value} is more than the pin takes"


def answers() -> LineReader:
    """The reader of answers, because the board sends nothing else. Answers come in the order of the lines, and do not
    say which line they belong to."""
    return LineReader(_samples, LONGEST_ANSWER)


def _samples(line: bytes) -> list[Sample]:
    text = line[-LONGEST_ANSWER:].decode("ascii", "replace").strip()
    found = _COUNTS.fullmatch(text)
    return [Wheels((), (float(found[1]), float(found[2]))) if found else Answer(text)]
