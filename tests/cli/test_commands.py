"""`failstop status`, `why` and `events` as a user types them."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time

import pytest

from failstop_lab.trial import Trial, wait_for
from tests.support.commands import FAILSTOP, failstop
from tests.support.typist import Typist

MOST_LOADED = 200
"""Modules, of which Python and its own argparse, dataclasses and json are 105."""
IMU_HZ = 110.0
"""A stop is seen to be one by the samples of a real board."""


def said(trial: Trial, *words: str) -> str:
    done = failstop(*words, "--name", trial.name)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def latch(trial: Trial, reason: str = "hand near") -> None:
    trial.robot.estop(reason)
    wait_for("the latch", lambda: trial.robot.state.estop is not None)
    wait_for("its last proof", lambda: getattr(trial.robot.state.last_stop, "observed_s", None) is not None)


def test_status_through_its_states(trial: Trial) -> None:
    wait_for("the IMU's word", lambda: trial.robot.state.turning.does == "still")
    head = r"wheels    STOPPED  blocked: disabled\nseen      the IMU feels no movement \(0\.[01] s ago\)\n"
    assert re.match(rf"{head}next      `failstop enable --name {trial.name}`\n", said(trial, "status"))
    trial.enable()
    assert "blocked: no command" in said(trial, "status")
    latch(trial)
    shown = said(trial, "status")
    assert "stop latched: stop request: hand near (says it is trial, pid" in " ".join(shown.split())
    named = f"--name {trial.name}`"
    assert f"`failstop reset {named}, then `failstop enable {named}" in " ".join(shown.split())
    assert "written by the port owner after" in " ".join(shown.split())
    assert "link alive" in shown
    assert "\x1b" not in shown, "no colours in a pipe"
    assert max(map(len, shown.splitlines())) <= 80


def test_colours_on_a_terminal_only_and_not_with_no_color(trial: Trial) -> None:
    words = [*FAILSTOP, "status", "--name", trial.name]
    wait_for("the IMU's word", lambda: trial.robot.state.turning.does == "still")
    with Typist(words) as coloured, Typist(words, environ={"NO_COLOR": "1"}) as plain:
        assert (coloured.end(), plain.end()) == (0, 0)
        assert "\x1b[38;5;166mSTOPPED" in coloured.raw
        assert "\x1b" not in plain.raw
        assert "STOPPED" in plain.raw


def test_status_loads_little(trial: Trial) -> None:
    """Most of its time is that of imports; its whole cost is a row of bench/cost.py."""
    words = (sys.executable, "-X", "importtime", "-m", "failstop", "status", "--name", trial.name)
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=True)
    loaded = [line.rpartition("|")[2].strip() for line in done.stderr.splitlines() if line.startswith("import time:")]
    assert "failstop.cli.screen.summary" in loaded
    assert len(loaded) < MOST_LOADED
    assert not {"asyncio", "numpy", "psutil", "subprocess", "tomllib"} & set(loaded)


def test_why_of_a_latch(trial: Trial) -> None:
    latch(trial)
    shown = " ".join(said(trial, "why").split())
    assert f'a program that says it is trial (pid {os.getpid()}) asked for a stop: "hand near"' in shown
    assert "acknowledged by the board after" in shown
    steps = [f"`failstop {verb} --name {trial.name}`" for verb in ("reset", "enable")]
    assert f"then {steps[0]}, then {steps[1]}" in shown
    found = json.loads(said(trial, "why", "--json"))
    assert found["do"][1:] == steps
    assert found["since"] == pytest.approx(time.time(), abs=60)


def test_events_say_what_happened(trial: Trial) -> None:
    start_s = time.time()
    trial.enable()
    latch(trial, "for the record")
    wait_for("the event", lambda: "for the record" in said(trial, "events"))
    rows = said(trial, "events", "--since", "1h").splitlines()
    assert any(" enabled " in row for row in rows)
    found = [json.loads(row) for row in said(trial, "events", "--json", "--kind", "stop").splitlines()]
    assert {row["kind"] for row in found} == {"stop"}
    assert found[-1]["fields"]["reason"].startswith("stop request: for the record")
    assert start_s - 1 < found[-1]["t"] < time.time() + 1
    assert set(found[-1]) == {"seq", "t", "ns", "kind", "level", "text", "fields", "next"}
    assert found[-1]["next"].startswith("`failstop reset")
    assert said(trial, "events", "--since", "0s") == ""
    assert failstop("events", "--kind", "nonsense", "--name", trial.name).returncode == 1
    assert failstop("events", "--since", "nonsense", "--name", trial.name).returncode == 1


def test_events_without_a_service() -> None:
    done = failstop("events", "--name", "nobody-here")
    assert (done.returncode, done.stdout) == (3, "")
    assert "journalctl" not in done.stderr, "no unit, no journal"
    assert done.stderr.count("\n") == 1


def test_events_follow_over_a_restart(trial: Trial) -> None:
    with Typist.failstop("events", "--follow", "--name", trial.name, columns=200) as events:
        events.wait("ready")
        trial.robot.estop("while it follows")
        events.wait("while it follows")
        trial.leave()
        trial.service.end()
        events.wait("waiting for it")
        trial.service.start()
        trial.enable()
        events.wait("enabled by trial")
        events.process.send_signal(signal.SIGINT)
        assert events.end() == 130
