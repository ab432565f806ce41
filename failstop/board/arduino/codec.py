"""The lines of ros_arduino_bridge. A line is a letter, arguments between spaces, and a CR. The board answers each line
with one line.

Firmware source: joshnewans 210a122 and hbrobotics a960c8a. A line has no checksum, so its form must protect it:

- The stop begins with a CR, which ends a line that was cut short. Without the CR, the board would read the stop as more
  digits of the cut line, and then execute that line.
- Both speeds carry their sign, and a comma ends the first speed. The firmware's atoi stops reading at a sign or a
  comma. So two joined lines, or two speeds that lost the space between them, can't become one larger speed unless three
  bytes are lost. A letter in place of the comma would be worse, because the board could take it for the command.
- Speeds have at most three digits. So even if a cut line and the next line are joined, every argument fits into the 16
  bytes that the firmware has for it.

If a digit is lost, the wheel turns slower. If a minus is lost, the wheel turns the other way at the same speed. No form
of this line can prevent that.
"""

from __future__ import annotations

import re

from failstop.board.lines import LineReader, MotionLine
from failstop.board.wire import Answer, Sample, Wheels

STOP = b"\rm 0 0\r"
BAUD_RATE = b"b\r"
"""The question for the board's baud rate. It changes nothing on the board, and the board answers with the rate that its
firmware was built for."""
USUAL_BAUD = 57_600
BAUDS = (USUAL_BAUD, 115_200, 230_400, 460_800, 500_000, 921_600, 1_000_000)
"""The rates that the firmware may have been built for: those of the setting board.baud."""
POSITIONS = b"e\r"
LIMIT = 999.0
UNIT = "encoder ticks per 33 ms"
PERIODS = 30
"""How often the firmware's speed controllers run, per second."""
COUNTS = 3436
"""Encoder counts per turn of a wheel. This is the default of diffdrive_arduino."""

PINS = (11, 14, 15, 16, 17)
"""The pins of an Uno that drive no motor and read no encoder, with any motor driver of the two firmwares. joshnewans
has an L298: its PWM is on 5, 6, 9 and 10, and its enables are on 12 and 13. hbrobotics' default is a Pololu VNH5019
(README, line 153): its directions are on 2, 4, 7 and 8, its enables are on 6 and 12, and its PWM is on 9 and 10
(DualVNH5019MotorShield.cpp). The encoders are on 2, 3, A4 (18) and A5 (19), and the serial port is on 0 and 1."""
_AUX = re.compile(rb"([wxc]) (\d{1,2}) (\d{1,3})\r")
_MOST = {b"w": 1, b"x": 255, b"c": 1}
_LINE = re.compile(rb"m ([+-]\d{1,3}), ([+-]\d{1,3})\r")
_COUNTS = re.compile(r"(-?\d{1,10}) (-?\d{1,10})")
LONGEST_ANSWER = 32
"""How many bytes of an answer are kept. Every answer is shorter than this: the longest one has two counts of up to 11
characters each."""


def _written(left: float, right: float) -> bytes:
    return f"m {int(left):+d}, {int(right):+d}\r".encode()


MOTION = MotionLine(_LINE, _written, LIMIT, "ticks")
REST = MOTION.frame((0.0, 0.0), 0.0)


def check_aux(frame: bytes) -> str:
    """Say why these bytes must not be written to set a pin; "" if they may. The pin commands are w (digital), x (PWM)
    and c (direction)."""
    found = _AUX.fullmatch(frame)
    if not found:
        return "no line that sets a pin"
    command, pin, value = found[1], int(found[2]), int(found[3])
    if pin not in PINS:
        return f"pin {pin} may drive a motor"
    return "" if value <= _MOST[command] else f"{value} is more than the pin takes"


def answers() -> LineReader:
    """Make a reader for the answers. They come in the order of the lines, but an answer does not name its line. The
    board sends nothing else."""
    return LineReader(_samples, LONGEST_ANSWER)


def _samples(line: bytes) -> list[Sample]:
    text = line[-LONGEST_ANSWER:].decode("ascii", "replace").strip()
    found = _COUNTS.fullmatch(text)
    return [Wheels((), (float(found[1]), float(found[2]))) if found else Answer(text)]
