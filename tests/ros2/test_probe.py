"""`failstop probe ros2`, on the stand-in and on a real ROS; the driver itself says when its wheels stood."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.ros2.scene import HERE, Ros
from tests.support.amounts import LONG

BASE = str(HERE / "base.py")
TIMEOUT_S = 0.5
NEAR_S = 0.5
ROWS = "silence,sigkill,sigstop,abort,nan,two" if LONG else "sigkill,abort"


def card(ros: Ros, base_s: float, rows: str, out: Path) -> dict:
    with subprocess.Popen([sys.executable, BASE, str(base_s)], env=ros.environment, stdout=subprocess.DEVNULL) as base:
        try:
            words = ["probe", "ros2", "--rows", rows, "--yes", "--json", "--out", str(out / "card")]
            done = ros.run(sys.executable, "-m", "failstop", *words, timeout_s=280.0)
        finally:
            base.kill()
    assert done.stdout, done.stderr
    found: dict = json.loads(done.stdout)
    assert not found["ended"]
    return found


@pytest.mark.slow
def test_a_driver_with_a_timeout_stops_after_it(ros: Ros, tmp_path: Path) -> None:
    found = card(ros, TIMEOUT_S, ROWS, tmp_path)
    assert [row["row"] for row in found["rows"]] == ROWS.split(",")
    for row in found["rows"]:
        assert row["stands_s"] == pytest.approx(TIMEOUT_S, abs=NEAR_S), row


@pytest.mark.slow
def test_a_driver_without_one_never_does(ros: Ros, tmp_path: Path) -> None:
    (row,) = card(ros, 0.0, "sigkill", tmp_path)["rows"]
    assert row["never"]
