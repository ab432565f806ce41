"""Sources and interlocks that the settings do not declare: a mistake is told at the call, and nothing is taken for
another name."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop import FailstopError, Robot, Undeclared
from failstop.lab.trial import Trial, wait_for
from tests.support.commands import failstop

CONFIG = """
[sources.teleop]
priority = 10
[interlocks.doors]
timeout_s = 0.5
[interlocks.arm]
"""


@pytest.fixture
def rules(name: str, tmp_path: Path) -> Iterator[Trial]:
    config = tmp_path / "rules.toml"
    config.write_text(CONFIG)
    with Trial(name, ("--config", str(config))) as running:
        yield running


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("telop", "no source 'telop' in the settings of .*, which declare: teleop, cmd_vel; add"),
        ("lidar", r"which declare: teleop, cmd_vel; add \[sources.NAME\] and restart the service"),
        ("gamepad", "no source 'gamepad' in the settings of .*, which declare: teleop, cmd_vel; add"),
        ("", "no source ''"),
        ("teleop" + 5000 * "x", "no source 'teleopx{34}' in"),
        ("cmd_vel\0", r"no source 'cmd_vel\\x00' in"),
    ],
)
def test_a_source_that_is_no_client_s_is_an_error_and_moves_nothing(rules: Trial, source: str, said: str) -> None:
    with Robot(rules.name) as robot:
        robot.hold("doors", "arm")
        wait_for("motion to be enabled", lambda: _enabled(robot))
        with pytest.raises(Undeclared, match=said) as caught:
            robot.drive(0.1, 0.0, 0.0, manual=True, source=source)
        assert isinstance(caught.value, ValueError)
        assert caught.value.exit_code == 1
        assert len(str(caught.value)) < 250
        assert "\n" not in str(caught.value)
        for declared in ("teleop", "cmd_vel"):
            robot.drive(0.0, 0.0, 0.0, source=declared)
    assert "ignored" not in rules.service.said()


def _enabled(robot: Robot) -> bool:
    robot.hold("doors", "arm")
    try:
        robot.enable()
    except FailstopError:
        return False
    return True


@pytest.mark.parametrize(
    ("held", "said"),
    [
        (("dors",), "no interlock 'dors' in the settings of .*, which declare: doors, arm; add"),
        (("doors", "arms"), "no interlock 'arms'"),
        (("doors\narm",), r"no interlock 'doors\\narm'"),
    ],
)
def test_an_interlock_that_is_not_declared_is_an_error_and_none_is_asserted(
    rules: Trial, held: tuple[str, ...], said: str
) -> None:
    with Robot(rules.name) as robot:
        with pytest.raises(Undeclared, match=said):
            robot.hold(*held)
        robot.hold()
        with pytest.raises(FailstopError, match="is not satisfied"):
            robot.enable()
        wait_for("motion to be enabled", lambda: _enabled(robot))


def test_where_none_is_declared_that_is_said(trial: Trial) -> None:
    with pytest.raises(Undeclared, match=r"which declare: none; add \[interlocks.NAME\] and restart the service"):
        trial.robot.hold("arm")


def test_a_restart_with_other_settings_is_followed(name: str, tmp_path: Path) -> None:
    config = tmp_path / "changing.toml"
    config.write_text(CONFIG)
    with Trial(name, ("--config", str(config))) as trial, Robot(name) as robot:
        robot.drive(0.0, 0.0, 0.0, source="teleop")
        trial.service.end()
        config.write_text("[sources.nav]\npriority = 3\n")
        trial.service.start()
        robot.drive(0.0, 0.0, 0.0, source="nav")
        with pytest.raises(Undeclared):
            robot.drive(0.0, 0.0, 0.0, source="teleop")


@pytest.mark.parametrize("source", ["telop", "gamepad"])
def test_teleop_says_so_before_it_takes_the_screen(trial: Trial, source: str) -> None:
    done = failstop("teleop", "--source", source, "--name", trial.name)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("failstop: ")
    assert f"source '{source}'" in done.stderr
    assert done.stderr.count("\n") == 1
    assert trial.robot.state.clients == ()
