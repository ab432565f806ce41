"""Feedback of hoverboard-firmware-hack-FOC: a frame of nine words every 10 ms, the last one the xor of the others.

A fork has eleven words: two wheel counters come before the battery (24955d6, used by hoverboard-robotics' ROS driver).
The counters wrap at a number specific to the fork, so they are not used as positions.
"""

from __future__ import annotations

from struct import Struct

from failstop.board.hoverboard.codec import START, wheels
from failstop.board.wire import Battery, Firmware, Obeyed, Reader, Sample, Wheels

FEEDBACK = Struct("<HhhhhhhHH")
"""Start, steer and speed that it obeys, measured speed right and left in rpm, battery in V / 100, temperature, LEDs,
xor."""
WITH_COUNTERS = Struct("<HhhhhhhhhHH")
"""The same, with both counters, right and left, after the speeds."""
FORK = Firmware(
    "the fork for hoverboard-robotics' ROS driver, by its feedback of 22 bytes: build it without TANK_STEERING, since "
    "failstop sends steer and speed, and note that its SPD_MODE counts in rpm"
)
HEAD = START.to_bytes(2, "little")


def seal(
    steer: int,
    speed: int,
    right_rpm: int = 0,
    left_rpm: int = 0,
    centivolts: int = 0,
    degrees: int = 0,
    *,
    counters: tuple[int, ...] = (),
) -> bytes:
    """A feedback frame as the board makes it, with its LEDs off; `counters`: right and left, for the fork."""
    words = (START, steer, speed, right_rpm, left_rpm, *counters, centivolts, degrees, 0)
    check = 0
    for word in words:
        check ^= word & 0xFFFF
    return (WITH_COUNTERS if counters else FEEDBACK).pack(*words, check)


class Feedback(Reader):
    """Decodes the board's feedback. Words with a wrong xor are dropped up to the next start."""

    def __init__(self) -> None:
        self._kept = b""
        self._forms = (FEEDBACK, WITH_COUNTERS)
        """The form of the last frame, and the other form. The other one counts only if another frame follows it,
        because a stray start, a frame of nine words and the next start together have a valid xor as eleven words."""
        self._fork_reported = False

    def feed(self, chunk: bytes) -> list[Sample]:
        """The samples that these bytes complete."""
        data = self._kept + chunk
        found: list[Sample] = []
        at = 0
        while (at := data.find(HEAD, at)) >= 0:
            form, other = self._forms
            if not _whole(form, data[at : at + form.size]):
                end = at + other.size
                if len(data) < at + WITH_COUNTERS.size + len(HEAD):
                    break
                if not (_whole(other, data[at:end]) and data.startswith(HEAD, end)):
                    at += 1
                    continue
                form, self._forms = other, (other, form)
            if form is WITH_COUNTERS and not self._fork_reported:
                self._fork_reported = True
                found.append(FORK)
            found += _samples(form.unpack(data[at : at + form.size]))
            at += form.size
        # Without a start, the last byte may still be the first byte of one.
        self._kept = data[at:] if at >= 0 else data[-1:]
        return found


def _rpm(word: int) -> float:
    """The average speed that a word stands for, rpm. The firmware truncates a speed towards zero to sixteenths of an
    rpm, and rounds those down to whole ones (BLDC_controller.c, commit a0751d5). Taken literally, the right wheel,
    which is mounted the other way round, would be 1 rpm faster than the left one when driving straight. Below 5 rpm the
    firmware sends 0."""
    if not word:
        return 0.0
    return word + (8 / 16 if word > 0 else 7 / 16)


def _whole(form: Struct, frame: bytes) -> bool:
    """True if these bytes are a frame of that form."""
    if len(frame) != form.size:
        return False
    check = 0
    for word in form.unpack(frame):
        check ^= word & 0xFFFF
    return check == 0


def _samples(words: tuple[int, ...]) -> list[Sample]:
    """The samples in a frame of either form. The battery is the fourth word from the end."""
    _, steer, speed, right, left, *_ = words
    # The motors are mounted in opposite directions, so forward is negative on the right.
    speeds = (_rpm(left), -_rpm(right) + 0.0)
    return [Obeyed(wheels(steer, speed)), Wheels(speeds, ()), Battery(words[-4] / 100)]
