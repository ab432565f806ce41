"""Lines of ros_arduino_bridge: a letter, arguments between spaces, and a CR; an answer line to each.

Firmware source, joshnewans 210a122 and hbrobotics a960c8a. There is no check in a line, so form has to do its work:

- The stop begins with a CR. It ends whatever was cut before; without it the stop would be taken for digits of the cut
  line, which is then executed.
- Both speeds carry their sign. The firmware's atoi ends at the next sign, so two glued lines never fuse their digits
  into a larger speed.
- Speeds have three digits at most: a cut line with a whole one behind it fits the firmware's 16 bytes an argument.
"""

from __future__ import annotations

import re

from failstop.board.wire import Answer, Reader, Sample, Wheels, beyond, two_speeds

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

STOP = b"\rm 0 0\r"
BAUD_RATE = b"b\r"
"""The question without any effect; answered 57600."""
POSITIONS = b"e\r"
LIMIT = 999.0
UNIT = "encoder ticks per 33 ms"
PERIODS = 30
"""Of the speed controllers, in a second."""
COUNTS = 3436
"""Encoder counts of a wheel's turn, as diffdrive_arduino has them by default."""

_LINE = re.compile(rb"m ([+-]\d{1,3}) ([+-]\d{1,3})\r")
_COUNTS = re.compile(r"(-?\d{1,10}) (-?\d{1,10})")
LONGEST_ANSWER = 32
"""Bytes: two counts of 11 characters, and more."""


def motion(both: Sequence[float], limit: float) -> bytes:
    """The line for left and right, each within plus or minus `limit`, rounded towards zero. Raises FrameError."""
    left, right = two_speeds(both, limit, LIMIT, "ticks")
    return _line(int(left), int(right))


def _line(left: int, right: int) -> bytes:
    return f"m {left:+d} {right:+d}\r".encode()


REST = motion((0.0, 0.0), 0.0)


def speeds(frame: bytes) -> tuple[int, int] | None:
    """Left and right of a motion line; None for other bytes."""
    found = _LINE.fullmatch(frame)
    return (int(found[1]), int(found[2])) if found else None


def check_motion(frame: bytes, limit: float) -> str:
    """Why these bytes must not be written as a motion line; "" when they may. Never raises on bytes."""
    found = speeds(frame)
    if found is None:
        return "not a motion line"
    if _line(*found) != frame:
        return "not as this module writes it"
    return beyond(found, limit, LIMIT)


class Answers(Reader):
    """The board says nothing but answers. They come in the order of the lines, and carry no name."""

    def __init__(self) -> None:
        self._kept = b""

    def feed(self, chunk: bytes) -> list[Sample]:
        """The answers that these bytes complete; a line that is too long is dropped."""
        *lines, rest = (self._kept + chunk).split(b"\n")
        self._kept = rest[-LONGEST_ANSWER:]
        return [_sample(line[-LONGEST_ANSWER:].decode("ascii", "replace").strip()) for line in lines]


def _sample(line: str) -> Sample:
    found = _COUNTS.fullmatch(line)
    return Wheels((), (float(found[1]), float(found[2]))) if found else Answer(line)
