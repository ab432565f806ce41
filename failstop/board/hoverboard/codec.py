"""Frames of hoverboard-firmware-hack-FOC: the command down and the feedback up, little-endian words and their xor.

Down: start ABCD, steer, speed, xor. The board mixes left = speed + steer / 2 and right = speed - steer / 2 (its default
coefficients), so steer is left - right and speed is the mean. Firmware source, commit a0751d5.
"""

from __future__ import annotations

from struct import Struct

from failstop.board.checks import FrameError
from failstop.board.wire import beyond, two_speeds

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

START = 0xABCD
LIMIT = 1000.0
"""The board clamps steer and speed to this: in its speed mode 1000 rpm, by default all of the voltage."""
APART = 1000.0
"""The largest steer: the board clamps it alone, so a wider difference would drive another way than it was asked to."""
UNIT = "thousandths of the voltage (VLT_MODE, the default) or rpm (SPD_MODE)"

_COMMAND = Struct("<HhhH")


def seal(steer: int, speed: int) -> bytes:
    """The frame with any two words, unchecked."""
    check = START ^ (steer & 0xFFFF) ^ (speed & 0xFFFF)
    return _COMMAND.pack(START, steer, speed, check)


def motion(both: Sequence[float], limit: float) -> bytes:
    """The frame for left and right, each within plus or minus `limit`. Raises FrameError.

    Speeds become whole numbers, towards zero. The larger loses one more where their sum is odd: half a unit in the
    mean would be rounded by the board, and a wheel at rest told to creep backward.
    """
    left, right = (int(speed) for speed in two_speeds(both, limit, LIMIT, "units"))
    if (left + right) % 2:
        if abs(left) > abs(right):
            left -= 1 if left > 0 else -1
        else:
            right -= 1 if right > 0 else -1
    if abs(left - right) > APART:
        raise FrameError(f"left {left} and right {right} are more than {APART:g} apart, must be less")
    return seal(left - right, (left + right) // 2)


STOP = motion((0.0, 0.0), 0.0)


def wheels(steer: int, speed: int) -> tuple[float, float]:
    """Left and right, as the board mixes them: floored, then clamped."""
    # In sixteenths of a unit, as the firmware computes.
    left, right = (speed * 16 + steer * 8) >> 4, (speed * 16 - steer * 8) >> 4
    return max(-LIMIT, min(left, LIMIT)), max(-LIMIT, min(right, LIMIT))


def _words(frame: bytes) -> tuple[int, int] | None:
    """Steer and speed of bytes that look like a command frame, whatever their xor is."""
    if len(frame) != _COMMAND.size:
        return None
    start, steer, speed, _ = _COMMAND.unpack(frame)
    return (steer, speed) if start == START else None


def _exact(steer: int, speed: int) -> tuple[float, float]:
    """Left and right without the board's clamps."""
    return speed + steer / 2, speed - steer / 2


def speeds(frame: bytes) -> tuple[float, float] | None:
    """Left and right of a command frame, exact; None for other bytes."""
    found = _words(frame)
    return _exact(*found) if found and seal(*found) == frame else None


MARKS = (0, 1, 0, 2)
"""Units that a frame which is sent again and again is slower, in turn: of any three in a row the middle one may be
lost, and the echo still says which of the others it is."""


def marked(frame: bytes, turn: int) -> bytes:
    """The motion frame with both wheels slower by the mark of this turn, and neither of them at rest by it: the echo of
    a steady speed would say nothing of whether frames still arrive. A wheel that turns alone loses twice as much, since
    the sum of both must stay even."""
    if (found := _words(frame)) is None:
        return frame
    both = [int(each) for each in _exact(*found)]
    turning = [abs(each) for each in both if each]
    unit = 3 - len(turning) if turning else 0
    less = unit * MARKS[turn % len(MARKS)]
    while less and less >= min(turning):
        less -= unit
    left, right = (each - less if each > 0 else each + less if each else 0 for each in both)
    return seal(left - right, (left + right) // 2)


def check_motion(frame: bytes, limit: float) -> str:
    """Why these bytes must not be written as a motion frame; "" when they may. Never raises on bytes."""
    found = _words(frame)
    if found is None:
        return "not a command frame"
    if seal(*found) != frame:
        return "bad xor"
    if abs(found[0]) > APART:
        return f"steer {found[0]}, must be within {APART:g}"
    # The exact values: what the board's clamps would hide is refused too.
    return beyond(_exact(*found), limit, LIMIT)
