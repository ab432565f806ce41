"""The gate's rules, one by one, with integers for a clock. gate_machine.py has them as invariants of any sequence."""

from __future__ import annotations

from itertools import pairwise
from math import inf, nan

import pytest

from failstop.procs.gate.core import REST, STILL, GateCore
from failstop.procs.gate.kinematics import Mecanum
from failstop.procs.gate.sources import Command
from failstop.supervisor.settings import Settings

from .gate_machine import GateMachine

MS = 1_000_000
TICK = 20 * MS
T0 = 100_000 * MS
ROBOT = Mecanum(0.08, 0.17706, 0.17165)
Velocity = tuple[float, float, float]


class Gate:
    """A gate and its clock; without the scan gate, which has its own tests."""

    def __init__(self, **changed: float) -> None:
        values: dict[str, object] = {key.replace("__", "."): value for key, value in changed.items()}
        self.core = GateCore(Settings({"scan.gate": "off", **values}), ROBOT, T0)
        self.now = T0

    def step(self, elapsed_ns: int = TICK) -> tuple[float, ...] | None:
        self.now += elapsed_ns
        return self.core.step(self.now)

    def take(self, velocity: Velocity, session: int = 1, age_ns: int = 0) -> str:
        return self.core.take(Command(session, f"client {session}", self.now - age_ns, velocity), self.now)

    def drive(self, velocity: Velocity, ticks: int) -> list[Velocity]:
        """A fresh command at every tick; returns the velocity after each."""
        found = []
        for _ in range(ticks):
            assert self.take(velocity) == ""
            self.step()
            found.append(self.core.velocity)
        return found

    def enable(self, epoch: int = 1) -> None:
        assert self.core.enable(epoch, "", self.now) == (True, "motion enabled")

    @property
    def blocked(self) -> str:
        return self.core.blocked(self.now)


@pytest.fixture
def gate() -> Gate:
    return Gate()


@pytest.fixture
def driving(gate: Gate) -> Gate:
    """Enabled, at full speed forward, a fresh command."""
    gate.enable()
    gate.drive((0.2, 0.0, 0.0), 40)
    assert gate.core.velocity == (0.2, 0.0, 0.0)
    return gate


def stands(gate: Gate) -> bool:
    return gate.core.velocity == REST and gate.core.speeds == STILL


test_any_sequence_keeps_the_rules = GateMachine.TestCase


# Rule 3: disabled at start, until an explicit enable.


def test_disabled_at_start(gate: Gate) -> None:
    assert gate.blocked == "disabled"
    assert gate.core.latch is None


def test_commands_move_nothing_while_disabled(gate: Gate) -> None:
    for _ in range(20):
        assert gate.take((0.2, 0.0, 0.0)) == ""
        assert gate.step() is None
    assert stands(gate)


def test_enable_takes_the_epoch(gate: Gate) -> None:
    gate.enable(epoch=7)
    assert gate.core.enabled
    assert gate.core.epoch == 7


def test_enable_is_refused_while_something_is_missing(gate: Gate) -> None:
    assert gate.core.enable(1, "the port", gate.now) == (False, "not ready: the port")
    assert gate.blocked == "disabled"


def test_enable_while_enabled_changes_nothing(driving: Gate) -> None:
    assert driving.core.enable(9, "", driving.now) == (True, "motion enabled")
    assert driving.core.epoch == 1
    assert driving.core.velocity == (0.2, 0.0, 0.0)


def test_a_command_from_before_the_enable_does_not_move(gate: Gate) -> None:
    gate.take((0.2, 0.0, 0.0))
    gate.enable()
    assert gate.blocked == "cmd timeout"
    gate.step()
    assert stands(gate)


def test_disable_stands_at_once(driving: Gate) -> None:
    assert driving.core.disable() == (True, "motion disabled")
    assert driving.blocked == "disabled"
    assert stands(driving)
    assert driving.step() is None


# Rule 4: the deadman.


def test_no_command_yet_is_a_timeout(gate: Gate) -> None:
    gate.enable()
    assert gate.blocked == "cmd timeout"


def test_the_deadman_is_exact(driving: Gate) -> None:
    assert driving.take((0.2, 0.0, 0.0)) == ""
    assert driving.core.blocked(driving.now + 300 * MS) == ""
    assert driving.core.blocked(driving.now + 300 * MS + 1) == "cmd timeout"


def test_the_deadman_is_zero_at_once_and_sent_at_once(driving: Gate) -> None:
    driving.take((0.2, 0.0, 0.0))
    assert driving.step(300 * MS) is not None
    assert driving.core.velocity == (0.2, 0.0, 0.0)
    assert driving.step(1) == STILL
    assert stands(driving)


def test_the_deadman_counts_from_the_command_s_own_time(driving: Gate) -> None:
    assert driving.take((0.2, 0.0, 0.0), age_ns=200 * MS) == ""
    assert driving.core.blocked(driving.now + 100 * MS) == ""
    assert driving.core.blocked(driving.now + 100 * MS + 1) == "cmd timeout"


