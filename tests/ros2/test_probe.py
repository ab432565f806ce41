"""`failstop probe ros2`, on the stand-in and on a real ROS; the driver itself says when its wheels stood."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from failstop.policy.halted import NOTHING_WRITTEN, UNCONFIRMABLE
from failstop_lab.probe.judge import NOT_TURNING
from failstop_lab.probe.ros2 import NOBODY_OBEYS
from tests.ros2.scene import HERE, Ros
from tests.support.amounts import LONG

BASE = str(HERE / "base.py")
TIMEOUT_S = 0.5
NEAR_S, ON_THE_WAY_S = 0.05, 0.02
ENDS_S = 60.0
ROWS = "silence,sigkill,sigstop,abort,nan,two" if LONG else "sigkill,abort"


def probing(rows: str, out: Path, *more: str) -> list[str]:
    """The command."""
    words = ["probe", "ros2", "--rows", rows, "--yes", "--json", "--out", str(out / "card"), *more]
    return [sys.executable, "-m", "failstop", *words]


def driver(ros: Ros, timeout_s: float, *more: str) -> subprocess.Popen[str]:
    """A driver with this timeout."""
    words = [sys.executable, BASE, str(timeout_s), *more]
    return subprocess.Popen(words, env=ros.environment, stdout=subprocess.PIPE, text=True)


def card(ros: Ros, timeout_s: float, rows: str, out: Path, *more: str) -> tuple[list[dict], list[float]]:
    """The rows of the card of such a driver, and when its wheels came to rest (s, CLOCK_MONOTONIC), by its own word."""
    with driver(ros, timeout_s) as base:
        try:
            done = ros.run(*probing(rows, out, *more), timeout_s=280.0)
        finally:
            base.kill()
        changes = [line.split() for line in base.communicate()[0].splitlines()]
    assert done.stdout, done.stderr
    found: dict = json.loads(done.stdout)
    assert not found["ended"]
    return found["rows"], [int(at_ns) / 1e9 for at_ns, turns in changes if turns == "0"]


@pytest.mark.slow
@pytest.mark.parametrize(("judge", "tried"), [("odometry", ROWS), ("IMU", "silence")])
def test_a_driver_with_a_timeout_stops_after_it(ros: Ros, tmp_path: Path, judge: str, tried: str) -> None:
    rows, rests = card(ros, TIMEOUT_S, tried, tmp_path, *(["--imu", "/imu"] if judge == "IMU" else []))
    assert [(row["row"], row["judged_by"]) for row in rows] == [(name, judge) for name in tried.split(",")]
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
def test_wheels_that_were_not_turning_were_not_stopped_by_the_failure(ros: Ros, tmp_path: Path) -> None:
    """Something else, as a collision monitor, stops them between the first report of motion and the failure."""
    with driver(ros, 0.0, "brief") as base:
        done = ros.run(*probing("silence", tmp_path), timeout_s=280.0)
        base.kill()
    (row,) = json.loads(done.stdout)["rows"]
    assert (row["stands_s"], row["never"], row["not_measured"]) == (None, False, NOT_TURNING)
    assert done.returncode == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flaw", "more", "why"),
    [
        ("jitters", (), "/odom does not show that the robot is at rest now: use --imu or --key"),
        ("numb", ("--imu", "/imu"), "/imu publishes too little: leave --imu out, or use --key"),
    ],
)
def test_what_shows_rest_and_turning_alike_is_no_judge(
    ros: Ros, tmp_path: Path, flaw: str, more: tuple[str, ...], why: str
) -> None:
    """It would say of each robot that it does not stop, or that it has stopped. It is not asked at the end either."""
    with driver(ros, TIMEOUT_S, flaw) as base:
        done = ros.run(*probing("silence", tmp_path, *more), timeout_s=280.0)
        base.kill()
    assert done.stdout, done.stderr
    card = json.loads(done.stdout)
    assert (card["rows"], card["ended"]) == ([], f"{why}; {UNCONFIRMABLE.format(where='/cmd_vel')}")
    assert done.returncode == 1


@pytest.mark.slow
def test_a_killed_driver_is_the_last_row_and_nobody_says_that_its_wheels_were_stopped(ros: Ros, tmp_path: Path) -> None:
    """Its odometry ends with it, and the zeros reach nobody."""
    with driver(ros, TIMEOUT_S) as base:
        done = ros.run(*probing("driver,silence", tmp_path, "--driver-pid", str(base.pid)), timeout_s=280.0)
        assert base.wait(ENDS_S) == -signal.SIGKILL
    card = json.loads(done.stdout)
    assert [(row["row"], bool(row["stands_s"])) for row in card["rows"]] == [("silence", True), ("driver", False)]
    assert card["ended"] == NOTHING_WRITTEN.format(where="/cmd_vel", why=f" ({NOBODY_OBEYS})")
    assert "if a wheel turns, switch off the power" in " ".join(done.stderr.split())
    assert done.returncode == 1


@pytest.mark.slow
@pytest.mark.parametrize("victim", ["probe", "guard"])
@pytest.mark.parametrize("how", ["SIGKILL", "SIGSTOP"])
def test_a_probe_of_which_one_process_fails_leaves_no_base_driving(
    ros: Ros, tmp_path: Path, victim: str, how: str
) -> None:
    """The base is one that keeps its last speed forever."""
    with driver(ros, 0.0) as base:
        assert base.stdout
        with subprocess.Popen(probing("silence", tmp_path), env=ros.environment, stdout=subprocess.DEVNULL) as probe:
            assert base.stdout.readline().split()[1:] == ["1"]
            others = psutil.Process(probe.pid).children()
            struck = [each for each in others if victim in each.cmdline()] or [psutil.Process(probe.pid)]
            struck[0].send_signal(signal.Signals[how])
            assert base.stdout.readline().split()[1:] == ["0"]
            if victim == "probe":
                probe.kill()
        assert not psutil.wait_procs(others, ENDS_S)[1]
        base.terminate()
        changes = base.stdout.read().split("\n")[:-1]
    assert changes == []
