"""Sources, scan gate, interlocks on the running service: what the board's wheels do, what `status --json` says."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from failstop import Refused, Robot
from failstop.lab.trial import Trial, wait_for
from tests.support.commands import failstop

Status = Callable[[], dict[str, Any]]

CONFIG = """
[sources.cmd_vel]
priority = 0
[sources.teleop]
priority = 10
timeout_s = 0.3
[interlocks.arm]
timeout_s = 0.4
refusal = "arm is not in the drive pose"
"""


@pytest.fixture
def rules(name: str, tmp_path: Path) -> Iterator[Trial]:
    """A service with a second source and an interlock."""
    config = tmp_path / "rules.toml"
    config.write_text(CONFIG)
    with Trial(name, ("--config", str(config))) as running:
        yield running


@pytest.fixture
def status(rules: Trial) -> Status:
    def read() -> dict[str, Any]:
        found: dict[str, Any] = json.loads(failstop("status", "--json", "--name", rules.name).stdout)
        return found

    return read


def test_no_scan_stops_and_resumes_by_itself(trial: Trial) -> None:
    trial.enable()
    trial.drive(0.3)
    assert trial.moving()
    trial.board.events()
    trial.robot.sensed()
    seen_ns = time.monotonic_ns()
    until = time.monotonic() + 0.8
    while time.monotonic() < until:
        trial.robot.drive(0.2, 0.0, 0.0)
        time.sleep(0.02)
    state = json.loads(failstop("status", "--json", "--name", trial.name).stdout)
    assert state["enabled"]
    assert state["estop"] is None
    trial.robot.drive(0.2, 0.0, 0.0)
    wait_for("the block", lambda: trial.robot.state.blocked == "no scan")
    still = next(e for e in trial.board.events() if e.is_motor and not any(e.speeds))
    assert 0.45 < (still.arrival_ns - seen_ns) / 1e9 < 1.0
    trial.drive(0.2)
    assert trial.moving(), "motion resumes by itself"
    assert "no scan for 0.5" in trial.service.said()
    assert "scan is back" in trial.service.said()


def test_manual_commands_need_no_scan(trial: Trial) -> None:
    trial.enable()
    until = time.monotonic() + 0.2
    while time.monotonic() < until:
        trial.robot.drive(0.2, 0.0, 0.0, manual=True)
        time.sleep(0.02)
    assert trial.moving()


def test_interlock_is_needed_to_enable_and_its_loss_disables(rules: Trial, status: Status) -> None:
    with pytest.raises(Refused, match="arm is not in the drive pose"):
        rules.robot.enable()
    rules.robot.hold("arm")
    wait_for("the interlock to be seen", lambda: _enabled(rules.robot))
    for _ in range(10):
        rules.robot.hold("arm")
        rules.drive(0.03)
    assert rules.moving()
    rules.board.events()
    rules.drive(0.6)
    assert not rules.moving()
    assert any(event.is_stop for event in rules.board.events())
    state = status()
    assert state["blocked"] == "disabled"
    assert state["estop"] is None
    assert "motion disabled: arm is not in the drive pose" in rules.service.said()


def _enabled(robot: Robot) -> bool:
    robot.hold("arm")
    try:
        robot.enable()
    except Refused:
        return False
    return True


def test_a_higher_source_takes_over_and_gives_back(rules: Trial) -> None:
    wait_for("the interlock to be seen", lambda: _enabled(rules.robot))
    with Robot(rules.name, client="person") as person:
        for _ in range(15):
            rules.robot.hold("arm")
            rules.drive(0.02)
            person.drive(-0.1, 0.0, 0.0, manual=True, source="teleop")
        assert rules.board.wheels()[0] < 0
        state = rules.robot.state
        assert [(row.source, row.state) for row in state.sources][:1] == [("teleop", "drives")]
        assert state.estop is None
    for _ in range(20):
        rules.robot.hold("arm")
        rules.drive(0.02)
    assert rules.board.wheels()[0] > 0


def test_unknown_source_is_told_and_moves_nothing(trial: Trial) -> None:
    trial.enable()
    trial.robot._client().command(0.1, 0.0, 0.0, manual=True, source="navv")
    wait_for("the note", lambda: "no source 'navv'" in trial.service.said())
    assert not trial.moving()
