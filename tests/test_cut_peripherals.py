"""Frames that move no wheel, under the proof of motor frames: cut anywhere, then the burst, and no wheel has moved."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable, Iterator, Sequence
from itertools import product
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from failstop.board import framing, peripherals
from failstop.board.burst import BURST
from failstop.board.codec import STOP
from failstop.board.framing import AUX_FUNCS, MAX_DATA, MOTOR, PWM_SERVO, FrameError, seal
from failstop.board.peripherals import check_aux
from failstop.lab import encoders
from failstop.lab.sim.motors import Motors
from failstop.lab.sim.receiver import Receiver

pytestmark = pytest.mark.slow  # they cut each frame at every byte
VERSIONS = (10, 11, 12)
STOP_DATA = STOP[4:-1]
SPINNING = (0.5, -0.25, 0.75, -1.0)
REST = (0.0, 0.0, 0.0, 0.0)


def judge(stream: bytes, version: int = 12) -> None:
    """The last motor command that the board executes is a stop, no wheel has got another speed, and no handler was led
    outside its tables, where the wheels' set points are too."""
    receiver, motors = Receiver(version), Motors(SPINNING)
    last = b""
    for _, func, data in receiver.feed(stream):
        if func == MOTOR:
            last = data
            assert motors.execute(data) == REST, stream.hex()
        else:
            assert peripherals._reaches_outside(func, data) in ("", "no sub-command"), stream.hex()
    assert last == STOP_DATA
    assert motors.stopped
    assert not motors.wild
    assert motors.kind == 0


class MotorHeadInside(Exception):
    """Values that an encoder refuses, since they put the start of a motor frame on the wire."""


def encode_or_refuse(encode: Callable[..., bytes], arguments: tuple[Any, ...]) -> bytes:
    """Raises MotorHeadInside; values in range are refused for nothing else."""
    try:
        return encode(*arguments)
    except FrameError as error:
        if "aa5503" not in str(error):
            raise
        raise MotorHeadInside from None


def cut_anywhere(frame: bytes, versions: Sequence[int] = VERSIONS) -> None:
    for version in versions:
        for cut in range(len(frame) + 1):
            judge(frame[:cut] + BURST, version)


U16 = (1, 255, 256, 0xAA55, 0x55AA, 65_534, 65_535)
DURATIONS = (0, 1, 255, 256, 0x55AA % 30_000, 29_999, 30_000)
PULSES = (500, 501, 0x0555, 2499, 2500)
COLOURS = (0, 1, 0x55, 0xAA, 255)


def at_bounds() -> Iterator[tuple[str, Callable[..., bytes], Iterator[tuple[Any, ...]]]]:
    """Every encoder with the values at the ends of its ranges, and those that look like a frame's head."""
    yield "buzzer", peripherals.buzzer, product((20, 0x55AA % 20_000, 20_000), U16, U16, U16)
    yield "led", encoders.led, product((1, 2), (0, *U16), (0, *U16), (0, 1, 65_535))
    yield "oled", encoders.oled, product((1, 2), ("", " ", "~", "U" * 22, " " * 23, "~" * 23, "x" * 23))
    one = [[(index, *colour)] for index in (0, 1) for colour in product(COLOURS, repeat=3)]
    two = [[(0, *first), (1, *second)] for first, second in product([(c, c, c) for c in COLOURS], repeat=2)]
    yield "rgb", encoders.rgb, ((pixels,) for pixels in (*one, *two))
    yield "alarm", encoders.battery_alarm, ((mv,) for mv in (1000, 0x0455, 0x55AA, 29_999, 30_000))
    yield "pwm one", encoders.pwm_servo_move_one, product((1, 2, 3, 4), PULSES, DURATIONS)
    moves = [[(servo, pulse) for servo in range(1, last + 1)] for last in (1, 2, 3, 4) for pulse in PULSES]
    yield "pwm", encoders.pwm_servo_move, product(moves, DURATIONS)
    yield "pwm deviation", encoders.pwm_servo_deviation, product((1, 2, 3, 4), range(-100, 101))
    for ask in (peripherals.pwm_servo_read, encoders.pwm_servo_read_deviation):
        yield ask.__name__, ask, ((servo,) for servo in (1, 2, 3, 4))


@pytest.mark.parametrize(("encode", "values"), [row[1:] for row in at_bounds()], ids=[row[0] for row in at_bounds()])
def test_at_its_bounds_cut_anywhere(encode: Callable[..., bytes], values: Iterator[tuple[Any, ...]]) -> None:
    made = set()
    for arguments in values:
        with contextlib.suppress(MotorHeadInside):
            made.add(encode_or_refuse(encode, arguments))
    assert made
    for frame in made:
        assert check_aux(frame) == ""
        cut_anywhere(frame, (12,))


U16S = st.integers(0, 65_535)
MS = st.integers(0, 30_000)
PULSE = st.integers(500, 2500)


