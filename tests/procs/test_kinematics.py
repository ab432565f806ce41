"""Kinematics: the published numbers, the published formulas, and zeros that are the stop frame to the byte."""

from __future__ import annotations

from itertools import permutations, product
from math import copysign, pi

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.board import codec
from failstop.policy import kinematics
from failstop.policy.kinematics import Chassis, differential, mecanum
from failstop.policy.settings import Settings

DIAMETER_M, WHEELBASE_M, TRACK_M = 0.08, 0.17706, 0.17165
ROBOT = mecanum(DIAMETER_M, WHEELBASE_M, TRACK_M)
TWO_SIDED = differential(DIAMETER_M, TRACK_M)
speed = st.floats(-10, 10)


@pytest.mark.parametrize(
    ("robot", "velocity", "printed"),
    [
        (ROBOT, (0.2, 0.0, 0.0), ["0.796", "0.796", "-0.796", "-0.796"]),
        (ROBOT, (-0.2, 0.0, 0.0), ["-0.796", "-0.796", "0.796", "0.796"]),
        (ROBOT, (0.0, 0.2, 0.0), ["-0.796", "0.796", "-0.796", "0.796"]),
        (ROBOT, (0.0, 0.0, 1.0), ["-0.694", "-0.694", "-0.694", "-0.694"]),
        (ROBOT, (0.0, 0.0, -1.0), ["0.694", "0.694", "0.694", "0.694"]),
        (TWO_SIDED, (0.2, 0.0, 0.0), ["0.796", "0.796", "-0.796", "-0.796"]),
        (TWO_SIDED, (0.0, 0.0, 1.0), ["-0.341", "-0.341", "-0.341", "-0.341"]),
    ],
)
def test_published_numbers(robot: Chassis, velocity: tuple[float, float, float], printed: list[str]) -> None:
    assert [f"{rps:.3f}" for rps in robot.wheels_rps(*velocity)] == printed


@given(speed, speed, speed)
def test_published_formulas(vx: float, vy: float, wz: float) -> None:
    k = (WHEELBASE_M + TRACK_M) / 2
    rim_mps = (vx - vy - wz * k, vx + vy - wz * k, -(vx + vy + wz * k), -(vx - vy + wz * k))
    expected = [mps / (pi * DIAMETER_M) for mps in rim_mps]
    assert ROBOT.wheels_rps(vx, vy, wz) == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_geometry_counts() -> None:
    twice = mecanum(2 * DIAMETER_M, 2 * WHEELBASE_M, 2 * TRACK_M)
    assert twice.wheels_rps(0.2, 0.0, 0.0)[0] == pytest.approx(ROBOT.wheels_rps(0.1, 0.0, 0.0)[0])
    assert twice.wheels_rps(0.0, 0.0, 1.0)[0] == pytest.approx(ROBOT.wheels_rps(0.0, 0.0, 1.0)[0])


@given(speed, speed)
def test_cancelling_speeds_leave_a_wheel_at_the_bytes_of_zero(vx: float, wz: float) -> None:
    frame = codec.motor_speeds(ROBOT.wheels_rps(vx, vx, 0.0), 1000.0)
    assert frame[7:11] == bytes(4), "wire id 0 stands when forward and left cancel"
    assert codec.check_motion(codec.motor_speeds(ROBOT.wheels_rps(vx, -vx, wz), 1000.0), 1000.0) == ""


# Chosen by name.


def test_the_default_is_the_mecanum_robot() -> None:
    chosen = kinematics.from_settings(Settings())
    assert chosen.axes == (1.0, 1.0, 1.0)
    for velocity in product((0.2, 0.0, -0.1), repeat=3):
        assert chosen.wheels_rps(*velocity) == ROBOT.wheels_rps(*velocity)


def test_differential_by_name() -> None:
    settings = Settings({"wheels.layout": "differential", "wheels.diameter_m": 0.1, "wheels.track_m": 0.4})
    chosen = kinematics.from_settings(settings)
    assert chosen.axes == (1.0, 0.0, 1.0)
    right_rps = -0.4 / (pi * 0.1)
    assert chosen.wheels_rps(0.2, 0.0, 1.0) == pytest.approx((0.0, 0.0, right_rps, right_rps)), "about its left wheels"


def test_a_layout_without_kinematics_is_refused_by_name() -> None:
    class Tracks(Settings):
        def text(self, key: str) -> str:
            return "tracks"

    with pytest.raises(ValueError, match=r"wheels\.layout = 'tracks'"):
        kinematics.from_settings(Tracks())


@given(speed, speed)
def test_differential_formulas(vx: float, wz: float) -> None:
    left, right = (vx - wz * TRACK_M / 2) / (pi * DIAMETER_M), (vx + wz * TRACK_M / 2) / (pi * DIAMETER_M)
    assert TWO_SIDED.wheels_rps(vx, 0.0, wz) == pytest.approx((left, left, -right, -right), rel=1e-12, abs=1e-12)


def test_no_fixed_wheel_goes_sideways() -> None:
    assert TWO_SIDED.axes == (1.0, 0.0, 1.0)
    assert TWO_SIDED.wheels_rps(0.1, 5.0, 0.3) == TWO_SIDED.wheels_rps(0.1, 0.0, 0.3)
    assert TWO_SIDED.worst_rps(0.2, 3.0, 1.0) == TWO_SIDED.worst_rps(0.2, 0.0, 1.0)


def test_zero_is_the_stop_frame_in_every_mounting() -> None:
    """Zeros of either sign."""
    robots = [ROBOT, TWO_SIDED]
    for signs in product((1, -1), repeat=4):
        robots += [mecanum(0.08, 0.2, 0.2, signs, (3, 1, 0, 2)), differential(0.08, 0.2, signs, (3, 1, 0, 2))]
    for robot, velocity in product(robots, product((0.0, -0.0), repeat=3)):
        speeds = robot.wheels_rps(*velocity)
        assert [copysign(1.0, rps) for rps in speeds] == [1.0] * 4
        assert codec.motor_speeds(speeds, 0.0) == codec.STOP


@pytest.mark.parametrize("wheel", [1, 2, 3, 4])
@pytest.mark.parametrize("layout", ["mecanum", "differential"])
def test_a_sign_turns_one_wheel(layout: str, wheel: int) -> None:
    before = Settings({"wheels.layout": layout})
    after = Settings({"wheels.layout": layout, f"wheels.sign_{wheel}": -int(before[f"wheels.sign_{wheel}"])})
    was, now = (kinematics.from_settings(settings).wheels_rps(0.2, 0.0, 0.5) for settings in (before, after))
    for index, (old, new) in enumerate(zip(was, now, strict=True)):
        assert new == (-old if index == wheel - 1 else old) != 0.0


@pytest.mark.parametrize("layout", ["mecanum", "differential"])
def test_each_wheel_goes_to_its_wire_id(layout: str) -> None:
    by_wheel = kinematics.from_settings(Settings({"wheels.layout": layout})).wheels_rps(0.2, 0.0, 0.5)
    for ids in permutations(range(4)):
        changed = {f"wheels.id_{wheel}": wire_id for wheel, wire_id in enumerate(ids, 1)}
        by_id = kinematics.from_settings(Settings({"wheels.layout": layout, **changed})).wheels_rps(0.2, 0.0, 0.5)
        assert [by_id[wire_id] for wire_id in ids] == list(by_wheel)
