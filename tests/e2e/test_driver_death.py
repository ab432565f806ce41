"""The death of a program that drives: nothing drives before an enable, and people are told whose death it was. Real
programs die so in rows of tests/lab/faults; more rules are in tests/procs."""

from __future__ import annotations

import contextlib
import signal
from typing import Any

import pytest

from failstop_lab.machine.process import Process
from tests.support.simulated import Mistake, Simulated

WAYS = {"kill -9": signal.SIGKILL, "SIGHUP": signal.SIGHUP, "an exception": signal.SIGUSR1}


@pytest.mark.claim("CLIENT-1", "MOVE-2")
@pytest.mark.parametrize("words", [(), ("with",), ("enables",), ("with", "enables")], ids=" ".join)
@pytest.mark.parametrize("way", WAYS)
def test_however_a_driver_dies_nothing_drives_before_an_enable(
    simulated: Simulated, way: str, words: tuple[str, ...]
) -> None:
    def fail(*_: object) -> None:
        raise Mistake

    def drive(failstop: Any) -> None:
        simulated.lab.loader.system["signal"].signal(signal.SIGUSR1, fail)
        robot = failstop.Robot(client="nav")
        with robot if "with" in words else contextlib.nullcontext():
            if "enables" in words:
                robot.enable()
            while True:
                robot.drive(0.1, 0, 0, manual=True)
                simulated.wait(0.02)

    if "enables" not in words:
        simulated.enable()
        simulated.leave()
    driver = simulated.program("nav.py", drive)
    simulated.board.wait_wheels(turning=True)
    simulated.wait(0.1)
    simulated.board.events()
    fault_ns = simulated.now_ns()
    simulated.lab.machine.kill(driver, WAYS[way])
    again = simulated.failstop.Robot(client="again", disable_on_exit=False)
    for _ in range(15):  # at once, as a program does that is started again
        again.drive(0.1, 0.0, 0.0, manual=True)
        simulated.wait(0.01)
    assert not simulated.turning()
    simulated.stops(fault_ns, 21)
    assert (again.state.enabled, again.state.cause) == (False, None)
    whose = f"nav (pid {driver.pid}) died after it had driven"
    for told in (str(again.why()), simulated.printed("status"), simulated.printed("why"), simulated.printed("events")):
        assert whose in " ".join(told.split())
    again.enable()
    held = again.drive(0.1, 0.0, 0.0, manual=True)
    assert held.block is simulated.failstop.Block.HELD, "it has commanded all the time"
    again.drive(0.0, 0.0, 0.0, manual=True)
    again.drive(0.1, 0.0, 0.0, manual=True)
    simulated.board.wait_wheels(turning=True)


def test_the_command_line_s_drive_is_a_driver_as_any_other(simulated: Simulated) -> None:
    simulated.enable()
    simulated.leave()
    killed: list[Process] = []

    def kill() -> None:
        if simulated.turning() and not killed:
            killed.append(simulated.lab.kill("drive") or pytest.fail("no command runs"))

    assert simulated.command("drive", "0.1", "0", "0", "--for", "30", each=kill)[0] == -9
    simulated.board.wait_wheels(turning=False)
    simulated.wait(0.1)
    assert not simulated.robot.state.enabled
    assert f"failstop drive (pid {killed[0].pid}) died after it had driven" in str(simulated.robot.why())


def test_a_board_that_is_heard_again_hides_no_death(simulated: Simulated) -> None:
    """The service reports that it is ready again, which is no start."""
    simulated.enable()
    simulated.leave()
    driver = simulated.driver("nav")
    simulated.board.wait_wheels(turning=True)
    simulated.lab.machine.kill(driver, signal.SIGKILL)
    simulated.board.wait_wheels(turning=False)
    simulated.board.silent(True)
    simulated.wait_for("the wait to be logged", lambda: "waiting for" in simulated.printed("events"))
    simulated.board.silent(False)
    simulated.wait_for("its end", lambda: "motion can be enabled again" in simulated.printed("events"))
    assert f"nav (pid {driver.pid}) died after it had driven" in simulated.printed("why")
