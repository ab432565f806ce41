"""The commands as a user types them."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import resource
import signal
import tty
from pathlib import Path

import pytest

from failstop.board.burst import BURST
from failstop.cli.main import COMMANDS, HIDDEN, main
from failstop.lab.trial import Trial, wait_for
from tests.support.commands import failstop


def test_a_session(trial: Trial) -> None:
    at = ("--name", trial.name)
    assert "blocked: disabled" in failstop("status", *at).stdout
    refused = failstop("drive", "0.1", "0", "0", *at)
    assert refused.returncode == 2
    assert "motion is disabled; next: `failstop enable --name" in refused.stderr
    assert failstop("enable", *at).stdout == "motion enabled\n"
    trial.board.events()
    assert failstop("drive", "0.1", "0", "0", "--for", "0.3", *at).returncode == 0
    assert any(event.is_motion for event in trial.board.events())
    latched = failstop("estop", "hand", "near", "wheel", *at)
    assert latched.returncode == 0
    assert "hand near wheel" in latched.stdout
    refused = failstop("enable", *at)
    assert refused.returncode == 2
    assert "a stop is latched (stop request: hand near wheel" in refused.stderr
    assert failstop("drive", "0.1", "0", "0", *at).returncode == 2
    screen = failstop("status", *at).stdout
    assert "stop latched: stop request: hand near wheel" in screen
    assert "`failstop reset --name" in screen
    assert "motion still disabled" in failstop("reset", *at).stdout
    assert failstop("disable", *at).stdout == "motion disabled\n"


def test_a_speed_limit_holds_for_every_driver_until_it_is_lifted(trial: Trial) -> None:
    at = ("--name", trial.name)
    assert "limit  " not in failstop("status", *at).stdout
    assert failstop("limit", "50", *at).stdout == "speed limited to 50 % of the settings'\n"
    assert "limit     speed limited to 50 %" in failstop("status", *at).stdout
    trial.enable()
    driven = failstop("drive", "0.2", "0", "0", "--for", "0.5", *at).stdout
    assert "no faster than 0.10 m/s forward" in driven
    refused = failstop("limit", "2", *at)
    assert (refused.returncode, refused.stderr) == (2, "failstop: refused: a speed limit of 2 %: must be 5 to 100\n")
    for code, *words in ((2, "limit", "0"), (1, "drive", "nan", "0", "0")):
        wrong = failstop(*words, *at)
        assert (wrong.returncode, wrong.stderr.count("\n")) == (code, 1), wrong.stderr
    os.kill(trial.robot.state.processes["gate"].pid, signal.SIGKILL)
    wait_for("the next gate", lambda: trial.robot.state.processes["gate"].restarts == 1)
    wait_for("its word", lambda: not trial.robot.state.waiting_for)
    assert "limit     speed limited to 50 %" in failstop("status", *at).stdout, "a death lifts nothing"
    assert failstop("limit", "100", *at).stdout == "speed limit lifted\n"
    told = failstop("events", "--kind", "limit", *at).stdout
    assert "speed limited to 50 % of the settings' by failstop limit (pid" in told


def test_status_json_has_what_is_promised(trial: Trial) -> None:
    trial.enable()
    trial.drive(0.1)
    trial.board.events()
    trial.robot.estop("for the record")
    trial.board.wait_for(lambda event: event.is_stop, 2.0)
    state = json.loads(failstop("status", "--json", "--name", trial.name).stdout)
    promised = {
        "name",
        "enabled",
        "estop",
        "blocked",
        "body_vel",
        "epoch",
        "device",
        "processes",
        "clients",
        "last_stop",
    }
    assert promised <= state.keys()
    assert {"path", "state", "link"} <= state["device"].keys()
    assert set(state["processes"]) == {"supervisor", "port_owner", "gate", "telemetry", "stopper"}
    for process in state["processes"].values():
        assert {"pid", "state", "age_s", "restarts"} <= process.keys()
        assert process["state"] == "running"
    assert {"reason", "t", "written_s", "acknowledged_s", "observed_s"} <= state["last_stop"].keys()
    assert state["clients"][0]["name"] == "trial"


def test_status_is_quick(trial: Trial) -> None:
    """By the processor time that it takes, which other programs do not change."""

    def spent_s() -> float:
        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        return children.ru_utime + children.ru_stime

    times = []
    for _ in range(5):
        before_s = spent_s()
        assert failstop("status", "--name", trial.name).returncode == 0
        times.append(spent_s() - before_s)
    assert min(times) < 0.5, times


def test_help_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    text = failstop("--help").stdout
    for command in COMMANDS:
        assert (f"  {command} " in text) == (command not in HIDDEN)
        with contextlib.suppress(SystemExit):
            assert main([command, "--help"]) == 0
        assert f"failstop {command}" in capsys.readouterr().out


def test_stop_tool(tmp_path: Path) -> None:
    master, slave = pty.openpty()
    tty.setraw(slave)
    device = tmp_path / "board"
    os.symlink(os.ttyname(slave), device)
    result = failstop("stop", "--device", str(device))
    assert result.stdout == f"stop frame sent (after 0.0 s), directly to {device}\n"
    assert os.read(master, 4096) == BURST
    os.close(master)
    os.close(slave)
    gone = failstop("stop", "--device", str(tmp_path / "none"), "--wait", "0.1")
    assert gone.returncode == 1
    assert "no device" in gone.stderr


def test_stop_tool_beside_a_running_service(trial: Trial) -> None:
    trial.board.events()
    assert failstop("stop", "--device", trial.link).returncode == 0
    assert sum(event.is_stop for event in trial.board.events()) >= 4


def test_config_lists_every_setting() -> None:
    from failstop.policy.settings import DECLARED

    text = failstop("config").stdout
    for setting in DECLARED:
        assert setting.key in text


def test_a_differential_base_says_that_it_cannot_move_sideways(name: str, tmp_path: Path) -> None:
    config = tmp_path / "failstop.toml"
    config.write_text('[wheels]\nlayout = "differential"\n')
    with Trial(name, ("--config", str(config))) as trial:
        trial.enable()
        sideways = failstop("drive", "0", "0.1", "0", "--name", trial.name)
        assert sideways.returncode == 2
        assert "a differential base can't move sideways" in sideways.stderr
        assert failstop("drive", "0.1", "0", "0.1", "--for", "0.2", "--name", trial.name).returncode == 0


def test_status_is_live_with_an_option_and_needs_a_terminal_for_it(trial: Trial) -> None:
    live = failstop("status", "-w", "--name", trial.name)
    assert (live.returncode, live.stdout) == (1, "")
    assert "needs a terminal" in live.stderr
