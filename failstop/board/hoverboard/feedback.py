"""The feedback of hoverboard-firmware-hack-FOC: every 10 ms a frame of nine words. The last word is the xor of the
others.

A fork (24955d6, used by hoverboard-robotics' ROS driver) sends eleven words, with two wheel counters before the
battery. The counters wrap at a number that only this fork has, so they are not used as positions.
"""

from __future__ import annotations

from struct import Struct

from failstop.board.hoverboard.codec import START, wheels
from failstop.board.wire import Battery, Firmware, Obeyed, Reader, Sample, Wheels

FEEDBACK = Struct("<HhhhhhhHH")
"""A feedback frame: the start, steer and speed of the command that the board obeys, the measured speeds right and left
in rpm, the battery in V / 100, the temperature, the LEDs, and the xor."""
WITH_COUNTERS = Struct("<HhhhhhhhhHH")
"""A feedback frame of the fork, which has two counters, right and left, after the measured speeds."""
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
    """Make a feedback frame as the board does, with its LEDs off. `counters` are the counts of the right and the left
    wheel, which only the fork sends."""
    words = (START, steer, speed, right_rpm, left_rpm, *counters, centivolts, degrees, 0)
    check = 0
    for word in words:
        check ^= word & 0xFFFF
    return (WITH_COUNTERS if counters else FEEDBACK).pack(*words, check)


class Feedback(Reader):
    """Decodes the board's feedback. If the xor of a frame is wrong, the bytes up to the next start are dropped."""

    def __init__(self) -> None:
        self._kept = b""
        self._forms = (FEEDBACK, WITH_COUNTERS)
        """The two forms of a frame, the form of the newest frame first. A frame of the second form counts only if the
        start of another frame follows. Otherwise bytes that only look like a frame of the fork could be accepted. For
        example, a stray start, a frame of nine words and the start of the next frame are together eleven words with a
        valid xor."""
        self._fork_reported = False

    def feed(self, chunk: bytes) -> list[Sample]:
        """Return the samples that these bytes complete."""
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
        # If no start was found, the last byte may still be the first byte of one.
        self._kept = data[at:] if at >= 0 else data[-1:]
        return found


def _rpm(word: int) -> float:
    """Convert a speed in the feedback to rpm. The firmware sends the same word for a range of speeds, and this returns
    their average. The firmware truncates a speed towards zero to sixteenths of an rpm, and then rounds it down to whole
    rpm (BLDC_controller.c, commit a0751d5). Below 5 rpm it sends 0. Without the average, the right wheel would seem 1
    rpm faster than the left one when the robot drives straight, because the right motor is mounted the other way
    round."""
    if not word:
        return 0.0
    return word + (8 / 16 if word > 0 else 7 / 16)


def _whole(form: Struct, frame: bytes) -> bool:
    """True if these bytes are a frame of this form."""
    if len(frame) != form.size:
        return False
    check = 0
    for word in form.unpack(frame):
        check ^= word & 0xFFFF
    return check == 0


def _samples(words: tuple[int, ...]) -> list[Sample]:
    """Return the samples in a frame of either form. In both forms, the battery is the fourth word from the end."""
    _, steer, speed, right, left, *_ = words
    # The motors are mounted in opposite directions, so forward is negative on the right.
    speeds = (_rpm(left), -_rpm(right) + 0.0)
    return [Obeyed(wheels(steer, speed)), Wheels(speeds, ()), Battery(words[-4] / 100)]
