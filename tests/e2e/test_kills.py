"""Kills of each process, at any moment: the robot stops, in time, and nothing moves again without an enable."""

from __future__ import annotations

import pytest

from failstop.messages import layout
from failstop.messages.layout import GATE, PORT_OWNER, STOPPER, TELEMETRY
from tests.support.simulated import MS, Simulated


@pytest.mark.claim("DEATH-1")
@pytest.mark.parametrize("process", layout.PROCESS_NAMES)
def test_a_death_at_any_time_of_a_period_is_a_stop(process: str) -> None:
    simulated = Simulated({"restart.deaths": 100_000, "restart.backoff_s": 0.001})
    for number in range(4):
        simulated.set_off()
        pid = simulated.pids()[process]
        stopped = simulated.kill(process, 0.1 + number * 0.0054)
        assert stopped.was_turning
        assert stopped.stop_ns is not None
        assert stopped.stop_ns <= 8 * MS
        assert stopped.still_ns is not None
        assert stopped.motion_after == 0
        simulated.recover(process, pid)
        simulated.drive(0.05)
        assert not simulated.turning(), "a restarted process must not enable motion"


@pytest.mark.parametrize("process", [TELEMETRY, STOPPER, PORT_OWNER])
def test_one_that_died_too_often_is_started_anew_by_a_reset(process: str) -> None:
    simulated = Simulated({"restart.deaths": 1})
    robot = simulated.robot
    simulated.die(process)
    simulated.wait_for("the end of it", lambda: robot.state.processes[process].state == "down")
    robot.wait_for("latched", 1.0)
    assert f"{process} died too often, so it stays down" in simulated.said
    shown = simulated.command("status")[1]
    assert "next      `failstop reset" in shown
    assert f"{process} died too often and is down until a reset" in shown
    assert simulated.command("reset")[0] == 0
    simulated.wait_for("a whole service", lambda: robot.state.waiting_for is None)
    simulated.enable()
    simulated.drive(0.3)
    assert simulated.turning()


def test_a_request_to_a_gate_that_is_down_says_so_and_until_when() -> None:
    simulated = Simulated({"restart.deaths": 3})
    for _ in range(3):
        simulated.wait_for("a gate", lambda: simulated.pids()[GATE])
        simulated.die(GATE)
        simulated.wait(0.1)
    simulated.wait_for("the end of it", lambda: simulated.robot.state.processes[GATE].state == "down")
    simulated.wait(20.0)
    for verb in ("enable", "disable", "reset"):
        code, out, err = simulated.command(verb)
        assert (code, out, err.count("\n")) == (1, "", 1), err
        assert "died too often and is down, after it was killed by SIGKILL; it starts again in 3" in err
        assert "Only a stop is heard until then; ask again then, or restart the service now" in err
    simulated.robot.wait_for("latched", 1.0)
    assert "wait 3" in simulated.command("status")[1]
    simulated.wait(40.0)
    simulated.enable()


def test_a_speed_limit_outlives_the_gate(simulated: Simulated) -> None:
    assert "limit  " not in simulated.command("status")[1]
    assert simulated.command("limit", "50") == (0, "speed limited to 50 % of the settings'\n", "")
    assert "limit     speed limited to 50 %" in simulated.command("status")[1]
    simulated.enable()
    assert "but only 0.10 m/s forward" in simulated.printed("drive", "0.2", "0", "0", "--for", "0.5")
    refusal = "failstop: refused: a speed limit of 2 %: must be 5 to 100\n"
    assert simulated.command("limit", "2") == (2, "", refusal)
    for wrong, *words in ((2, "limit", "0"), (1, "drive", "nan", "0", "0")):
        code, _, err = simulated.command(*map(str, words))
        assert (code, err.count("\n")) == (wrong, 1), err
    pid = simulated.pids()[GATE]
    simulated.die(GATE)
    simulated.recover(GATE, pid)
    assert "limit     speed limited to 50 %" in simulated.command("status")[1], "a death lifts nothing"
    assert simulated.command("limit", "100") == (0, "speed limit lifted\n", "")
    told = simulated.printed("events", "--kind", "limit")
    assert "speed limited to 50 % of the settings' by failstop limit (pid" in told
