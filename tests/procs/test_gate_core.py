"""The gate's core. Any sequence of events keeps all of its rules (gate_machine.py); here is what that leaves open: when
frames go out, what settings change, and for which moment the gate wakes."""

from __future__ import annotations

from itertools import pairwise
from math import inf, nan

import pytest

from failstop.policy.setting import SettingError
from failstop.policy.settings import Settings
from tests.support.why import told, why

from .gate_bench import MS, NO_SPEEDS, T0, Gate, Velocity, stands
from .gate_machine import GateMachine

TIMEOUT = 300 * MS
SCAN = 500 * MS
FORWARD = (0.2, 0.0, 0.0)
REST = (0.0, 0.0, 0.0)
test_any_sequence_keeps_the_rules = pytest.mark.slow(GateMachine.TestCase)


def test_an_enable_takes_its_epoch_and_no_command_of_before(gate: Gate) -> None:
    gate.accept(FORWARD)
    assert told(gate.core.enable(1, "the port", gate.now)) == (False, "not ready: the port")
    held = (
        "motion enabled; client 1 must send zero or pause before it can drive "
        "(or end it, enable motion, and start it again)"
    )
    assert told(gate.core.enable(7, "", gate.now)) == (True, held)
    gate.drive(FORWARD, 40)
    assert stands(gate)
    assert gate.blocked == "let go first"
    gate.drive(REST, 1)
    gate.drive(FORWARD, 40)
    assert told(gate.core.enable(9, "", gate.now)) == (True, "motion enabled")
    assert (gate.core.epoch, gate.core.velocity) == (7, FORWARD)
    assert told(gate.core.disable()) == (True, "motion disabled")
    assert stands(gate)


def test_since_when_motion_is_enabled_is_published_and_0_while_it_is_not(gate: Gate) -> None:
    assert gate.core.enabled_ns == 0
    for ends in (gate.core.disable, lambda: gate.core.stop(why("key1"), 1)):
        gate.enable()
        assert gate.core.enabled_ns == gate.now
        ends()
        assert gate.core.enabled_ns == 0


def test_a_stop_is_latched_with_its_first_reason_until_it_is_answered(driving: Gate) -> None:
    core = driving.core
    core.follow(None, 1)
    assert (core.enabled, core.velocity) == (True, FORWARD), "nothing latched is no news"
    assert core.stop(why("key1"), 3)
    assert not core.stop(why("another"), 4)
    assert told(core.enable(4, "", driving.now)) == (False, "a stop is latched (key1)")
    core.follow(None, 3)
    assert driving.blocked == "estop: key1"
    core.follow(None, 4)
    assert driving.blocked == "disabled"
    core.follow(why("gate died"), 4)
    core.follow(None, 4)
    assert driving.blocked == "disabled", "the supervisor's ends by its word"
    core.stop(why("key1"), 5)
    core.follow(why("gate died"), 5)
    assert driving.blocked == "estop: gate died"


def test_a_latch_of_the_first_epoch_ends_by_the_supervisor_s_word_too(gate: Gate) -> None:
    gate.core.follow(why("key1"), 1)
    assert gate.blocked == "estop: key1"
    gate.core.follow(None, 1)
    assert gate.blocked == "disabled"


def test_a_frame_goes_out_every_refresh_and_at_once_while_blocked(driving: Gate) -> None:
    sent = []
    for tick in range(1, 41):
        driving.accept(FORWARD)
        if driving.step() is not None:
            sent.append(tick)
    assert all(b - a == 10 for a, b in pairwise(sent)), "200 ms are 10 ticks"
    assert len(sent) == 4
    for changed, ticks in (({}, 10), ({"gate__refresh_s": 0.1}, 5)):
        gate = Gate(**changed)
        gate.enable()
        frames = [gate.step() for _ in range(50)]
        assert [n for n, frame in enumerate(frames) if frame is not None] == list(range(0, 50, ticks))
        assert set(frames) == {None, NO_SPEEDS}


def test_the_gate_rests_until_the_next_frame_is_due_and_not_while_it_ramps(gate: Gate) -> None:
    assert gate.core.rests(gate.now + 3_600_000 * MS), "disabled"
    gate.enable()
    gate.drive(FORWARD, 5)
    assert not gate.core.rests(gate.now), "it ramps"
    gate.drive(FORWARD, 35)
    gate.accept(FORWARD)
    assert gate.step(200 * MS) is not None
    assert [gate.core.rests(gate.now + 200 * MS + late_ns) for late_ns in (0, 1)] == [True, False]


