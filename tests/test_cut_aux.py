"""Frames that move no wheel, under the proof of motor frames: cut anywhere, then the burst, and no wheel has moved,
and no other sound was made."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from failstop.board.burst import BURST
from failstop.board.codec import STOP, buzzer, check_aux
from failstop.board.framing import BUZZER, MOTOR, SYS, FrameError, seal
from failstop.lab.sim.motors import Motors
from failstop.lab.sim.receiver import Receiver

pytestmark = pytest.mark.slow  # they cut each frame at every byte
VERSIONS = (10, 11, 12)
STOP_DATA = STOP[4:-1]
SPINNING = (0.5, -0.25, 0.75, -1.0)
REST = (0.0, 0.0, 0.0, 0.0)


def judge(stream: bytes, sound: bytes, version: int = 12) -> None:
    """The last motor command that the board executes is a stop, no wheel has got another speed, no handler ran whose
    lists could lead it outside its tables, where the wheels' set points are too, and no other sound was made."""
    receiver, motors = Receiver(version), Motors(SPINNING)
    last = b""
    for _, func, data in receiver.feed(stream):
        if func == MOTOR:
            last = data
            assert motors.execute(data) == REST, stream.hex()
        else:
            assert func == SYS or (func, data) == (BUZZER, sound), stream.hex()
    assert last == STOP_DATA
    assert motors.stopped
    assert not motors.wild
    assert motors.kind == 0


class MotorHeadInside(Exception):
    """Values that the encoder refuses, since they put the start of a motor frame on the wire."""


def sound(freq_hz: int, on_ms: int, off_ms: int, repeat: int) -> bytes:
    """Raises MotorHeadInside; values in range are refused for nothing else."""
    try:
        return buzzer(freq_hz, on_ms, off_ms, repeat)
    except FrameError as error:
        if "aa5503" not in str(error):
            raise
        raise MotorHeadInside from None


def cut_anywhere(frame: bytes, versions: Sequence[int] = VERSIONS) -> None:
    for version in versions:
        for cut in range(len(frame) + 1):
            judge(frame[:cut] + BURST, frame[4:-1], version)


U16 = (1, 255, 256, 0xAA55, 0x55AA, 65_534, 65_535)


def test_at_its_bounds_cut_anywhere() -> None:
    """With the values at the ends of the ranges, and those that look like a frame's head."""
    made = set()
    for values in product((20, 0x55AA % 20_000, 20_000), U16, U16, U16):
        with contextlib.suppress(MotorHeadInside):
            made.add(sound(*values))
    assert made
    for frame in made:
        assert check_aux(frame) == ""
        cut_anywhere(frame, (12,))


TIME = st.integers(1, 65_535)


@given(freq_hz=st.integers(20, 20_000), on_ms=TIME, off_ms=TIME, repeat=TIME, data=st.data())
@settings(max_examples=40, deadline=None)
def test_any_frame_that_can_be_encoded_cut_anywhere(
    freq_hz: int, on_ms: int, off_ms: int, repeat: int, data: st.DataObject
) -> None:
    try:
        frame = sound(freq_hz, on_ms, off_ms, repeat)
    except MotorHeadInside:
        return
    assert check_aux(frame) == ""
    cut_anywhere(frame)
    # And the burst cut too, and written again: its rest first, or a whole one.
    first, second = data.draw(st.integers(0, len(frame))), data.draw(st.integers(0, len(BURST)))
    judge(frame[:first] + BURST[:second] + BURST, frame[4:-1])
    judge(frame[:first] + BURST + BURST, frame[4:-1])
    judge(frame + frame[:first] + BURST, frame[4:-1])


@given(data=st.binary(min_size=8, max_size=8))
@settings(max_examples=300, deadline=None)
def test_whatever_passes_the_check_may_be_cut_anywhere(data: bytes) -> None:
    """The port owner asks nothing else of a frame that is not motion, whoever made it."""
    frame = seal(BUZZER, data)
    if check_aux(frame) == "":
        cut_anywhere(frame, (12,))