def test_an_old_command_moves_nothing(gate: Gate) -> None:
    gate.enable()
    assert gate.take((0.2, 0.0, 0.0), age_ns=301 * MS) == ""
    gate.step()
    assert gate.blocked == "cmd timeout"
    assert stands(gate)


def test_a_stamp_from_the_future_counts_as_now(driving: Gate) -> None:
    assert driving.take((0.2, 0.0, 0.0), age_ns=-3_600_000 * MS) == ""
    assert driving.core.blocked(driving.now + 300 * MS + 1) == "cmd timeout"


def test_the_deadman_s_time_is_the_setting_s() -> None:
    gate = Gate(gate__command_timeout_s=0.5)
    gate.enable()
    gate.take((0.2, 0.0, 0.0))
    assert gate.core.blocked(gate.now + 500 * MS) == ""
    assert gate.core.blocked(gate.now + 500 * MS + 1) == "cmd timeout"


def test_after_the_deadman_the_ramp_starts_from_zero(driving: Gate) -> None:
    driving.step(301 * MS)
    assert stands(driving)
    assert driving.drive((0.2, 0.0, 0.0), 1)[0][0] == pytest.approx(0.01)


# Rule 5: limits and ramps.


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


def test_axes_are_limited_each_for_itself(gate: Gate) -> None:
    gate.enable()
    assert gate.drive((9.0, -9.0, 0.3), 60)[-1] == (0.2, -0.2, 0.3)


def test_limits_and_ramps_are_the_settings() -> None:
    gate = Gate(limits__vx_mps=0.35, limits__vy_mps=0.1, limits__wz_radps=2.0, limits__acceleration_mps2=1.0)
    gate.enable()
    assert gate.drive((9.0, 9.0, 9.0), 1)[0] == pytest.approx((0.02, 0.02, 0.04))
    assert gate.drive((9.0, 9.0, 9.0), 100)[-1] == (0.35, 0.1, 2.0)


def test_slowing_down_and_turning_round_ramp_too(driving: Gate) -> None:
    assert driving.drive((0.1, 0.0, 0.0), 3)[2][0] == pytest.approx(0.17)
    found = [v[0] for v in driving.drive((-0.2, 0.0, 0.0), 40)]
    assert found[0] == pytest.approx(0.16)
    assert found[-1] == -0.2
    assert all(a - b == pytest.approx(0.01) for a, b in pairwise(found[:37]))


def test_a_command_counts_at_once_for_the_time_that_has_passed(gate: Gate) -> None:
    gate.enable()
    gate.step()
    gate.take((0.2, 0.0, 0.0))
    gate.step(5 * MS)
    assert gate.core.velocity[0] == pytest.approx(0.0025)
    gate.step(0)
    assert gate.core.velocity[0] == pytest.approx(0.0025), "no time, no change"


@pytest.mark.parametrize("late_ms", [40, 100, 299])
def test_a_late_tick_makes_no_jump(gate: Gate, late_ms: int) -> None:
    gate.enable()
    gate.step()
    gate.take((0.2, 0.0, 0.0))
    gate.step(late_ms * MS)
    assert gate.core.velocity[0] == pytest.approx(0.02), "two periods' worth and no more"


def test_time_spent_disabled_is_not_saved_up(gate: Gate) -> None:
    gate.step(10_000 * MS)
    gate.enable()
    gate.take((0.2, 0.0, 0.0))
    gate.step(0)
    assert stands(gate)


def test_frames_are_the_wheels_of_the_velocity(driving: Gate) -> None:
    assert driving.take((0.0, 0.1, 0.5)) == ""
    assert driving.step() == ROBOT.wheels_rps(*driving.core.velocity)


# Rule 2 and commands that are no commands.


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("value", [nan, inf, -inf])
def test_a_value_that_is_not_finite_is_a_reason_to_trip(driving: Gate, axis: int, value: float) -> None:
    wanted = [0.1, 0.1, 0.1]
    wanted[axis] = value
    before = driving.core.sources.driving(driving.now)
    assert driving.take((wanted[0], wanted[1], wanted[2])) == "command from client 1 is not finite"
    assert driving.core.sources.driving(driving.now) is before


def test_a_second_publisher_is_a_reason_with_both_names(driving: Gate) -> None:
    assert driving.take((0.1, 0.0, 0.0), session=2) == "multiple cmd_vel publishers: client 1, client 2"


def test_a_second_publisher_counts_while_disabled_too(gate: Gate) -> None:
    gate.take(REST)
    assert gate.take(REST, session=2) == "multiple cmd_vel publishers: client 1, client 2"


def test_another_may_take_over_once_the_last_command_no_longer_counts(driving: Gate) -> None:
    driving.take(REST)
    driving.step(300 * MS)
    assert driving.take(REST, session=2).startswith("multiple")
    driving.step(1)
    assert driving.take((0.1, 0.0, 0.0), session=2) == ""


