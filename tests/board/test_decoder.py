"""Frames from the board: decoding in any pieces, recovery after garbage, and the parsers."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.board.interface import BUTTONS, HEARD_ODD, HEARD_PONG
from failstop.board.rrc import decoder
from failstop.board.rrc.board import BOARD as RRC
from failstop.board.rrc.decoder import Decoder
from failstop.board.rrc.framing import BUS_SERVO, GAMEPAD, IMU_FUNC, KEY_FUNC, PWM_SERVO, SBUS, SYS, crc8, seal
from failstop_lab.sim import upward

UP = {
    name: bytes.fromhex(text)
    for name, text in json.loads(Path(__file__).with_name("vectors.json").read_text())["up"].items()
}

ENCODED: dict[str, Callable[[], bytes]] = {
    "battery 7400 mV": lambda: upward.battery(7400),
    "key 1 pressed": lambda: upward.key_frame(1, 0x01),
    "gamepad X": lambda: upward.gamepad_frame(BUTTONS["X"]),
    "pwm servo 1 at 1500 us (the ping's answer)": lambda: upward.pwm_servo_position(1, 1500),
}
DECODED: dict[str, tuple[int, Callable[[bytes], object], object]] = {
    "battery 7400 mV": (SYS, decoder.battery_mv, 7400),
    "key 1 pressed": (KEY_FUNC, decoder.key, (1, 0x01)),
    "gamepad X": (GAMEPAD, decoder.gamepad, (0x0100, 0, 0, 0, 0, 0)),
    "pwm servo 1 at 1500 us (the ping's answer)": (PWM_SERVO, partial(decoder.servo_reply, PWM_SERVO), (1, 0x05, 1500)),
}

frames = st.builds(seal, st.integers(0, 11), st.binary(max_size=decoder.LONGEST))


def test_published_frames_are_made_and_read() -> None:
    assert {name: make() for name, make in ENCODED.items()} == UP
    for name, (func, parse, value) in DECODED.items():
        ((got_func, data),) = Decoder().feed(UP[name])
        assert (got_func, parse(data)) == (func, value)


def test_every_frame_of_a_clean_stream_is_found() -> None:
    stream = b"".join(UP.values()) * 3
    assert len(Decoder().feed(stream)) == 3 * len(UP)


@given(sent=st.lists(frames, max_size=8), sizes=st.lists(st.integers(1, 40), min_size=1, max_size=20))
def test_any_frames_in_any_pieces(sent: list[bytes], sizes: list[int]) -> None:
    stream = b"".join(sent)
    machine = Decoder()
    got = []
    turn = 0
    while stream:
        size = sizes[turn % len(sizes)]
        got += machine.feed(stream[:size])
        stream = stream[size:]
        turn += 1
    assert got == [(frame[2], frame[4:-1]) for frame in sent]
    assert machine._pending == b""


@given(
    garbage=st.one_of(
        st.binary(max_size=300), st.lists(st.sampled_from([0xAA, 0x55, 0, 7, 24]), max_size=60).map(bytes)
    )
)
def test_frames_behind_garbage_are_found(garbage: bytes) -> None:
    machine = Decoder()
    got = machine.feed(garbage)
    # Enough frames that whatever the garbage announced is over.
    tail = upward.battery(7400) * 12
    got += machine.feed(tail)
    assert got[-1] == (SYS, upward.battery(7400)[4:-1])
    assert all(seal(*each) in garbage + tail for each in got)


@given(chunks=st.lists(st.binary(max_size=500), max_size=10))
def test_holds_no_more_than_one_frame(chunks: list[bytes]) -> None:
    machine = Decoder()
    for chunk in chunks:
        machine.feed(chunk)
        assert len(machine._pending) < decoder.LONGEST + 5


@pytest.mark.parametrize(
    "garbage",
    [
        *(b"\xaa\x55\x07\x18"[:cut] for cut in range(1, 5)),
        upward.imu_frame(0, 0, 1, 0, 0, 0)[:20],
        *(b"\xaa\x55\x00\x05\xaa\x55", b"\xaa\x55\x0c\x00", b"\xaa\x55\x07\xff"),
    ],
    ids=bytes.hex,
)
def test_no_frame_behind_a_cut_one_is_lost(garbage: bytes) -> None:
    # The board's own receiver loses the frames it takes for the rest of the cut one.
    wanted = [upward.key_frame(1, 1), upward.battery(7400), upward.imu_frame(1, 2, 3, 4, 5, 6), upward.battery(7300)]
    machine = Decoder()
    assert machine.feed(garbage + b"".join(wanted)) == [(frame[2], frame[4:-1]) for frame in wanted]


def test_a_flipped_bit_costs_one_frame() -> None:
    frame = upward.imu_frame(0.1, 0.2, 1.0, 3.0, 4.0, 5.0)
    for bit in range(8 * len(frame)):
        damaged = bytearray(frame)
        damaged[bit // 8] ^= 1 << bit % 8
        machine = Decoder()
        got = machine.feed(bytes(damaged) + frame * 3)
        assert got == [(IMU_FUNC, frame[4:-1])] * 3, bit


def test_frames_on_both_sides_of_a_damaged_one_are_read_once() -> None:
    before, damaged, after = upward.key_frame(1, 1), bytearray(upward.battery(7400)), upward.key_frame(2, 1)
    damaged[-1] ^= 1
    assert Decoder().feed(before + damaged + after) == [(KEY_FUNC, b"\x01\x01"), (KEY_FUNC, b"\x02\x01")]


def test_the_longest_data_is_read_and_a_longer_length_is_noise_at_once() -> None:
    longest, longer = (seal(SBUS, bytes(size)) for size in (decoder.LONGEST, decoder.LONGEST + 1))
    battery = upward.battery(7400)
    assert Decoder().feed(longest) == [(SBUS, bytes(decoder.LONGEST))]
    assert Decoder().feed(longer + battery) == [(SYS, battery[4:-1])]
    assert Decoder().feed(longer[:4] + battery) == [(SYS, battery[4:-1])]


def test_reset_forgets_a_partial_frame() -> None:
    machine = Decoder()
    machine.feed(upward.battery(7400)[:5])
    machine.reset()
    assert machine.feed(upward.battery(7400)[5:] + upward.key_frame(2, 0x20)) == [(KEY_FUNC, b"\x02\x20")]


def data_of(frame: bytes) -> bytes:
    assert crc8(frame[2:]) == 0
    assert frame[3] == len(frame) - 5
    return frame[4:-1]


def test_what_is_sent_is_read_and_an_imu_that_is_not_finite_is_odd() -> None:
    values = (0.5, -0.25, 1.0, 12.5, -3.0, 0.0)
    assert decoder.imu(data_of(upward.imu_frame(*values))) == values
    for place, bad in itertools.product(range(6), (math.nan, math.inf, -math.inf)):
        wrong = list(values)
        wrong[place] = bad
        [(kind, (what, _))] = RRC.hearing().feed(upward.imu_frame(*wrong))
        assert (kind, what) == (HEARD_ODD, "IMU")
    pad = (0xC00F, 3, -128, 127, -1, 1)
    assert decoder.gamepad(data_of(upward.gamepad_frame(*pad))) == pad
    assert all(decoder.key(data_of(upward.key_frame(2, event))) == (2, event) for event in decoder.KEY_EVENTS)


def test_buttons_and_key_events_are_those_described() -> None:
    described = (
        "L2 0001, R2 0002, SELECT 0004, START 0008, L3 0020, R3 0040, X 0100, O 0200, SQUARE 0800, TRIANGLE 1000, "
        "L1 4000, R1 8000"
    )
    assert ", ".join(f"{name} {bit:04X}" for name, bit in BUTTONS.items()) == described
    events = "1 pressed, 2 long, 4 long-repeat, 8 release after long, 16 release after short, 32 click, 64 double"
    assert ", ".join(f"{event} {name}" for event, name in decoder.KEY_EVENTS.items()) == f"{events}, 128 triple"


def test_servo_replies() -> None:
    assert decoder.servo_reply(PWM_SERVO, data_of(upward.pwm_servo_deviation(3, -20))) == (3, 0x09, -20)
    for what, value in ((0x05, -12), (0x05, None), (0x09, 41)):
        assert decoder.servo_reply(BUS_SERVO, data_of(upward.bus_servo(7, what, value))) == (7, what, value)
    assert decoder.servo_reply(BUS_SERVO, bytes((7, 0x07, 0, 0x10, 0x27))) == (7, 0x07, 10_000)


def test_the_answer_to_a_ping_names_the_ping_and_no_other_answer_does() -> None:
    pings = RRC.pings
    assert [RRC.hearing().feed(upward.pwm_servo_position(servo, 1500)) for servo in range(1, 5)] == [
        [(HEARD_PONG, (index,))] for index in range(len(pings))
    ]
    assert [ping[-2] for ping in pings] == [1, 2, 3, 4], "the servos that they ask"
    others = [upward.pwm_servo_position(servo, 1500) for servo in (0, 5, 255)]
    others += [upward.pwm_servo_deviation(1, 20), upward.bus_servo(1, 0x05, 500), upward.key_frame(1, 1), *pings]
    others += [seal(PWM_SERVO, data) for data in (b"", b"\x01\x05", b"\x01\x05\xdc")]
    assert [kind for other in others for kind, _ in RRC.hearing().feed(other) if kind == HEARD_PONG] == []


NONSENSE: list[tuple[Callable[[bytes], object], tuple[bytes, ...]]] = [
    (decoder.battery_mv, (b"", b"\x04\xe8", b"\x05\xe8\x1c")),
    (decoder.key, (b"\x01", b"\x01\x03", b"\x01\x00", b"\x01\x01\x01")),
    (decoder.imu, (bytes(23), bytes(25))),
    (decoder.gamepad, (bytes(6), bytes(8))),
    (partial(decoder.servo_reply, PWM_SERVO), (b"", b"\x01", b"\x01\x05", b"\x01\x05\xdc", b"\x01\x06\xdc\x05")),
    (
        partial(decoder.servo_reply, BUS_SERVO),
        (b"", b"\x01", b"\x01\x05", b"\x01\x05\0\0", b"\x01\x33\0\0\0", bytes((254, 0x12, 0, 9))),
    ),
    (partial(decoder.servo_reply, SBUS), (b"\x01\x05\xdc\x05",)),
]


def test_data_that_makes_no_sense_is_nothing() -> None:
    assert [(read, data) for read, each in NONSENSE for data in each if read(data) is not None] == []
