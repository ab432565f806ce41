"""A machine without ROS 2: one line says what to do."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest


@pytest.mark.parametrize("sourced", [True, False])
def test_one_line_and_exit_code_1(sourced: bool) -> None:
    clean = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "AMENT_PREFIX_PATH")}
    environment = clean | ({"AMENT_PREFIX_PATH": "/nowhere"} if sourced else {})
    done = subprocess.run(
        [sys.executable, "-m", "failstop", "ros2"], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert done.stdout == ""
    said = " ".join(done.stderr.split())
    assert said.startswith("failstop: ")
    assert "setup.sh" in said or "install failstop for ROS's own Python" in said
    assert "Traceback" not in said
