"""Status while the gate is dead or hangs, whose last record says that the robot drives."""

from __future__ import annotations

import pytest

from failstop.messages import layout
from tests.support.simulated import Simulated

SETTINGS = {"restart.backoff_s": 2.0}
"""The gate is away for two seconds once it has died for the second time."""


@pytest.fixture
def late(simulated: Simulated) -> Simulated:
    """A service that drives, and whose gate would be restarted after two seconds."""
    pid = simulated.pids()["gate"]
    simulated.die("gate")  # the first is restarted at once
    simulated.recover("gate", pid)
    simulated.set_off()
    assert simulated.robot.state.body_vel[0] > 0
    return simulated


def test_a_dead_gate_drives_nothing(late: Simulated) -> None:
    late.die("gate")
    late.wait(0.02)
    state = late.robot.state
    assert (state.estop, state.processes["gate"].state) == ("gate died", "waiting")
    assert (state.enabled, state.blocked) == (False, "estop: gate died")
    assert not any((*state.body_vel, *state.wheels_radps))
    assert state.sources == ()
    assert [client.driving for client in state.clients] == [False]
    said = late.printed("status")
    assert "TOLD TO STOP" in said, "so few samples of the IMU say nothing of the wheels"
    assert "DRIVING" not in said
    assert "a stop has been latched" in late.printed("why")
    late.wait_for("its successor", lambda: late.robot.state.waiting_for is None)
    assert late.robot.state.estop == "gate died", "its successor says the same"


def test_a_gate_that_hangs_drives_nothing(late: Simulated) -> None:
    gate = late.pids()["gate"]
    late.suspend("gate")
    late.wait_for("the stop to be told", lambda: (late.robot.state.estop or "").startswith("gate hangs"))
    state = late.robot.state
    row = state.processes["gate"]
    assert row.state != "running" or row.pid == gate, "nobody has taken over yet"
    assert not state.enabled
    assert not any(state.body_vel)
    late.recover("gate", gate)
    assert late.robot.state.estop.startswith("gate hangs")


def test_a_service_without_its_supervisor_drives_nothing(simulated: Simulated) -> None:
    """The gate's last record is no longer true, and when nobody of it is left there is no state at all."""
    reader = simulated.load("failstop.api.state").StateReader(simulated.name)
    simulated.set_off()
    robot = simulated.robot
    assert any(robot.state.wheels_radps)
    simulated.die(layout.SUPERVISOR)
    simulated.wait(0.001)
    for state in (robot.state, reader.read()):
        assert state.estop == "supervisor died"
        assert (state.enabled, state.blocked) == (False, f"estop: {state.estop}")
        assert not any((*state.body_vel, *state.wheels_radps))
        assert state.sources == ()
        assert not any(client.driving for client in state.clients)
        assert {name: row.state for name, row in state.processes.items()} == {
            "supervisor": "dead",
            "gate": "dead",
            "telemetry": "dead",
            "port_owner": "stopping",
            "stopper": "stopping",
        }
    simulated.wait_for("the last process to end", lambda: not simulated.living())
    code, out, err = simulated.command("status", "--json")
    assert (code, out) == (3, "")
    assert "supervisor died" in err
    assert "next: `failstop run" in err