# Limits and ramps.


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


def test_a_step_that_comes_late_ramps_for_two_periods_at_most(gate: Gate) -> None:
    gate.enable()
    for elapsed_ns, vx in ((30 * MS, 0.015), (40 * MS, 0.035), (290 * MS, 0.055)):
        assert gate.accept(FORWARD) == ""
        assert gate.tick(elapsed_ns) == pytest.approx(vx)


SMALLER = {"vx_mps": 0.35, "vy_mps": 0.1, "wz_radps": 0.2, "acceleration_mps2": 1.0}


@pytest.mark.parametrize(
    ("changed", "first", "last"),
    [({}, (0.01, -0.01, 0.04), (0.2, -0.2, 0.3)), (SMALLER, (0.02, -0.02, 0.04), (0.35, -0.1, 0.2))],
)
def test_the_settings_limit_each_axis_for_itself(changed: dict[str, float], first: Velocity, last: Velocity) -> None:
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
    assert told(gate.core.limit_to(5))[0]
    for percent in (0, 4, 101, 255):
        assert told(gate.core.limit_to(percent)) == (False, f"a speed limit of {percent} %: must be 5 to 100")
    assert gate.drive((9.0, 0.0, 0.0), 40)[-1] == (0.01, 0.0, 0.0), "what is refused changes nothing"
    assert told(gate.core.limit_to(100)) == (True, "speed limit lifted")
    assert gate.drive((9.0, 0.0, 0.0), 60)[-1] == (0.2, 0.0, 0.0)


# The deadman.


@pytest.mark.parametrize(("age_ns", "left_ns"), [(0, TIMEOUT), (200 * MS, 100 * MS), (-3_600_000 * MS, TIMEOUT)])
@pytest.mark.parametrize("manual", [False, True])
def test_the_deadman_counts_to_the_nanosecond_from_a_command_s_time_or_from_now(
    driving: Gate, age_ns: int, left_ns: int, manual: bool
) -> None:
    assert driving.accept(FORWARD, age_ns=age_ns, manual=manual) == ""
    assert driving.core.blocked(driving.now + left_ns) == ""
    assert driving.core.blocked(driving.now + left_ns + 1) == "cmd timeout"


@pytest.mark.claim("CLIENT-1")
@pytest.mark.parametrize("value", [0, -1, 0.049, 2.01, inf, nan, "off", "", False, None])
def test_the_deadman_cannot_be_switched_off(value: object) -> None:
    """No value means never: from 0.05 to 2 s are allowed, and of each source's own timeout too."""
    for key in ("gate.command_timeout_s", "sources.cmd_vel.timeout_s", "sources.teleop.timeout_s"):
        with pytest.raises(SettingError, match=f"^{key} = .*0.05 to 2 s"):
            Settings({key: value})


def test_the_gate_wakes_for_a_command_s_end_and_only_while_something_drives() -> None:
    for changed, timeout in (({}, TIMEOUT), ({"gate__command_timeout_s": 0.5}, 500 * MS)):
        gate = Gate(**changed)
        assert gate.command(0.0) == ""
        assert gate.core.due_ns(gate.now) is None, "disabled"
        gate.gone(parted=True)
        gate.enable()
        assert gate.core.due_ns(gate.now) is None, "no command"
        assert gate.command(0.1) == ""
        assert gate.step() is not None
        assert gate.core.due_ns(gate.now) == T0 + timeout + 1
        assert gate.step(timeout + 1 - 20 * MS) == NO_SPEEDS, "in that very step"
        assert gate.blocked == "cmd timeout"
        assert gate.core.due_ns(gate.now) is None, "or the loop would spin"


@pytest.mark.parametrize("manual", [False, True])
def test_the_gate_wakes_for_the_sensor_where_that_comes_first_and_counts(manual: bool) -> None:
    gate = Gate(scan__gate="on")
    gate.enable()
    gate.core.scan.deliver(T0 - SCAN + 100 * MS, T0)
    assert gate.command(0.1, manual=manual) == ""
    assert gate.core.due_ns(gate.now) == T0 + (TIMEOUT if manual else 100 * MS) + 1
    gate.now += 100 * MS
    assert gate.blocked == ""
    gate.now += 1
    assert gate.blocked == ("" if manual else "no scan")
    assert (gate.core.due_ns(gate.now) is None) is not manual
