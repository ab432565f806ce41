"""`failstop demo --ros2`: three more lines in the table."""

from __future__ import annotations

import subprocess
import sys

from tests.ros2.scene import Ros


def test_demo(ros: Ros) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "failstop", "demo", "--ros2"],
        env=ros.environment,
        capture_output=True,
        text=True,
        timeout=110,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    table = [line.split("  ")[0] for line in done.stdout.splitlines()]
    for row in ("cmd_vel node ends", "a second one joins", "the bridge is killed"):
        assert any(line.startswith(row) for line in table), done.stdout
    assert "multiple cmd_vel publishers: " in done.stdout
