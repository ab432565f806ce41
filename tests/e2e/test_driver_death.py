"""The death of a program that drives: nothing drives before an enable, and people are told whose death it was."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from failstop import Robot
from failstop.api.events import Event, EventLog
from failstop.lab.trial import Trial, judge, wait_for, write_settings
from tests.support.amounts import amount
from tests.support.commands import failstop

DEATHS = amount(6, 200)
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
    trial.board.wait_wheels(moving=True, timeout_s=10.0)
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
    return lambda: robot.drive(0.1, 0.0, 0.0, manual=True) and trial.moving()


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
        stopped = judge(trial.board.events(), fault_ns, was_moving=True)
        assert stopped.stop_ns is not None, case
        assert stopped.motion_after == 0, case
        assert (again.state.enabled, again.state.cause) == (False, None), case
        whose = f"motion disabled: nav (pid {driver.pid}), which had driven, has died"
        assert whose in str(again.why()), case
        for command in ("status", "why"):
            assert whose in " ".join(failstop(command, "--name", trial.name).stdout.split()), case
        events = [json.loads(line) for line in failstop("events", "--json", "--name", trial.name).stdout.splitlines()]
        assert whose in [event["text"] for event in events], case
        again.enable()
        wait_for("the wheels to turn again", moves(again, trial))
        again.close()
        trial.board.wait_wheels(moving=False, timeout_s=1.0)


def test_a_program_that_is_started_again_does_not_drive_on(trial: Trial) -> None:
    trial.enable()
    trial.leave()
    driver = program(trial)
    fault_ns = end(trial, driver, signal.SIGKILL)
    with program(trial) as again, Robot(trial.name) as robot:
        wait_for("it to command", lambda: any(f"pid {again.pid})" in source.who for source in robot.state.sources))
        time.sleep(AFTER_S)
        assert judge(trial.board.events(), fault_ns, was_moving=True).motion_after == 0
        again.kill()
        wait_for("its death to be known", lambda: all(client.pid != again.pid for client in robot.state.clients))


def test_an_orderly_end_leaves_motion_enabled_for_others(trial: Trial) -> None:
    """One after the other, faster than the gate looks at who has gone."""
    trial.enable()
    trial.leave()
    for _ in range(amount(20, 2000)):
        with Robot(trial.name, client="short", disable_on_exit=False) as robot:
            assert robot.drive(0.1, 0.0, 0.0, manual=True, wait_s=0.5)
    driver = program(trial, "with")
    end(trial, driver, signal.SIGUSR2)
    trial.board.wait_wheels(moving=False, timeout_s=1.0)
    assert trial.robot.state.enabled


def test_the_command_line_s_drive_is_a_driver_as_any_other(trial: Trial) -> None:
    trial.enable()
    trial.leave()
    command = [sys.executable, "-m", "failstop", "drive", "0.1", "0", "0", "--for", "30", "--name", trial.name]
    driver = subprocess.Popen(command)
    end(trial, driver, signal.SIGKILL)
    wait_for("motion to be disabled", lambda: not trial.robot.state.enabled)
    assert f"failstop drive (pid {driver.pid}), which had driven, has died" in str(trial.robot.why())


@pytest.fixture
def latching(name: str, tmp_path: Path) -> Iterator[Trial]:
    path = tmp_path / "latch.toml"
    write_settings(str(path), {"gate.driver_death": "latch"})
    with Trial(name, ("--config", str(path))) as running:
        yield running


@pytest.mark.parametrize("way", WAYS)
def test_it_latches_where_the_settings_say_so_and_the_incident_says_whose_it_was(latching: Trial, way: str) -> None:
    driver = program(latching, "with", "enables")
    fault_ns = end(latching, driver, WAYS[way])
    again = drive_on(latching)
    assert str(again.state.cause) == f"driver died: nav (pid {driver.pid})"
    assert judge(latching.board.events(), fault_ns, was_moving=True).motion_after == 0
    assert f"the program nav (pid {driver.pid}), which had driven, ended without a word" in str(again.why())
    again.close()
    saved = EventLog(latching.name, past=True)
    told: list[Event] = []

    def incidents() -> list[Event]:
        told.extend(saved.read())
        return [event for event in told if event.kind == "incident"]

    wait_for("the incident", incidents)
    assert [event.fields["reason"] for event in incidents()] == [f"driver died: nav (pid {driver.pid})"]