def targets(most: int, ids: int, low: int, high: int) -> st.SearchStrategy[list[tuple[int, int]]]:
    one = st.tuples(st.integers(1, ids), st.integers(low, high))
    return st.lists(one, min_size=1, max_size=most, unique_by=lambda move: move[0])


BYTE = st.integers(0, 255)
PIXELS = st.lists(st.tuples(st.integers(0, 1), BYTE, BYTE, BYTE), min_size=1, max_size=2, unique_by=lambda p: p[0])
FRAMES: dict[str, st.SearchStrategy[tuple[Callable[..., bytes], tuple[Any, ...]]]] = {
    "buzzer": st.tuples(st.just(peripherals.buzzer), st.tuples(st.integers(20, 20_000), *[st.integers(1, 65_535)] * 3)),
    "led": st.tuples(st.just(encoders.led), st.tuples(st.integers(1, 2), U16S, U16S, U16S)),
    "oled": st.tuples(
        st.just(encoders.oled),
        st.tuples(st.integers(1, 2), st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=23)),
    ),
    "rgb": st.tuples(st.just(encoders.rgb), st.tuples(PIXELS)),
    "alarm": st.tuples(st.just(encoders.battery_alarm), st.tuples(st.integers(1000, 30_000))),
    "pwm": st.tuples(st.just(encoders.pwm_servo_move), st.tuples(targets(4, 4, 500, 2500), MS)),
    "pwm one": st.tuples(st.just(encoders.pwm_servo_move_one), st.tuples(st.integers(1, 4), PULSE, MS)),
}


@pytest.mark.parametrize("name", FRAMES)
@given(data=st.data())
@settings(max_examples=40, deadline=None)
def test_any_frame_that_can_be_encoded_cut_anywhere(name: str, data: st.DataObject) -> None:
    encode, arguments = data.draw(FRAMES[name])
    try:
        frame = encode_or_refuse(encode, arguments)
    except MotorHeadInside:
        return
    assert check_aux(frame) == ""
    cut_anywhere(frame)
    # And the burst cut too, and written again: its rest first, or a whole one.
    first, second = data.draw(st.integers(0, len(frame))), data.draw(st.integers(0, len(BURST)))
    judge(frame[:first] + BURST[:second] + BURST)
    judge(frame[:first] + BURST + BURST)
    judge(frame + frame[:first] + BURST)


@given(func=st.sampled_from(AUX_FUNCS), data=st.binary(max_size=MAX_DATA), command=st.integers(0, 12))
@example(func=PWM_SERVO, data=b"\x01\x00\x00\x04" + bytes(12), command=1)
@settings(max_examples=300, deadline=None)
@pytest.mark.slow
def test_whatever_passes_the_check_may_be_cut_anywhere(func: int, data: bytes, command: int) -> None:
    """The port owner asks nothing else of a frame that is not motion, whoever made it."""
    for body in (data, bytes((command,)) + data[1:], bytes((command,)) + data[1:16]):
        frame = seal(func, body)
        if check_aux(frame) == "":
            cut_anywhere(frame, (12,))


def zero_crc_when_cut() -> bytes:
    """A servo's frame whose CRC is zero after its first byte of data but four, from an encoder that does not look."""
    for duration, pulse in product(range(256), range(500, 756)):
        data = b"\x03" + struct.pack("<HBH", duration, 1, pulse)
        if framing.crc8((PWM_SERVO, len(data), *data[:3])) == 0:
            return seal(PWM_SERVO, data)
    raise AssertionError("none found")


def test_control_zeros_complete_such_a_frame_and_the_check_refuses_it() -> None:
    frame = zero_crc_when_cut()
    with pytest.raises(AssertionError):
        cut_anywhere(frame)
    assert check_aux(frame).startswith("pwm servo id 0 if cut after ")


@pytest.mark.parametrize("servo", [1, 2, 3, 4])
def test_a_servo_s_move_is_the_one_that_was_asked_for_within_a_few_milliseconds(servo: int) -> None:
    changed = 0
    for pulse, duration in product(range(500, 2501, 37), (*range(0, 30_000, 997), 30_000)):
        frame = encoders.pwm_servo_move_one(servo, pulse, duration)
        command, made, found, at = struct.unpack("<BHBH", frame[4:-1])
        assert (command, found, at) == (3, servo, pulse)
        assert abs(made - duration) <= 2
        assert 0 <= made <= 30_000
        changed += made != duration
    assert changed, "the test can fail"


@pytest.mark.parametrize("func", [func for func in AUX_FUNCS if func != framing.BUS_SERVO])
def test_what_is_longer_than_the_burst_s_first_zeros_is_not_written(func: int) -> None:
    assert check_aux(seal(func, b"\x01" + bytes(31))) == "32 bytes of data, limit 31"
    assert check_aux(seal(func, b"\x01" + bytes(30))) == ""
