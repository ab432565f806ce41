"""The two checks before the wire: what they let pass the board handles as meant, and why they refuse the rest."""

from __future__ import annotations

import json
import math
from pathlib import Path
from struct import pack, unpack

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.board import codec, framing, servos
from failstop.board.burst import BURST
from failstop.board.codec import STOP, check_aux, check_motion
from failstop.board.framing import MOTOR, FrameError, seal
from failstop.lab import encoders
from failstop.lab.encoders import PING
from failstop.lab.sim.motors import Motors
from failstop.lab.sim.receiver import Receiver

VECTORS = json.loads(Path(__file__).with_name("vectors.json").read_text())
REFUSE = {name: bytes.fromhex(text) for name, text in VECTORS["refuse"].items()}

NAN, INF = math.nan, math.inf


def wheels(*entries: tuple[int, float]) -> bytes:
    return seal(MOTOR, bytes((1, len(entries))) + b"".join(pack("<Bf", *entry) for entry in entries))


MOTION_REASONS = [
    (b"", "not a motor frame"),
    (bytes(27), "not a motor frame"),
    (STOP[:-1], "not a motor frame"),
    (STOP + b"\x00", "not a motor frame"),
    (BURST, "not a motor frame"),
    (STOP + STOP, "not a motor frame"),
    (encoders.motor_one(0, 0.5, 1.0), "not a motor frame"),
    (encoders.motor_stop_one(0), "not a motor frame"),
    (encoders.motor_stop_mask(15), "not a motor frame"),
    (wheels((0, 0.0), (1, 0.0), (2, 0.0)), "not a motor frame"),
    (seal(MOTOR, STOP[4:5] + b"\x05" + STOP[6:-1]), "not a motor frame"),
    (seal(MOTOR, b"\x00" + STOP[5:-1]), "not a motor frame"),
    (seal(framing.BUS_SERVO, STOP[4:-1]), "not a motor frame"),
    (STOP[:-1] + b"\x08", "bad crc"),
    (wheels((0, 0.0), (1, 0.0), (2, 0.0), (4, 0.0)), "wheel ids 0 1 2 4, must be 0 1 2 3"),
    (wheels((1, 0.0), (0, 0.0), (2, 0.0), (3, 0.0)), "wheel ids 1 0 2 3, must be 0 1 2 3"),
    (wheels((0, 0.0), (1, 0.0), (1, 0.0), (3, 0.0)), "wheel ids 0 1 1 3, must be 0 1 2 3"),
    (codec.motor_speeds((0.0, 0.0, 9.9, 0.0), 10.0), "wheel 2 at 9.90 rps, limit 1.40"),
    (codec.motor_speeds((-1.41, 0.0, 0.0, 0.0), 10.0), "wheel 0 at -1.41 rps, limit 1.40"),
    (wheels((0, 0.0), (1, NAN), (2, 0.0), (3, 0.0)), "wheel 1 at nan rps, limit 1.40"),
    (wheels((0, 0.0), (1, 0.0), (2, 0.0), (3, INF)), "wheel 3 at inf rps, limit 1.40"),
    (wheels((0, -INF), (1, 0.0), (2, 0.0), (3, 0.0)), "wheel 0 at -inf rps, limit 1.40"),
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


# Everything else.

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
    (b"", "not a buzzer's frame"),
    (SOUND[:4], "not a buzzer's frame"),
    (SOUND + b"\x00", "not a buzzer's frame"),
    (seal(framing.BUZZER, bytes(7)), "not a buzzer's frame"),
    (seal(framing.BUZZER, bytes(9)), "not a buzzer's frame"),
    (SOUND[:-1] + bytes((SOUND[-1] ^ 1,)), "bad crc"),
    (seal(framing.BUZZER, b"\x01\xaa\x55\x03\x00\x00\x00\x01"), "the start of a motor frame inside"),
    *(
        (frame, "not a buzzer's frame")
        for frame in (
            STOP,
            seal(MOTOR, b""),
            PING,
            seal(framing.KEY_FUNC, b"\x01\x01"),
            seal(framing.IMU_FUNC, bytes(24)),
            seal(12, b"\x01"),
            servos.bus_servo_stop([1]),
            encoders.pwm_servo_move([(1, 500), (4, 2500)], 30_000),
            encoders.pwm_servo_deviation(2, -1),
            encoders.oled(2, "x" * 23),
            encoders.rgb([(1, 255, 128, 0), (0, 1, 2, 3)]),
            encoders.led(1, 500, 300, 10),
            encoders.battery_alarm(6800),
            *(seal(func, bytes(8)) for func in range(256) if func != framing.BUZZER),
        )
    ),
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
