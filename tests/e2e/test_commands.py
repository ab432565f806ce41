"""The commands as a user types them."""

from __future__ import annotations

import contextlib

import pytest

from failstop.cli.main import COMMANDS, HIDDEN, main
from tests.support.commands import failstop
from tests.support.simulated import Simulated


def test_a_session(simulated: Simulated) -> None:
    assert "blocked: disabled" in simulated.printed("status")
    code, _, err = simulated.command("drive", "0.1", "0", "0")
    assert (code, "motion is disabled; next: `failstop enable" in err) == (2, True)
    assert simulated.command("enable") == (0, "motion enabled\n", "")
    simulated.board.events()
    assert simulated.command("drive", "0.1", "0", "0", "--for", "0.3")[0] == 0
    assert any(event.is_motion for event in simulated.board.events())
    assert "hand near wheel" in simulated.printed("estop", "hand", "near", "wheel")
    code, _, err = simulated.command("enable")
    assert (code, "a stop is latched (stop request: hand near wheel" in err) == (2, True)
    assert simulated.command("drive", "0.1", "0", "0")[0] == 2
    screen = simulated.printed("status")
    assert "stop latched: stop request: hand near wheel" in screen
    assert "`failstop reset" in screen
    assert "motion still disabled" in simulated.printed("reset")
    assert simulated.printed("disable") == "motion disabled"


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
    from failstop.policy.settings import Settings

    text = failstop("config").stdout
    for key in Settings().flat():
        assert key in text


def test_a_differential_base_says_that_it_cannot_move_sideways() -> None:
    simulated = Simulated({"wheels.layout": "differential"})
    simulated.enable()
    code, _, err = simulated.command("drive", "0", "0.1", "0")
    assert code == 2
    assert "this base can't move sideways" in err
    assert simulated.command("drive", "0.1", "0", "0.1", "--for", "0.2")[0] == 0
