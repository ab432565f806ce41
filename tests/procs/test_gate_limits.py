"""Limits and ramps: what the gate makes of a velocity. Integers for a clock."""

from __future__ import annotations

from itertools import pairwise

import pytest

from tests.support.why import told

from .gate_bench import MS, ROBOT, Gate, Velocity, stands


@pytest.mark.claim("LIMIT-1")
@pytest.mark.parametrize(("axis", "limit", "step"), [(0, 0.2, 0.01), (1, 0.2, 0.01), (2, 1.0, 0.04)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_each_axis_ramps_a_tick_at_a_time_to_its_limit(
    gate: Gate, axis: int, limit: float, step: float, sign: float
) -> None:
    wanted = [0.0, 0.0, 0.0]
    wanted[axis] = sign * 1e300
    gate.enable()
    found = gate.drive((wanted[0], wanted[1], wanted[2]), 60)
    assert [v[axis] for v in found] == pytest.approx([sign * min(limit, step * (n + 1)) for n in range(60)])
    assert found[-1][axis] == sign * limit, "the limit itself, not nearly"
    assert all(v[other] == 0.0 for v in found for other in range(3) if other != axis)


@pytest.mark.parametrize(
    ("changed", "first", "last"),
    [
        ({}, (0.01, -0.01, 0.04), (0.2, -0.2, 0.3)),
        (
            {"vx_mps": 0.35, "vy_mps": 0.1, "wz_radps": 0.2, "acceleration_mps2": 1.0},
            (0.02, -0.02, 0.04),
            (0.35, -0.1, 0.2),
        ),
    ],
)
def test_axes_are_limited_each_for_itself_by_the_settings(
    changed: dict[str, object], first: Velocity, last: Velocity
) -> None:
    gate = Gate(**{f"limits__{key}": value for key, value in changed.items()})
    gate.enable()
    found = gate.drive((9.0, -9.0, 0.3), 100)
    assert found[0] == pytest.approx(first)
    assert found[-1] == last


def test_a_speed_limit_counts_at_once_by_the_ramps_and_is_lifted(gate: Gate) -> None:
    gate.enable()
    assert gate.drive((9.0, -9.0, 9.0), 60)[-1] == (0.2, -0.2, 1.0)
    assert told(gate.core.limit_to(25)) == (True, "speed limited to 25 % of the settings'")
    found = gate.drive((9.0, -9.0, 9.0), 40)
    assert found[0] == pytest.approx((0.19, -0.19, 0.96)), "no jump"
    assert found[-1] == (0.05, -0.05, 0.25)
    assert gate.drive((0.03, 0.0, 0.0), 40)[-1] == (0.03, 0.0, 0.0), "what is slower is not scaled"
    assert told(gate.core.limit_to(100)) == (True, "speed limit lifted")
    assert gate.drive((9.0, 0.0, 0.0), 60)[-1] == (0.2, 0.0, 0.0)


@pytest.mark.parametrize("percent", [0, 4, 101, 255])
def test_a_speed_limit_that_is_none_is_refused_and_changes_nothing(gate: Gate, percent: int) -> None:
    assert told(gate.core.limit_to(5)) == (True, "speed limited to 5 % of the settings'")
    assert told(gate.core.limit_to(percent)) == (False, f"a speed limit of {percent} %: must be 5 to 100")
    gate.enable()
    assert gate.drive((9.0, 0.0, 0.0), 40)[-1] == (0.01, 0.0, 0.0)


def test_slowing_down_and_turning_round_ramp_too(driving: Gate) -> None:
    assert driving.drive((0.1, 0.0, 0.0), 3)[2][0] == pytest.approx(0.17)
    found = [v[0] for v in driving.drive((-0.2, 0.0, 0.0), 40)]
    assert found[0] == pytest.approx(0.16)
    assert found[-1] == -0.2
    assert all(a - b == pytest.approx(0.01) for a, b in pairwise(found[:37]))


@pytest.mark.parametrize(
    ("passed_ms", "speed"), [(0, 0.0), (5, 0.0025), (40, 0.02), (299, 0.02)], ids=["none", "", "two periods", "late"]
)
def test_a_command_ramps_for_the_time_that_has_passed_and_two_periods_at_most(
    gate: Gate, passed_ms: int, speed: float
) -> None:
    gate.enable()
    gate.step()
    gate.take((0.2, 0.0, 0.0))
    gate.step(passed_ms * MS)
    gate.step(0)
    assert gate.core.velocity[0] == pytest.approx(speed)


def test_time_spent_disabled_is_not_saved_up(gate: Gate) -> None:
    gate.step(10_000 * MS)
    gate.enable()
    gate.take((0.2, 0.0, 0.0))
    gate.step(0)
    assert stands(gate)


def test_frames_are_the_wheels_of_the_velocity(driving: Gate) -> None:
    assert driving.take((0.0, 0.1, 0.5)) == ""
    assert driving.step() == ROBOT.wheels_rps(*driving.core.velocity)
