"""`failstop probe ros2`, on the stand-in and on a real ROS; the driver itself says when its wheels stood."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from tests.ros2.scene import HERE, Ros
from tests.support.amounts import LONG

BASE = str(HERE / "base.py")
TIMEOUT_S = 0.5
NEAR_S, ON_THE_WAY_S = 0.05, 0.02
ENDS_S = 60.0
ROWS = "silence,sigkill,sigstop,abort,nan,two" if LONG else "sigkill,abort"


def probing(rows: str, out: Path) -> list[str]:
    """The command."""
    words = ["probe", "ros2", "--rows", rows, "--yes", "--json", "--out", str(out / "card")]
    return [sys.executable, "-m", "failstop", *words]


def driver(ros: Ros, timeout_s: float) -> subprocess.Popen[str]:
    """A driver with this timeout."""
    return subprocess.Popen(
        [sys.executable, BASE, str(timeout_s)], env=ros.environment, stdout=subprocess.PIPE, text=True
    )


def card(ros: Ros, timeout_s: float, rows: str, out: Path) -> tuple[list[dict], list[float]]:
    """The rows of the card of such a driver, and when its wheels came to rest (s, CLOCK_MONOTONIC), by its own word."""
    with driver(ros, timeout_s) as base:
        try:
            done = ros.run(*probing(rows, out), timeout_s=280.0)
        finally:
            base.kill()
        changes = [line.split() for line in base.communicate()[0].splitlines()]
    assert done.stdout, done.stderr
    found: dict = json.loads(done.stdout)
    assert not found["ended"]
    return found["rows"], [int(at_ns) / 1e9 for at_ns, turns in changes if turns == "0"]


@pytest.mark.slow
def test_a_driver_with_a_timeout_stops_after_it(ros: Ros, tmp_path: Path) -> None:
    rows, rests = card(ros, TIMEOUT_S, ROWS, tmp_path)
    assert [row["row"] for row in rows] == ROWS.split(",")
    for row in rows:
        really_s = next(at_s for at_s in rests if at_s >= row["failed_at_monotonic_s"]) - row["failed_at_monotonic_s"]
        print(f"{row['row']}: {row['stands_s']}, give or take {row['give_or_take_s']}; really {really_s:.3f}")
        near_s = max(NEAR_S, ON_THE_WAY_S + row["give_or_take_s"])
        assert row["stands_s"] == pytest.approx(really_s, abs=near_s), row


@pytest.mark.slow
def test_a_driver_without_one_never_does(ros: Ros, tmp_path: Path) -> None:
    ((row,), _) = card(ros, 0.0, "sigkill", tmp_path)
    assert row["never"]


@pytest.mark.slow
def test_a_probe_that_is_killed_leaves_no_base_driving(ros: Ros, tmp_path: Path) -> None:
    with driver(ros, 0.0) as base:
        assert base.stdout
        with subprocess.Popen(probing("silence", tmp_path), env=ros.environment, stdout=subprocess.DEVNULL) as probe:
            assert base.stdout.readline().split()[1:] == ["1"]
            others = psutil.Process(probe.pid).children()
            probe.kill()
        assert not psutil.wait_procs(others, ENDS_S)[1]
        base.terminate()
        changes = base.stdout.read().split("\n")[:-1]
    assert changes[-1].split()[1:] == ["0"]
