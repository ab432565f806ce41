"""Kinematics: the published numbers, the published formulas, and zeros that are the stop frame to the byte."""

from __future__ import annotations

from itertools import product
from math import copysign, pi

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.board import codec
from failstop.procs.gate.kinematics import Mecanum

DIAMETER_M, WHEELBASE_M, TRACK_M = 0.08, 0.17706, 0.17165
ROBOT = Mecanum(DIAMETER_M, WHEELBASE_M, TRACK_M)
speed = st.floats(-10, 10)


@pytest.mark.parametrize(
    ("velocity", "printed"),
    [
        ((0.2, 0.0, 0.0), ["0.796", "0.796", "-0.796", "-0.796"]),
        ((-0.2, 0.0, 0.0), ["-0.796", "-0.796", "0.796", "0.796"]),
        ((0.0, 0.2, 0.0), ["-0.796", "0.796", "-0.796", "0.796"]),
        ((0.0, 0.0, 1.0), ["-0.694", "-0.694", "-0.694", "-0.694"]),
        ((0.0, 0.0, -1.0), ["0.694", "0.694", "0.694", "0.694"]),
    ],
)
def test_published_numbers(velocity: tuple[float, float, float], printed: list[str]) -> None:
    assert [f"{rps:.3f}" for rps in ROBOT.wheels_rps(*velocity)] == printed


@given(speed, speed, speed)
def test_published_formulas(vx: float, vy: float, wz: float) -> None:
    k = (WHEELBASE_M + TRACK_M) / 2
    rim_mps = (vx - vy - wz * k, vx + vy - wz * k, -(vx + vy + wz * k), -(vx - vy + wz * k))
    expected = [mps / (pi * DIAMETER_M) for mps in rim_mps]
    assert ROBOT.wheels_rps(vx, vy, wz) == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_geometry_counts() -> None:
    twice = Mecanum(2 * DIAMETER_M, 2 * WHEELBASE_M, 2 * TRACK_M)
    assert twice.wheels_rps(0.2, 0.0, 0.0)[0] == pytest.approx(ROBOT.wheels_rps(0.1, 0.0, 0.0)[0])
    assert twice.wheels_rps(0.0, 0.0, 1.0)[0] == pytest.approx(ROBOT.wheels_rps(0.0, 0.0, 1.0)[0])


def test_rest_is_plus_zero_and_the_stop_frame() -> None:
    speeds = ROBOT.wheels_rps(0.0, 0.0, 0.0)
    assert [copysign(1.0, rps) for rps in speeds] == [1.0] * 4
    assert codec.motor_speeds(speeds, 0.0) == codec.STOP


@pytest.mark.parametrize("velocity", list(product((0.0, -0.0), repeat=3)))
def test_zero_of_either_sign_is_the_stop_frame(velocity: tuple[float, float, float]) -> None:
    assert codec.motor_speeds(ROBOT.wheels_rps(*velocity), 0.0) == codec.STOP


@given(speed, speed)
def test_cancelling_speeds_leave_a_wheel_at_the_bytes_of_zero(vx: float, wz: float) -> None:
    frame = codec.motor_speeds(ROBOT.wheels_rps(vx, vx, 0.0), 1000.0)
    assert frame[7:11] == bytes(4), "wire id 0 stands when forward and left cancel"
    assert codec.check_motion(codec.motor_speeds(ROBOT.wheels_rps(vx, -vx, wz), 1000.0), 1000.0) == ""
