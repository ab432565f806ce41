"""Sources and interlocks that the settings do not declare: a mistake is told at the call, and nothing is taken for
another name."""

from __future__ import annotations

from typing import Any

import pytest

from failstop_lab.machine.robot import SETTINGS as FILE
from tests.support.simulated import Simulated

SETTINGS = {"sources.teleop.priority": 10, "interlocks.doors.timeout_s": 0.5, "interlocks.arm": {}}


def enable(simulated: Simulated) -> None:
    simulated.robot.assert_interlocks("doors", "arm")
    simulated.wait(0.001)
    simulated.robot.enable()


def test_a_source_that_is_no_client_s_is_an_error_and_moves_nothing(simulated: Simulated) -> None:
    enable(simulated)
    for source, said in (
        ("telop", "no source 'telop' in the settings of .*, which declare: teleop, cmd_vel; add"),
        ("lidar", r"which declare: teleop, cmd_vel; add \[sources.NAME\] and restart the service"),
        ("gamepad", "no source 'gamepad' in the settings of .*, which declare: teleop, cmd_vel; add"),
        ("", "no source ''"),
        ("teleop" + 5000 * "x", "no source 'teleopx{34}' in"),
        ("cmd_vel\0", r"no source 'cmd_vel\\x00' in"),
    ):
        with pytest.raises(simulated.failstop.Undeclared, match=said) as caught:
            simulated.robot.drive(0.1, 0.0, 0.0, manual=True, source=source)
        error: Any = caught.value
        assert error.exit_code == 1
        assert isinstance(error, ValueError)
        assert len(str(error)) < 250
        assert "\n" not in str(error)
    for declared in ("teleop", "cmd_vel"):
        simulated.robot.drive(0.0, 0.0, 0.0, source=declared)
    simulated.wait(0.1)
    assert not simulated.turning()
    assert "ignored" not in simulated.said


def test_an_interlock_that_is_not_declared_is_an_error_and_none_is_asserted(simulated: Simulated) -> None:
    for held, said in (
        (("dors",), "no interlock 'dors' in the settings of .*, which declare: doors, arm; add"),
        (("doors", "arms"), "no interlock 'arms'"),
        (("doors\narm",), r"no interlock 'doors\\narm'"),
    ):
        with pytest.raises(simulated.failstop.Undeclared, match=said):
            simulated.robot.assert_interlocks(*held)
    simulated.robot.assert_interlocks()
    with pytest.raises(simulated.failstop.FailstopError, match="is not satisfied"):
        simulated.robot.enable()
    enable(simulated)


def test_the_former_name_of_an_assertion_asserts_and_warns(simulated: Simulated) -> None:
    with pytest.warns(DeprecationWarning, match=r"Robot\.hold is deprecated, .*: use assert_interlocks"):
        simulated.robot.hold("doors", "arm")
    simulated.wait(0.001)
    assert simulated.robot.enable() == "motion enabled"


def test_where_none_is_declared_that_is_said() -> None:
    simulated = Simulated()
    nothing = r"which declare: none; add \[interlocks.NAME\] and restart the service"
    with pytest.raises(simulated.failstop.Undeclared, match=nothing):
        simulated.robot.assert_interlocks("arm")


def test_a_restart_with_other_settings_is_followed(simulated: Simulated) -> None:
    with simulated.failstop.Robot() as robot:
        robot.drive(0.0, 0.0, 0.0, source="teleop")
        simulated.end()
        simulated.lab.write(FILE, "[sources.nav]\npriority = 3\n")
        simulated.start()
        robot.drive(0.0, 0.0, 0.0, source="nav")
        with pytest.raises(simulated.failstop.Undeclared):
            robot.drive(0.0, 0.0, 0.0, source="teleop")
