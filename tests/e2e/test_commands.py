"""The commands as a user types them."""

from __future__ import annotations

import contextlib

import pytest

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


def test_help_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    text = failstop("--help").stdout
    for command in COMMANDS:
        assert (f"  {command} " in text) == (command not in HIDDEN)
        with contextlib.suppress(SystemExit):
            assert main([command, "--help"]) == 0
        assert f"failstop {command}" in capsys.readouterr().out


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
