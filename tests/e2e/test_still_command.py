"""still.command as docs/safety.md has it: it runs when wheels do not obey a stop, and only where the IMU says so."""

from __future__ import annotations

import pytest

from tests.support.simulated import Simulated

AFTER_S = 1.5


@pytest.fixture
def simulated() -> Simulated:
    """A service that drives, and whose command is a program of the machine, `relay.py`; its runs' times are kept."""
    made = Simulated({"still.command": "relay.py"}, imu_hz=110.0)
    made.lab.machine.programs["relay.py"] = lambda process, argv: RAN.append(made.now_ns()) or 0
    RAN.clear()
    made.enable()
    made.drive(1.0)
    return made


RAN: list[int] = []


def stop(simulated: Simulated) -> int:
    """Stop, and wait for twice as long as the command would."""
    stopped_ns = simulated.now_ns()
    simulated.robot.estop("stop")
    simulated.wait(2 * AFTER_S)
    return stopped_ns


def test_wheels_that_turn_on_have_it_run_once(simulated: Simulated) -> None:
    log = simulated.load("failstop.api.events").EventLog(simulated.name)
    simulated.board.refuse_stop(True)
    stopped_ns = stop(simulated)
    began_s = [(ran_ns - simulated.lab.machine.start_ns - stopped_ns) / 1e9 for ran_ns in RAN]
    assert began_s == [pytest.approx(AFTER_S, abs=0.05)], "once for each stop"
    assert simulated.moving()
    told = [event.text for event in log.read() if event.kind == "command"]
    assert [text.partition(" (pid")[0] for text in told] == ["still.command runs", "still.command"]
    assert told[1].endswith("ended with code 0")


def test_without_an_imu_nobody_knows(simulated: Simulated) -> None:
    simulated.board.imu(False)
    simulated.board.refuse_stop(True)
    stop(simulated)
    assert simulated.moving()
    assert RAN == []


def test_wheels_that_obey_do_not_have_it_run(simulated: Simulated) -> None:
    stop(simulated)
    assert not simulated.moving()
    assert RAN == []
