"""The death of a program that drives: nothing drives before an enable, and people are told whose death it was."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import pytest

from failstop import Robot
from failstop.lab.machine.process import Process
from failstop.lab.trial import Trial, judge, wait_for
from tests.support.amounts import amount
from tests.support.simulated import MS, Mistake, Simulated

DEATHS = amount(3, 200)
PROGRAM = """
import signal, sys, time
from failstop import Robot
from failstop.api.events import Event, EventLog

def fail(*_):
    raise RuntimeError("a mistake in the program")

signal.signal(signal.SIGHUP, signal.SIG_DFL)  # whatever the tests were started with
signal.signal(signal.SIGUSR1, fail)
signal.signal(signal.SIGUSR2, lambda *_: sys.exit())
robot = Robot(sys.argv[1], client="nav")
with robot if "with" in sys.argv else open("/dev/null"):
    if "enables" in sys.argv:
        robot.enable()
    while True:
        robot.drive(0.1, 0, 0, manual=True)
        time.sleep(0.02)
"""
WAYS = {
    "kill -9": signal.SIGKILL,
    "SIGHUP": signal.SIGHUP,
    "an exception": signal.SIGUSR1,
}
AFTER_S = 0.15


def program(trial: Trial, *words: str) -> subprocess.Popen[bytes]:
    """A program that drives."""
    return subprocess.Popen([sys.executable, "-c", PROGRAM, trial.name, *words], stderr=subprocess.DEVNULL)


def end(trial: Trial, driver: subprocess.Popen[bytes], number: int) -> int:
    """End it by a signal while the wheels turn; returns when that was sent."""
    trial.board.wait_wheels(turning=True, timeout_s=10.0)
    trial.board.events()
    now_ns = time.monotonic_ns()
    driver.send_signal(number)
    driver.wait()
    return now_ns


def drive_on(trial: Trial) -> Robot:
    """Command at once, as a program does that is started again."""
    until_s = time.monotonic() + AFTER_S
    robot = Robot(trial.name, client="again", disable_on_exit=False)
    while time.monotonic() < until_s:
        robot.drive(0.1, 0.0, 0.0, manual=True)
        time.sleep(0.01)
    return robot


def moves(robot: Robot, trial: Trial) -> Callable[[], object]:
    """Command, until the wheels turn."""
    return lambda: robot.drive(0.1, 0.0, 0.0, manual=True) and trial.turning()


@pytest.mark.timeout(3600)
def test_nothing_drives_before_an_enable_and_people_are_told_whose_death_it_was(trial: Trial) -> None:
    for number in range(DEATHS):
        way = list(WAYS)[number % len(WAYS)]
        words = [word for bit, word in enumerate(("with", "enables")) if number // len(WAYS) >> bit & 1]
        if "enables" not in words:
            trial.enable()
            trial.leave()
        driver = program(trial, *words)
        fault_ns = end(trial, driver, WAYS[way])
        again = drive_on(trial)
        case = f"{number}: {way} {words}"
        stopped = judge(trial.board.events(), fault_ns, was_turning=True)
        assert stopped.stop_ns is not None, case
        assert stopped.motion_after == 0, case
        assert (again.state.enabled, again.state.cause) == (False, None), case
        whose = f"motion disabled: nav (pid {driver.pid}), which had driven, has died"
        assert whose in str(again.why()), case
        again.enable()
        wait_for("the wheels to turn again", moves(again, trial))
        again.close()
        trial.board.wait_wheels(turning=False, timeout_s=5.0)


SIMULATED_WAYS: dict[str, Callable[[Simulated, Process], object]] = {
    "kill -9": lambda it, driver: it.lab.machine.kill(driver, signal.SIGKILL),
    "SIGHUP": lambda it, driver: it.lab.machine.kill(driver, signal.SIGHUP),
    "an exception": lambda it, driver: it.lab.machine.kill(driver, signal.SIGUSR1),
}


def simulated_program(simulated: Simulated, *words: str) -> Process:
    """PROGRAM, on the simulated machine."""

    def fail(*_: object) -> None:
        raise Mistake

    def body(failstop: Any) -> None:
        handlers = simulated.lab.loader.system["signal"]
        handlers.signal(signal.SIGUSR1, fail)
        robot = failstop.Robot(client="nav")
        with robot if "with" in words else contextlib.nullcontext():
            if "enables" in words:
                robot.enable()
            while True:
                robot.drive(0.1, 0, 0, manual=True)
                simulated.wait(0.02)

    return simulated.program("nav.py", body)


def fault(simulated: Simulated, way: str, *words: str) -> tuple[Process, int]:
    """A program that drives ends this way; who it was, and when."""
    if "enables" not in words:
        simulated.enable()
        simulated.leave()
    driver = simulated_program(simulated, *words)
    simulated.board.wait_wheels(turning=True)
    simulated.wait(0.1)
    simulated.board.events()
    fault_ns = simulated.now_ns()
    SIMULATED_WAYS[way](simulated, driver)
    return driver, fault_ns


def goes_on(simulated: Simulated) -> Any:
    """A program that commands at once, as one does that is started again; it has moved nothing."""
    again = simulated.failstop.Robot(client="again", disable_on_exit=False)
    for _ in range(15):
        again.drive(0.1, 0.0, 0.0, manual=True)
        simulated.wait(0.01)
    assert not simulated.turning()
    return again


@pytest.mark.claim("CLIENT-1", "MOVE-2")
@pytest.mark.parametrize("words", [(), ("with",), ("enables",), ("with", "enables")], ids=" ".join)
@pytest.mark.parametrize("way", SIMULATED_WAYS)
def test_however_a_driver_dies_nothing_drives_before_an_enable(
    simulated: Simulated, way: str, words: tuple[str, ...]
) -> None:
    driver, fault_ns = fault(simulated, way, *words)
    again = goes_on(simulated)
    stopped = judge(simulated.board.events(), fault_ns, was_turning=True)
    assert stopped.stop_ns is not None
    assert stopped.stop_ns <= 21 * MS
    assert stopped.motion_after == 0
    assert (again.state.enabled, again.state.cause) == (False, None)
    whose = f"motion disabled: nav (pid {driver.pid}), which had driven, has died"
    for told in (str(again.why()), simulated.printed("status"), simulated.printed("why"), simulated.printed("events")):
        assert whose in " ".join(told.split())
    again.enable()
    again.drive(0.1, 0.0, 0.0, manual=True)
    simulated.board.wait_wheels(turning=True)


def test_a_program_that_is_started_again_does_not_drive_on(simulated: Simulated) -> None:
    _, fault_ns = fault(simulated, "kill -9")
    again = simulated_program(simulated)
    simulated.wait(0.2)
    assert [source.who for source in simulated.robot.state.sources] == [f"nav (pid {again.pid})"]
    assert judge(simulated.board.events(), fault_ns, was_turning=True).motion_after == 0
    simulated.lab.machine.die(again, -9)
    simulated.wait(0.2)
    assert again.pid not in [client.pid for client in simulated.robot.state.clients]


def test_an_orderly_end_leaves_motion_enabled_for_others(simulated: Simulated) -> None:
    """One after the other: ten at a time, faster than the gate looks at who has gone."""
    simulated.enable()
    simulated.leave()
    for _ in range(amount(3, 200)):
        for _ in range(10):
            with simulated.failstop.Robot(client="short", disable_on_exit=False) as robot:
                assert robot.drive(0.1, 0.0, 0.0, manual=True, wait_s=0.5)
        simulated.wait(0.001)
    simulated.board.wait_wheels(turning=False)
    assert simulated.robot.state.enabled


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
    assert f"failstop drive (pid {killed[0].pid}), which had driven, has died" in str(simulated.robot.why())


@pytest.mark.parametrize("way", SIMULATED_WAYS)
def test_it_latches_where_the_settings_say_so(way: str) -> None:
    simulated = Simulated({"gate.driver_death": "latch"})
    driver, fault_ns = fault(simulated, way, "with", "enables")
    again = goes_on(simulated)
    assert str(again.state.cause) == f"driver died: nav (pid {driver.pid})"
    assert judge(simulated.board.events(), fault_ns, was_turning=True).motion_after == 0
    assert f"the program nav (pid {driver.pid}), which had driven, ended without a word" in str(again.why())
