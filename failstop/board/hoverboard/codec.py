"""The command frames of hoverboard-firmware-hack-FOC. Firmware source: commit a0751d5.

A frame is four little-endian words: the start ABCD, steer, speed, and the xor of the first three words. With its
default coefficients, the firmware computes left = speed + steer / 2 and right = speed - steer / 2. So steer is left -
right, and speed is the mean of left and right.
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
"""The board clamps steer and speed to plus or minus this number. The unit depends on the firmware: in speed mode 1000
means 1000 rpm, and by default it means the full voltage."""
APART = 1000.0
"""The largest difference between left and right, which is the largest steer. The board clamps steer alone, so with a
larger difference the robot would drive in another direction than commanded."""
UNIT = "thousandths of the voltage (VLT_MODE, the default) or rpm (SPD_MODE)"

_COMMAND = Struct("<HhhH")


def seal(steer: int, speed: int) -> bytes:
    """Return the frame with these two words. The words are not checked."""
    check = START ^ (steer & 0xFFFF) ^ (speed & 0xFFFF)
    return _COMMAND.pack(START, steer, speed, check)


def motion(both: Sequence[float], limit: float) -> bytes:
    """Return the frame that sets the speeds of left and right. Raises FrameError if a speed is not within plus or minus
    `limit`, or if the speeds are more than APART apart.

    Speeds are truncated towards zero to whole numbers. If their sum is odd, the speed that is further from zero goes
    one step closer to zero. With an odd sum, the mean would be rounded down, and a wheel at rest would creep backward.
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
    """Return the speeds of left and right as the board mixes them: rounded down, then clamped."""
    # Computed in sixteenths of a unit, as in the firmware.
    left, right = (speed * 16 + steer * 8) >> 4, (speed * 16 - steer * 8) >> 4
    return max(-LIMIT, min(left, LIMIT)), max(-LIMIT, min(right, LIMIT))


def _words(frame: bytes) -> tuple[int, int] | None:
    """Return steer and speed if these bytes look like a command frame. The xor is not checked."""
    if len(frame) != _COMMAND.size:
        return None
    start, steer, speed, _ = _COMMAND.unpack(frame)
    return (steer, speed) if start == START else None


def _exact(steer: int, speed: int) -> tuple[float, float]:
    """Return the speeds of left and right before the board clamps them."""
    return speed + steer / 2, speed - steer / 2


def speeds(frame: bytes) -> tuple[float, float] | None:
    """Return left and right in a command frame, without rounding. None for other bytes."""
    found = _words(frame)
    return _exact(*found) if found and seal(*found) == frame else None


MARKS = (0, 1, 0, 2)
"""While failstop repeats the same motion, it slows the frames by these numbers of units in turn. Each slowed frame
differs from the slowed frame before it. So if a slowed frame is lost, a report of the next one can't be taken for a
report of the lost one."""


def marked(frame: bytes, turn: int) -> bytes:
    """Return the motion frame with its turning wheels slowed by the mark of this turn (MARKS). Without marks, the
    board's reports of a steady speed would not show whether frames still arrive. A mark never stops a turning wheel. If
    only one wheel turns, it is slowed by twice the mark, because the sum of the two speeds must stay even."""
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
    """Say why these bytes must not be written as a motion frame. Returns "" if they may be written. Never raises,
    whatever the bytes are."""
    found = _words(frame)
    if found is None:
        return "not a command frame"
    if seal(*found) != frame:
        return "bad xor"
    if abs(found[0]) > APART:
        return f"steer {found[0]}, must be within {APART:g}"
    # Check the speeds before the board's clamps, because a clamp could hide a speed that is too high.
    return beyond(_exact(*found), limit, LIMIT)