def test_the_driver_s_end_stands_at_once(driving: Gate) -> None:
    assert not driving.core.driver_gone(2), "a client that does not drive"
    assert driving.core.driver_gone(1)
    assert driving.step(0) == STILL
    assert driving.blocked == "cmd timeout"
    assert driving.core.latch is None
    assert not driving.core.driver_gone(1)


def test_another_may_drive_at_once_when_the_driver_has_gone(driving: Gate) -> None:
    driving.core.driver_gone(1)
    driving.step(0)
    assert driving.take((0.2, 0.0, 0.0), session=2) == ""
    driving.step()
    assert driving.core.velocity[0] == pytest.approx(0.01), "from zero, along the ramp"


# Rule 6: the latch.


def test_a_trip_stands_disables_and_latches_at_once(driving: Gate) -> None:
    assert driving.core.trip("key1", 3)
    assert stands(driving)
    assert not driving.core.enabled
    assert driving.blocked == "estop: key1"
    assert driving.core.latched_in == 3
    assert driving.step() is None


def test_the_first_reason_is_kept(driving: Gate) -> None:
    driving.core.trip("key1", 3)
    assert not driving.core.trip("gamepad button 0x0100", 4)
    assert driving.core.latch == "key1"
    assert driving.core.latched_in == 3


def test_a_reason_without_words_latches_too(driving: Gate) -> None:
    assert driving.core.trip("", 1)
    assert driving.blocked == "estop: "
    assert driving.core.enable(2, "", driving.now) == (False, "e-stop latched ()")


def test_the_latch_is_told_before_everything_else(gate: Gate) -> None:
    gate.core.trip("key1", 1)
    assert gate.blocked == "estop: key1"
    gate.core.reset(2)
    assert gate.blocked == "disabled"
    gate.enable()
    assert gate.blocked == "cmd timeout"
    gate.take(REST)
    assert gate.blocked == ""


def test_enable_is_refused_while_latched(driving: Gate) -> None:
    driving.core.trip("key1", 3)
    assert driving.core.enable(4, "", driving.now) == (False, "e-stop latched (key1)")
    assert not driving.core.enabled


def test_nothing_but_a_reset_ends_a_latch(driving: Gate) -> None:
    driving.core.trip("key1", 3)
    driving.core.disable()
    driving.core.driver_gone(1)
    driving.core.enable(4, "", driving.now)
    driving.take((0.2, 0.0, 0.0))
    for _ in range(100):
        driving.step()
    assert driving.blocked == "estop: key1"


def test_a_reset_clears_the_latch_and_nothing_else(driving: Gate) -> None:
    driving.core.trip("key1", 3)
    assert driving.core.reset(4) == (True, "e-stop cleared (was: key1); motion still disabled")
    assert driving.core.latch is None
    assert driving.blocked == "disabled"
    driving.take((0.2, 0.0, 0.0))
    assert driving.step() is None
    assert stands(driving)


def test_a_reset_waits_until_the_stop_is_carried_out(driving: Gate) -> None:
    driving.core.trip("key1", 3)
    assert driving.core.reset(3) == (False, "the stop is still being carried out (key1)")
    assert driving.blocked == "estop: key1"
    assert driving.core.reset(4)[0]


def test_a_reset_without_a_latch_changes_nothing(driving: Gate) -> None:
    assert driving.core.reset(1) == (True, "no e-stop is latched")
    assert driving.core.enabled
    assert driving.core.velocity == (0.2, 0.0, 0.0)


def test_after_reset_and_enable_the_ramp_starts_from_zero(driving: Gate) -> None:
    driving.core.trip("key1", 3)
    driving.core.reset(4)
    driving.enable(4)
    assert driving.core.epoch == 4
    assert driving.drive((0.2, 0.0, 0.0), 1)[0][0] == pytest.approx(0.01)


# Output.


def test_the_first_frame_after_enable_is_zero_and_at_once(gate: Gate) -> None:
    gate.enable()
    assert gate.step() == STILL


def test_a_frame_every_refresh_while_nothing_changes(driving: Gate) -> None:
    sent = []
    for tick in range(1, 41):
        driving.take((0.2, 0.0, 0.0))
        if driving.step() is not None:
            sent.append(tick)
    assert all(b - a == 10 for a, b in pairwise(sent)), "200 ms are 10 ticks"
    assert len(sent) == 4


def test_zero_frames_too_are_refreshed_while_blocked(gate: Gate) -> None:
    gate.enable()
    frames = [gate.step() for _ in range(50)]
    assert [n for n, frame in enumerate(frames) if frame is not None] == [0, 10, 20, 30, 40]
    assert {frame for frame in frames if frame is not None} == {STILL}


def test_a_changed_speed_is_sent_at_every_tick(gate: Gate) -> None:
    gate.enable()
    for _ in range(20):
        gate.take((0.2, 0.0, 0.0))
        assert gate.step() is not None


def test_the_refresh_is_the_setting_s() -> None:
    gate = Gate(gate__refresh_s=0.1)
    gate.enable()
    assert [n for n in range(20) if gate.step() is not None] == [0, 5, 10, 15]
