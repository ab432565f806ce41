"""Feedback of hoverboard-firmware-hack-FOC: a frame of nine words every 10 ms, the last one the xor of the others."""

from __future__ import annotations

from struct import Struct

from failstop.board.hoverboard.codec import START, wheels
from failstop.board.wire import Battery, Obeyed, Reader, Sample, Wheels

FEEDBACK = Struct("<HhhhhhhHH")
"""Start, steer and speed that it obeys, measured speed right and left in rpm, battery in V / 100, temperature, LEDs,
xor."""
HEAD = START.to_bytes(2, "little")


def seal(steer: int, speed: int, right_rpm: int = 0, left_rpm: int = 0, centivolts: int = 0, degrees: int = 0) -> bytes:
    """A feedback frame as the board makes it, with its LEDs off."""
    words = (START, steer, speed, right_rpm, left_rpm, centivolts, degrees, 0)
    check = 0
    for word in words:
        check ^= word & 0xFFFF
    return FEEDBACK.pack(*words, check)


class Feedback(Reader):
    """Words that fail their xor are dropped up to the next start."""

    def __init__(self) -> None:
        self._kept = b""

    def feed(self, chunk: bytes) -> list[Sample]:
        """The samples that these bytes complete."""
        data = self._kept + chunk
        found: list[Sample] = []
        at = 0
        while (at := data.find(HEAD, at)) >= 0 and at + FEEDBACK.size <= len(data):
            samples = _samples(data[at : at + FEEDBACK.size])
            found += samples
            at += FEEDBACK.size if samples else 1
        # Without a start, its first byte may still be the last that came.
        self._kept = data[at:] if at >= 0 else data[-1:]
        return found


def _samples(frame: bytes) -> list[Sample]:
    """Of one frame; none when its xor is wrong."""
    _, steer, speed, right, left, centivolts, _, _, _ = words = FEEDBACK.unpack(frame)
    check = 0
    for word in words:
        check ^= word & 0xFFFF
    if check:
        return []
    # The motors are mounted against each other: forward is negative on the right.
    return [Obeyed(wheels(steer, speed)), Wheels((float(left), float(-right)), ()), Battery(centivolts / 100)]
