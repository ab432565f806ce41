"""A joint of the arm: its angles, and its steps toward a goal, none of them faster than it may be."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from math import pi

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from failstop.policy.joints import MOST_MISSES, PULSES_PER_RAD, Joint, from_settings, too_far
from failstop.policy.settings import Settings
from failstop.procs.gate.arm.goals import MOVE, Trajectory, too_fast, too_fast_between

T0 = 100_000_000_000
STEP_S = 0.04
MARGIN = 1e-6


def joint(position: float = 500.0, **changed: object) -> Joint:
    table = {f"joints.elbow.{key}": value for key, value in {"servo": 7, **changed}.items()}
    found = from_settings(Settings(table))[0]
    found.position, found.known = position, True
    return found


def went(it: Joint, step: Callable[[Joint], None], steps: int) -> list[float]:
    """Its positions, from where it stands on."""
    found = [it.position]
    for _ in range(steps):
        step(it)
        found.append(it.position)
    return found


def speeds(positions: list[float]) -> list[float]:
    return [(after - before) / STEP_S for before, after in pairwise(positions)]


def assert_within(it: Joint, positions: list[float], most: float) -> None:
    """No speed beyond `most`, and no change of it beyond its ramp, but for what the last step cuts off."""
    found = [0.0, *speeds(positions)]
    assert max(map(abs, found)) <= most + MARGIN
    assert max(abs(after - before) for before, after in pairwise(found)) <= 1.15 * it.acceleration * STEP_S


def test_angle_is_counted_from_the_zero_in_the_direction_of_the_sign() -> None:
    it = joint(zero=400, sign=-1, low=100, high=900)
    assert it.pulses(pi / 2) == pytest.approx(400 - 375)
    assert it.rad(25.0) == pytest.approx(pi / 2)
    assert it.range_rad() == pytest.approx((-500 / PULSES_PER_RAD, 300 / PULSES_PER_RAD))
    assert joint().pulses(pi / 2) == pytest.approx(875)
    assert joint().rad(875) == pytest.approx(pi / 2)


def test_base_is_judged_for_driving_by_its_own_setting() -> None:
    names = ("base", "elbow")
    table: dict[str, object] = {f"joints.{name}.servo": number for number, name in enumerate(names, 3)}
    table |= {f"joints.{name}.drive": 450 for name in names} | {"arm.base_servo": 3}
    for pan, drive, judged in ((-1, -1, False), (0, 0, True), (700, 700, True)):
        base, elbow = from_settings(Settings({**table, "arm.drive_pan": pan}))
        assert (base.drive, base.judged) == (drive, judged)
        assert (elbow.drive, elbow.judged) == (450, True)
    assert not from_settings(Settings({**table, "joints.elbow.judged": "off"}))[1].judged


def test_joint_is_told_where_it_is_while_that_is_known() -> None:
    it = joint(500.126)
    it.measured, it.measured_ns, it.loaded, it.temperature_c, it.supply_mv = 501, 17, True, 35, 7400
    assert it.state() == ("elbow", 7, 500.13, 501, 17, True, 35, 7400)
    it.velocity, it.unpaired = 3.0, 500
    it.forget()
    assert it.state()[2] is None
    assert (it.velocity, it.unpaired) == (0.0, None)
    assert not it.silent
    it.misses = MOST_MISSES
    assert it.silent


@given(begin=st.floats(100, 900), target=st.floats(100, 900), share=st.floats(0.1, 1.0))
@example(begin=100.0, target=900.0, share=1.0)
@example(begin=500.0, target=500.0, share=1.0)
def test_follow_gets_there_by_its_ramps_and_stays(begin: float, target: float, share: float) -> None:
    it = joint(begin, low=100, high=900)
    most = it.speed * share
    ramp_s = most / it.acceleration
    steps = round((abs(target - begin) / most + ramp_s) / STEP_S) + 10
    positions = went(it, lambda it: it.follow(target, share, STEP_S), steps)
    assert_within(it, positions, most)
    assert it.position == pytest.approx(target, abs=0.01)
    assert all(min(begin, target) - 0.5 < position < max(begin, target) + 0.5 for position in positions)


@given(begin=st.floats(100, 900), rate=st.floats(-400, 400))
@example(begin=100.0, rate=400.0)
@example(begin=900.0, rate=-400.0)
@example(begin=500.0, rate=0.5)
@example(begin=500.0, rate=-0.5)
@example(begin=500.0, rate=0.0)
def test_jog_keeps_its_rate_and_ends_at_the_bound(begin: float, rate: float) -> None:
    it = joint(begin, low=100, high=900, acceleration_radps2=2.0)
    positions = went(it, lambda it: it.jog(rate, STEP_S), 400)
    most = min(abs(rate), it.speed)
    assert_within(it, positions, most)
    assert all(100 <= position <= 900 for position in positions)
    ramp = it.acceleration * STEP_S
    stands = 900 if rate > 0 else 100
    for number, (position, speed) in enumerate(zip(positions, speeds(positions), strict=False), 1):
        room = abs(stands - position)
        if room > most * most / it.acceleration + 3 * most * STEP_S:
            assert abs(speed) == pytest.approx(min(most, number * ramp), abs=1e-6), "as fast as it may"
    if most > 300:
        assert it.position == pytest.approx(stands, abs=0.01)
        assert it.velocity == pytest.approx(0.0, abs=0.5)


@given(
    outside=st.sampled_from((0.0, 20.0, 99.0, 901.0, 950.0, 1000.0)),
    rate=st.sampled_from((-200.0, -1.0, 0.0, 1.0, 200.0)),
)
def test_joint_beyond_its_bounds_returns_no_faster_than_it_may(outside: float, rate: float) -> None:
    """Turned there by hand. It is sent no further out, and in without a leap."""
    inward = (rate > 0) == (outside < 500) and bool(rate)
    it = joint(outside, low=100, high=900)
    positions = went(it, lambda it: it.jog(rate, STEP_S), 200)
    assert_within(it, positions, abs(rate))
    assert (it.position != outside) == inward
    it = joint(outside, low=100, high=900)
    positions = went(it, lambda it: it.follow(500.0, 1.0, STEP_S), 200)
    assert_within(it, positions, it.speed)
    assert it.position == pytest.approx(500.0, abs=0.01)


def test_goal_at_a_bound_is_allowed_and_none_beyond() -> None:
    it = joint(low=100, high=900, speed_radps=2.0)
    low, high = it.range_rad()
    for angle in (low, high, low - 9e-7, high + 9e-7):
        assert too_far({it: angle}) == ""
    for angle in (low - 2e-6, high + 2e-6, float("nan")):
        assert too_far({it: angle}) == f"joint elbow to {angle:g} rad: allowed is {low:.3f} to {high:.3f}"
    for rate in (2.0, -2.0, 0.0):
        assert too_fast({it: rate}) == ""
    for rate in (2.0001, -2.0001, float("-inf")):
        assert too_fast({it: rate}) == f"joint elbow at {rate:g} rad/s: allowed is up to 2"


def test_rows_of_a_trajectory_go_up_in_time_and_no_faster_than_each_joint_may() -> None:
    it = joint(speed_radps=2.0)
    rad = PULSES_PER_RAD
    assert too_fast_between([(0.0, {it: 0.0}), (1.0, {it: 2.0 * rad}), (3.0, {it: -2.0 * rad})]) == ""
    assert too_fast_between([(0.0, {it: 0.0}), (1.0, {it: 0.0}), (2.0, {it: 2.1 * rad})]) == (
        "joint elbow at 2.100 rad/s between 1 and 2 s: allowed is up to 2"
    )
    assert "at 2.100 rad/s between 1 and 3 s" in too_fast_between([(1.0, {it: 4.2 * rad}), (3.0, {it: 0.0})])
    for times in ((1.0, 1.0), (2.0, 1.0)):
        rows = [(t_s, {it: 0.0}) for t_s in times]
        assert too_fast_between(rows) == "the times do not go up: {:g} s, then {:g} s".format(*times)


def test_journey_goes_straight_from_row_to_row_from_where_it_begins() -> None:
    it = joint(120.0)
    way = Trajectory(MOVE, 1, "me", [it], [(1.0, {it: 220.0}), (3.0, {it: 100.0})])
    assert way.left_s(T0) == 0.0
    assert way.begin(T0) == ""
    for t_s, there in (
        (0.0, 120.0),
        (0.25, 145.0),
        (1.0, 220.0),
        (1.5, 190.0),
        (2.9, 106.0),
        (3.0, 100.0),
        (9.0, 100.0),
    ):
        assert way.targets(T0 + round(t_s * 1e9))[it] == pytest.approx(there)
        assert way.left_s(T0 + round(t_s * 1e9)) == pytest.approx(max(0.0, 3.0 - t_s))


@pytest.mark.parametrize(("share", "end", "takes_s"), [(1.0, 500.0, 1.0), (0.5, 500.0, 2.0), (1.0, 251.0, 0.1)])
def test_journey_without_a_time_takes_what_its_slowest_joint_needs(share: float, end: float, takes_s: float) -> None:
    joints = from_settings(Settings({"joints.a.servo": 1, "joints.b.servo": 2, "joints.a.speed_radps": 2.0}))
    slow_pulses = joints[1].speed * (end - 250.0) / 250.0
    way = Trajectory(MOVE, 1, "me", joints, [(0.0, {joints[0]: 10.0, joints[1]: slow_pulses})], share)
    assert way.begin(T0) == ""
    assert way.length_s == pytest.approx(takes_s)
