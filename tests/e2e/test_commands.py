"""The commands as a user types them."""

from __future__ import annotations

import contextlib
import os
import pty
import resource
import tty
from pathlib import Path

import pytest

from failstop.board.burst import BURST
from failstop.cli.main import COMMANDS, HIDDEN, main
from failstop.lab.trial import Trial
from tests.support.commands import failstop
from tests.support.simulated import Simulated


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


def test_status_json_has_what_is_promised(simulated: Simulated) -> None:
    simulated.set_off()
    simulated.robot.estop("for the record")
    simulated.board.wait_for(lambda event: event.is_stop)
    simulated.wait(0.1)
    state = simulated.json("status")
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
    """The measure is the processor time that it takes, which other programs do not change."""

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


def test_a_differential_base_says_that_it_cannot_move_sideways() -> None:
    simulated = Simulated({"wheels.layout": "differential"})
    simulated.enable()
    code, _, err = simulated.command("drive", "0", "0.1", "0")
    assert code == 2
    assert "a differential base can't move sideways" in err
    assert simulated.command("drive", "0.1", "0", "0.1", "--for", "0.2")[0] == 0


def test_status_is_live_with_an_option_and_needs_a_terminal_for_it(trial: Trial) -> None:
    live = failstop("status", "-w", "--name", trial.name)
    assert (live.returncode, live.stdout) == (1, "")
    assert "needs a terminal" in live.stderr
