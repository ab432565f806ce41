"""`failstop demo --ros2`: three more lines in the table."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from failstop_lab.ros2_demo import rows
from failstop_lab.trial import Trial
from tests.ros2.scene import Ros, new_name
from tests.support.leases import LEASES

ROWS = ["cmd_vel node ends", "a second one joins", "the bridge is killed"]


def test_its_rows(ros: Ros, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for key, value in ros.environment.items():
        monkeypatch.setenv(key, value)
    settings = tmp_path / "failstop.toml"
    settings.write_text(LEASES)
    said: dict[str, str] = {}
    with Trial(new_name(), ("--config", str(settings)), imu_hz=20.0) as trial:
        found = list(rows(trial, said.__setitem__))
    assert [row[0] for row in found] == ROWS
    assert all(stopped.stop_ns and not stopped.motion_after for _, stopped, _ in found), found
    assert "multiple cmd_vel publishers: " in said["node /joystick does too"]


def test_the_command_shows_them(ros: Ros) -> None:
    if not ros.real:
        pytest.skip("`make ros2` runs the whole demo")
    done = ros.run(sys.executable, "-m", "failstop", "demo", "--ros2", timeout_s=110.0)
    assert done.returncode == 0, done.stdout + done.stderr
    table = [line.split("  ")[0] for line in done.stdout.splitlines()]
    for row in ROWS:
        assert any(line.startswith(row) for line in table), done.stdout
