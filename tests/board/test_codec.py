"""Frames to the board: every encoder against the published bytes, what must never be made or written, and the
two checks before the wire."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable
from inspect import isfunction
from pathlib import Path
from struct import pack, unpack
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from failstop.board.checks import FrameError
from failstop.board.rrc import codec, framing, servos
from failstop.board.rrc.burst import BURST
from failstop.board.rrc.codec import STOP, check_aux, check_motion
from failstop.board.rrc.framing import MOTOR, seal
from failstop.board.servos import POSITION, SUPPLY, TEMPERATURE, TORQUE
from failstop_lab.sim.motors import Motors
from failstop_lab.sim.receiver import Receiver
from tests.support import frames
from tests.support.frames import PING

VECTORS = json.loads(Path(__file__).with_name("vectors.json").read_text())
DOWN = {name: bytes.fromhex(text) for name, text in VECTORS["down"].items()}
ENCODED: dict[str, Callable[[], bytes]] = {
    "stop": lambda: codec.motor_speeds((0.0, 0.0, 0.0, 0.0), 1.0),
    "motor wire id 1 at -1.0 rps": lambda: frames.motor_one(1, -1.0),
    "motor stop wire id 1": lambda: frames.motor_stop_one(1),
    "motors id 1 at -1.0 rps and id 2 at +2.0 rps": lambda: frames.motor_some([(1, -1.0), (2, 2.0)]),
    "motor stop mask 0x05": lambda: frames.motor_stop_mask(0x05),
    "motors 0..3 at 0.5, -0.25, 0, 1.5 rps": lambda: codec.motor_speeds((0.5, -0.25, 0.0, 1.5), 1.5),
    "buzzer 1400 Hz, on 100 ms, off 100 ms, 5 times": lambda: codec.buzzer(1400, 100, 100, 5),
    "buzzer 1000 Hz, on 500 ms, off 300 ms, 10 times": lambda: codec.buzzer(1000, 500, 300, 10),
    "led 1 on 500 ms, off 300 ms, 10 times": lambda: frames.led(1, 500, 300, 10),
    "pwm servo 1 to 1000 us in 1000 ms": lambda: frames.pwm_servo_move_one(1, 1000, 1000),
    "pwm servo 1 read position (the ping)": lambda: codec.pwm_servo_read(1),
    "bus servos 1 to 833 and 2 to 1000 in 1000 ms": lambda: servos.bus_servo_move([(1, 833), (2, 1000)], 1000, 30_000),
    "bus servo 1 torque off": lambda: servos.bus_servo_torque(1, on=False),
    "bus servo 1 torque on": lambda: servos.bus_servo_torque(1, on=True),
    "bus servo 1 read position": lambda: servos.bus_servo_read(1, POSITION),
}


def described() -> list[tuple[bytes, int, str]]:
    """Encoders without a published example, and the bytes written out from the protocol description."""
    return [
        (frames.motor_type(3), framing.MOTOR, "05 03"),
        (frames.pwm_servo_move([(1, 500), (4, 2500)], 30_000), framing.PWM_SERVO, "01 3075 02 01 F401 04 C409"),
        (frames.pwm_servo_deviation(2, -1), framing.PWM_SERVO, "07 02 FF"),
        (frames.pwm_servo_deviation(2, 100), framing.PWM_SERVO, "07 02 64"),
        (frames.pwm_servo_read_deviation(4), framing.PWM_SERVO, "09 04"),
        (servos.bus_servo_stop([3, 253]), framing.BUS_SERVO, "03 02 03 FD"),
        (servos.bus_servo_stop([254]), framing.BUS_SERVO, "03 01 FE"),
        (servos.bus_servo_move([(1, 500)], 40), framing.BUS_SERVO, "01 2800 01 01 F401"),
        (servos.bus_servo_read(2, SUPPLY), framing.BUS_SERVO, "07 02"),
        (servos.bus_servo_read(2, TEMPERATURE), framing.BUS_SERVO, "09 02"),
        (servos.bus_servo_read(2, TORQUE), framing.BUS_SERVO, "0D 02"),
        (frames.oled(2, "10.0.0.7"), framing.OLED, "02 08 31302E302E302E37"),
        (frames.oled(1, ""), framing.OLED, "01 00"),
        (frames.rgb([(1, 255, 128, 0), (0, 1, 2, 3)]), framing.RGB, "01 02 01FF8000 00010203"),
        (frames.battery_alarm(6800), framing.SYS, "01 901A"),
    ]


NAN, INF = math.nan, math.inf

# (the call, the field the message has to name); arguments as a user would pass them by mistake.
BAD: list[tuple[Callable[..., bytes], tuple[Any, ...], str]] = [
    *[(codec.motor_speeds, ((0.0, 0.0, bad, 0.0), 1.0), "speed of wheel 2") for bad in (NAN, INF, -INF, 1.01, -1.01)],
    *[(codec.motor_speeds, ((True, 0.0, 0.0, 0.0), 1.0), "speed of wheel 0") for _ in (0,)],
    *[(codec.motor_speeds, (bad, 1.0), "rps") for bad in ((), (0.0,) * 3, (0.0,) * 5, None, 1.0)],
    *[(codec.motor_speeds, (("0", 0.0, 0.0, 0.0), 1.0), "speed of wheel 0") for _ in (0,)],
    *[(codec.motor_speeds, ((0.0,) * 4, bad), "max_rps") for bad in (NAN, INF, -1.0, 1000.5, True, None, "1")],
    *[(codec.pwm_servo_read, (bad,), "servo id") for bad in (0, 5, True)],
    *[(servos.bus_servo_move, (bad, 40), "moves") for bad in ([], [(1, 500), (2, 500), (3, 500)], None)],
    *[(servos.bus_servo_move, ([bad], 40), "move") for bad in ((1,), (1, 500, 40), "19", {1: 500, 2: 500}, 1, None)],
    *[(servos.bus_servo_move, ([(bad, 500)], 40), "servo id") for bad in (0, 254, 255, -1, True, NAN)],
    *[(servos.bus_servo_move, ([(1, bad)], 40), "position") for bad in (-1, 1001, True, NAN, INF)],
    *[(servos.bus_servo_move, ([(1, 500)], bad), "duration_ms") for bad in (0, -1, 61, 30_000, True)],
    (servos.bus_servo_move, ([(1, 500)], 41, 40), "duration_ms"),
    (servos.bus_servo_move, ([(9, 500), (9, 500)], 40), "servo id 9"),
    *[(servos.bus_servo_stop, (bad,), "servos") for bad in ([], [1, 2, 3, 4], 1)],
    *[(servos.bus_servo_stop, ([1, bad],), "servo id") for bad in (0, 255, True, 1)],
    *[(servos.bus_servo_read, (bad, POSITION), "servo id") for bad in (0, 254, True, None)],
    *[(servos.bus_servo_read, (1, bad), "what") for bad in (0x01, 0x12, 0x10, None)],
    *[(servos.bus_servo_torque, (bad, True), "servo id") for bad in (0, 254, True)],
    *[(servos.bus_servo_torque, (1, bad), "on") for bad in (1, 0, None, "off")],
    *[(codec.buzzer, (bad, 100, 100, 1), "freq_hz") for bad in (0, 19, 20_001, -1, NAN, True)],
    *[(codec.buzzer, (1000, bad, 100, 1), "on_ms") for bad in (0, 65_536, NAN, True)],
    *[(codec.buzzer, (1000, 100, bad, 1), "off_ms") for bad in (0, 65_536, NAN, True)],
    *[(codec.buzzer, (1000, 100, 100, bad), "repeat") for bad in (0, 65_536, INF, True)],
    *[(framing.frame, (bad, b""), "func") for bad in (MOTOR, -1, 12, True, 3.0)],
    *[(framing.frame, (framing.LED, bad), "data") for bad in (bytes(256), "text", [1, 2], 5)],
    (framing.frame, (framing.OLED, b"\x01\x1b" + STOP), "data"),
]


def receive(frame: bytes) -> tuple[int, bytes]:
    ((end, func, data),) = Receiver().feed(frame)
    assert end == len(frame) - 1
    return func, data


def test_frames_are_those_that_are_published_or_described() -> None:
    assert {name: ENCODED[name]().hex() for name in DOWN} == {name: frame.hex() for name, frame in DOWN.items()}
    rows = described()
    assert [receive(frame) for frame, _, _ in rows] == [(func, bytes.fromhex(data)) for _, func, data in rows]
    assert (DOWN["stop"], DOWN["pwm servo 1 read position (the ping)"], len(STOP)) == (STOP, PING, 27)


def test_crc_check_value_and_continuation() -> None:
    assert framing.crc8(b"123456789") == 0xA1
    assert framing.crc8(b"") == 0
    assert framing.crc8(memoryview(b"6789"), framing.crc8(bytearray(b"12345"))) == 0xA1


def test_the_table_has_the_crc_of_every_byte() -> None:
    def bit_by_bit(crc: int) -> int:
        for _ in range(8):
            crc = crc >> 1 ^ (0x8C if crc & 1 else 0)
        return crc

    assert framing._crc_table() == bytes(bit_by_bit(byte) for byte in range(256)) == framing.CRC_TABLE


def refusal(encoder: Callable[..., bytes], arguments: tuple[Any, ...]) -> str:
    try:
        encoder(*arguments)
    except FrameError as error:
        return str(error)
    return "taken"


@pytest.mark.parametrize("encoder", dict.fromkeys(encoder for encoder, _, _ in BAD), ids=lambda each: each.__name__)
def test_bad_input_is_refused_by_name(encoder: Callable[..., bytes]) -> None:
    said = [(field, refusal(encoder, arguments), arguments) for of, arguments, field in BAD if of is encoder]
    assert [each for each in said if not each[1].startswith(each[0]) or "must" not in each[1]] == []


def test_messages_give_value_and_range() -> None:
    with pytest.raises(FrameError, match=r"^speed of wheel 1 is 9\.9, must be a finite number from -1\.4 to 1\.4 rps$"):
        codec.motor_speeds((0.0, 9.9, 0.0, 0.0), 1.4)
    with pytest.raises(FrameError, match=r"^servo id is 0, must be an integer from 1 to 4$"):
        codec.pwm_servo_read(0)
    with pytest.raises(FrameError, match=r"^data is a str, must be bytes$"):
        framing.frame(framing.LED, "on")  # type: ignore[arg-type]


def test_every_encoder_is_in_the_tables() -> None:
    made = {
        name
        for module in (framing, codec, servos)
        for name, found in vars(module).items()
        if isfunction(found) and found.__module__ == module.__name__ and found.__annotations__["return"] == "bytes"
    }
    refused = {encoder.__name__ for encoder, _, _ in BAD}
    assert {name for name in made if not name.startswith("_") and "__mutmut" not in name} - {"seal"} == refused


limits = st.floats(0.0, codec.RPS_CEILING)


@st.composite
def speeds_within(draw: st.DrawFn) -> tuple[list[float], float]:
    limit = draw(limits)
    speed = st.one_of(st.floats(-limit, limit), st.sampled_from([limit, -limit, 0.0, -0.0]))
    return draw(st.lists(speed, min_size=4, max_size=4)), limit


@given(speeds_within())
@example(([0.7, -0.7, 0.7, -0.7], 0.7))
@example(([1e-46] * 4, 1e-46))
@example(([8e-46] * 4, 8e-46))
@example(([1000.0] * 4, 1000.0))
def test_what_is_encoded_passes_the_check_and_reaches_the_wheels(case: tuple[list[float], float]) -> None:
    rps, limit = case
    frame = codec.motor_speeds(rps, limit)
    assert check_motion(frame, limit) == ""
    assert check_aux(frame) == "not a buzzer's frame"
    func, data = receive(frame)
    assert func == MOTOR
    # As asked, or smaller by a few units in the last place: no frame is sent that zeros could complete.
    for got, value in zip(Motors().execute(data), rps, strict=True):
        asked = unpack("<i", pack("<f", abs(value)))[0]
        assert 0 <= asked - unpack("<i", pack("<f", abs(got)))[0] <= 8
        assert got == 0 or (got < 0) == (value < 0)


def test_integers_tuples_and_minus_zero_are_taken() -> None:
    assert codec.motor_speeds((0, 0, 0, 0), 1) == STOP
    assert codec.motor_speeds([-0.0] * 4, 1.0) == STOP
    assert codec.motor_speeds((1, -1, 0, -0.0), 1) == codec.motor_speeds([1.0, -1.0, 0.0, 0.0], 1.0)
    assert codec.motor_speeds(iter([0.5, 0, 0, 0]), 1) == codec.motor_speeds((0.5, 0.0, 0.0, 0.0), 1.0)  # type: ignore[arg-type]


def test_a_limit_of_zero_lets_only_stops_pass() -> None:
    assert codec.motor_speeds((0.0,) * 4, 0.0) == STOP
    assert check_motion(STOP, 0.0) == ""
    with pytest.raises(FrameError):
        codec.motor_speeds((0.0, 0.0, 0.0, 1e-9), 0.0)


@pytest.mark.parametrize(("limit", "over"), [(0.0, 2.0**-149), (1.0, 1.0 + 2.0**-23)])
def test_the_least_speed_over_a_limit_that_was_not_rounded_is_refused(limit: float, over: float) -> None:
    for wheel, rps in itertools.product(range(4), (over, -over)):
        frame = wheels(*((at, rps if at == wheel else 0.0) for at in range(4)))
        assert check_motion(frame, limit) == f"wheel {wheel} at {rps:.2f} rps, limit {limit:.2f}"


@pytest.mark.parametrize("func", [framing.SYS, framing.LED, framing.KEY_FUNC, framing.IMU_FUNC, framing.RGB])
def test_raw_frames_of_other_functions(func: int) -> None:
    assert framing.frame(func, bytearray(b"\x01\x00")) == framing.frame(func, memoryview(b"\x01\x00"))
    data = bytes(range(255))
    frame = framing.frame(func, data)
    assert len(frame) == 260
    assert receive(frame) == (func, data)


REFUSE = {name: bytes.fromhex(text) for name, text in VECTORS["refuse"].items()}


def wheels(*entries: tuple[int, float]) -> bytes:
    return seal(MOTOR, bytes((1, len(entries))) + b"".join(pack("<Bf", *entry) for entry in entries))


MOTION_REASONS = [
    *(
        (frame, "not a motor frame")
        for frame in (
            *(b"", bytes(27), STOP[:-1], STOP + b"\x00", BURST, STOP + STOP),
            *(frames.motor_one(0, 0.5), frames.motor_stop_one(0), frames.motor_stop_mask(15)),
            wheels((0, 0.0), (1, 0.0), (2, 0.0)),
            seal(MOTOR, STOP[4:5] + b"\x05" + STOP[6:-1]),
            seal(MOTOR, b"\x00" + STOP[5:-1]),
            seal(framing.BUS_SERVO, STOP[4:-1]),
        )
    ),
    (STOP[:-1] + b"\x08", "bad crc"),
    *(
        (wheels(*((wheel, 0.0) for wheel in ids)), f"wheel ids {' '.join(map(str, ids))}, must be 0 1 2 3")
        for ids in ((0, 1, 2, 4), (1, 0, 2, 3), (0, 1, 1, 3))
    ),
    (codec.motor_speeds((0.0, 0.0, 9.9, 0.0), 10.0), "wheel 2 at 9.90 rps, limit 1.40"),
    (codec.motor_speeds((-1.41, 0.0, 0.0, 0.0), 10.0), "wheel 0 at -1.41 rps, limit 1.40"),
    *(
        (wheels(*((at, bad if at == wheel else 0.0) for at in range(4))), f"wheel {wheel} at {bad} rps, limit 1.40")
        for wheel, bad in ((1, NAN), (3, INF), (0, -INF))
    ),
]


def test_motion_is_refused_with_its_reason() -> None:
    said = [(frame, check_motion(frame, 1.4)) for frame, _ in MOTION_REASONS]
    assert said == MOTION_REASONS


def test_motion_is_refused_under_an_impossible_limit() -> None:
    assert all(check_motion(STOP, limit).startswith("limit ") for limit in (NAN, INF, -1.0, 1000.5))


def test_a_speed_over_the_limit_by_more_than_rounding_is_refused() -> None:
    just_over = unpack("<f", pack("<I", unpack("<I", pack("<f", 1.4))[0] + 2))[0]
    for wheel in range(4):
        rps = [0.0] * 4
        rps[wheel] = just_over
        assert check_motion(codec.motor_speeds(rps, 2.0), 1.4) == f"wheel {wheel} at 1.40 rps, limit 1.40"


def test_any_damage_of_up_to_one_byte_is_refused() -> None:
    frame = codec.motor_speeds((0.796, 0.796, -0.796, -0.796), 1.4)
    for at in range(len(frame)):
        for value in range(256):
            damaged = frame[:at] + bytes((value,)) + frame[at + 1 :]
            assert (check_motion(damaged, 1000.0) == "") is (damaged == frame)


@given(st.one_of(st.binary(max_size=60), st.binary(min_size=20, max_size=20).map(lambda tail: STOP[:7] + tail)))
def test_checks_never_raise_and_never_both_accept(data: bytes) -> None:
    assert check_motion(data, 1.4) or check_aux(data)


@given(st.lists(st.tuples(st.integers(0, 255), st.binary(min_size=4, max_size=4)), min_size=4, max_size=4))
def test_motion_that_passes_makes_no_wild_write_and_no_speed_beyond_the_limit(entries: list[tuple[int, bytes]]) -> None:
    for ids in ([wheel for wheel, _ in entries], range(4)):
        data = b"\x01\x04" + b"".join(bytes((wheel,)) + raw for wheel, (_, raw) in zip(ids, entries, strict=True))
        motors = Motors()
        motors.execute(data)
        harmless = list(ids) == [0, 1, 2, 3] and all(abs(rps) <= 1.4000001 for rps in motors.speeds_rps)
        assert (check_motion(seal(MOTOR, data), 1.4) == "") is harmless


SOUNDS = {name: bytes.fromhex(text) for name, text in VECTORS["down"].items() if name.startswith("buzzer")} | {
    "the longest and lowest": codec.buzzer(20, 65_535, 65_535, 65_535)
}


@pytest.mark.parametrize("name", SOUNDS)
def test_own_frames_pass_as_aux_and_damaged_or_cut_they_do_not(name: str) -> None:
    frame = SOUNDS[name]
    assert check_aux(frame) == ""
    assert check_motion(frame, 1000.0) == "not a motor frame"
    for at in range(len(frame)):
        assert check_aux(frame[:at])
        assert check_aux(frame[:at] + bytes((frame[at] ^ 0x10,)) + frame[at + 1 :])
    assert check_aux(frame + frame)
    assert check_aux(frame + STOP)
    assert check_aux(b"\x00" + frame)


SOUND = codec.buzzer(1400, 100, 100, 5)
AUX_REASONS = [
    *((frame, "not a buzzer's frame") for frame in (b"", SOUND[:4], SOUND + b"\x00")),
    *((seal(framing.BUZZER, bytes(size)), "not a buzzer's frame") for size in (7, 9)),
    (SOUND[:-1] + bytes((SOUND[-1] ^ 1,)), "bad crc"),
    (seal(framing.BUZZER, b"\x01\xaa\x55\x03\x00\x00\x00\x01"), "the start of a motor frame inside"),
    *(
        (frame, "not a buzzer's frame")
        for frame in (STOP, PING, servos.bus_servo_stop([1]), frames.battery_alarm(6800))
    ),
    *((seal(func, bytes(8)), "not a buzzer's frame") for func in range(256) if func != framing.BUZZER),
]


def test_aux_is_refused_with_its_reason() -> None:
    said = [(frame, check_aux(frame)) for frame, _ in AUX_REASONS]
    assert said == AUX_REASONS


def test_published_frames_that_must_not_be_written_pass_no_check() -> None:
    assert all(check_motion(frame, 1000.0) and check_aux(frame) for frame in REFUSE.values())


@given(
    func=st.sampled_from(framing.AUX_FUNCS),
    data=st.one_of(st.binary(max_size=255), st.binary(min_size=8, max_size=8), st.just(STOP), st.just(BURST[:255])),
)
def test_no_aux_frame_that_passes_holds_a_motor_frame_for_a_receiver_out_of_step(func: int, data: bytes) -> None:
    frame = seal(func, data)
    motor_inside = any(found == MOTOR for start in range(len(frame)) for _, found, _ in Receiver().feed(frame[start:]))
    if motor_inside:
        assert check_aux(frame)
        with pytest.raises(FrameError):
            framing.frame(func, data)
