"""Drivers of an Arduino at the guard port: real programs, signals and terminals; the simulated board is the judge."""

from __future__ import annotations

import os
import signal
import time
from itertools import pairwise

import pytest

from bench.guard_scene import GuardScene, Process
from failstop.api.events import EventLog
from failstop_lab.trial import wait_for
from tests.support.amounts import amount

WAYS = ("serial", "exclusive")
MS = 1_000_000
RATE = "30"


def drives(scene: GuardScene, diffdrive: str, way: str = "serial", *how: str, speed: str = "10") -> Process:
    """A driver whose wheels turn."""
    scene.rest()
    scene.enable()
    driver = scene.driver(diffdrive, scene.path, way, speed, speed, RATE, *how)
    assert driver.line() == ("start |" if how == ("mute",) else "start Invalid Command|OK")
    scene.moves()
    return driver


@pytest.mark.parametrize("way", WAYS)
def test_a_driver_drives_and_reads_as_at_the_bare_board(arduino: GuardScene, diffdrive: str, way: str) -> None:
    driver = drives(arduino, diffdrive, way)
    wait_for("the wheels at their speed", lambda: max(map(abs, arduino.trial.board.wheels())) > 0.08)
    per_rps = 3436 / 30
    assert [speed * per_rps for speed in arduino.trial.board.wheels()] == pytest.approx([10, 10], abs=0.01)
    first = [int(word) for word in driver.newest().partition("|")[0].split()]
    wait_for("more counts", lambda: int(driver.newest().split()[0]) > first[0] + 30)
    assert all(line.partition("|")[2].startswith("OK|") for line in driver.lines[1:])
    assert driver.lines[1].startswith("0 0|"), "counts begin at zero"


def test_each_question_for_counts_gets_new_ones(arduino: GuardScene, diffdrive: str) -> None:
    """The service itself asks ten times a second: two of three answers at 30 Hz would be the same as the one before."""
    driver = drives(arduino, diffdrive, speed="30")
    wait_for("the wheels at their speed", lambda: driver.line() and max(map(abs, arduino.trial.board.wheels())) > 0.25)
    counts = [int(driver.line().split()[0]) for _ in range(60)]
    steps = [after - before for before, after in pairwise(counts)]
    assert steps.count(0) < 10, steps
    assert min(steps) >= 0


def test_status_names_the_driver(arduino: GuardScene, diffdrive: str) -> None:
    driver = drives(arduino, diffdrive)
    state = arduino.trial.robot.state
    [source] = state.sources
    assert (source.who, source.state) == (f"diffdrive (pid {driver.pid})", "drives")
    [client] = [client for client in state.clients if client.name == "diffdrive"]
    assert (client.pid, client.driving, client.wrong) == (driver.pid, True, "")
    wait_for("its words", lambda: any(arduino.path in client.sees for client in arduino.trial.robot.state.clients))


@pytest.mark.claim("GUARD-1")
@pytest.mark.parametrize("way", WAYS)
def test_a_driver_that_is_killed_stops_and_nothing_drives_before_an_enable(
    arduino: GuardScene, diffdrive: str, way: str
) -> None:
    for _ in range(amount(10, 500)):
        driver = drives(arduino, diffdrive, way)
        os.kill(driver.pid, signal.SIGKILL)
        driver.child.wait()
        again = arduino.driver(diffdrive, arduino.path, way, "10", "10", RATE)
        assert again.line().startswith("start "), "the exclusive mode of the dead one is gone"
        arduino.stands()
        wait_for("motion to be disabled", lambda: not arduino.trial.robot.state.enabled)
        assert f"diffdrive (pid {driver.pid}) died after it had driven" in str(arduino.trial.robot.why())
        arduino.trial.board.events()
        [again.line() for _ in range(6)]
        assert arduino.motion() == []
        again.kill()


def test_the_death_of_a_driver_is_its_own_though_a_child_keeps_the_port(arduino: GuardScene, diffdrive: str) -> None:
    driver = drives(arduino, diffdrive, "serial", "child")
    driver.kill()
    arduino.stands()
    wait_for("motion to be disabled", lambda: not arduino.trial.robot.state.enabled)
    assert arduino.guard
    arduino.guard.until("but a child of it still had it open, so the guard hung up")
    drives(arduino, diffdrive).kill()


def test_a_driver_that_runs_other_programs_drives_until_it_dies(arduino: GuardScene, diffdrive: str) -> None:
    """system() gives each of them the port for as long as it runs."""
    driver = drives(arduino, diffdrive, "serial", "system")
    for _ in range(20):
        assert driver.line().split("|")[1] == "OK"
    assert arduino.trial.turning()
    driver.kill()
    arduino.stands()
    wait_for("motion to be disabled", lambda: not arduino.trial.robot.state.enabled)


def test_a_driver_that_is_suspended_stops_and_goes_on_afterwards(arduino: GuardScene, diffdrive: str) -> None:
    driver = drives(arduino, diffdrive)
    os.kill(driver.pid, signal.SIGSTOP)
    arduino.stands()
    wait_for("why to say so", lambda: "stopped sending" in str(arduino.trial.robot.why()))
    assert arduino.trial.robot.state.enabled, "as the setting gate.driver_silence says"
    os.kill(driver.pid, signal.SIGCONT)
    arduino.moves()


@pytest.mark.claim("GUARD-1")
def test_what_a_dead_driver_wrote_moves_nothing(arduino: GuardScene, diffdrive: str) -> None:
    """The guard is stopped, the driver writes on without waiting, and dies; then the guard goes on."""
    driver = drives(arduino, diffdrive, "serial", "blind")
    assert arduino.guard
    os.kill(arduino.guard.pid, signal.SIGSTOP)
    try:
        arduino.stands()
        for _ in range(30):
            driver.line()
        driver.kill()
        arduino.trial.board.events()
    finally:
        os.kill(arduino.guard.pid, signal.SIGCONT)
    wait_for("the guard to have seen it", lambda: "diffdrive" not in arduino.clients())
    assert arduino.motion() == []


def test_a_driver_is_answered_in_step_after_the_guard_was_stopped(arduino: GuardScene, diffdrive: str) -> None:
    driver = drives(arduino, diffdrive)
    assert arduino.guard
    os.kill(arduino.guard.pid, signal.SIGSTOP)
    time.sleep(1.3)  # longer than the driver waits for an answer
    os.kill(arduino.guard.pid, signal.SIGCONT)
    wait_for("the lines that nobody answered", lambda: "" in driver.line().split("|")[:2])
    wait_for("an answer", lambda: "" not in driver.line().split("|")[:2])
    for _ in range(20):
        counts, answer, *_ = driver.line().split("|")
        assert answer == "OK"
        assert len(counts.split()) == 2


@pytest.mark.claim("GUARD-1")
@pytest.mark.parametrize("latched", [False, True], ids=["disabled", "latched"])
def test_nothing_moves_while_motion_is_disabled_or_a_stop_is_latched(
    arduino: GuardScene, diffdrive: str, latched: bool
) -> None:
    if latched:
        arduino.trial.robot.estop("a test")
    # As fast as it can.
    driver = arduino.driver(diffdrive, arduino.path, "serial", "300", "-300", "1e6")
    driver.line()
    for _ in range(amount(300, 100_000)):
        counts, answer, *_ = driver.line().split("|")
        assert (counts, answer) == ("0 0", "OK"), "it sees a board at rest"
    assert arduino.motion() == []
    if latched:
        wait_for("a reset to be taken", arduino.trial.reset)


def test_a_driver_that_never_ceased_to_command_drives_after_a_zero_alone(arduino: GuardScene, diffdrive: str) -> None:
    driver = arduino.driver(diffdrive, arduino.path, "serial", "10", "10", RATE)
    driver.line()
    driver.line()
    wait_for("its command", lambda: "diffdrive" in arduino.clients() and driver.line())
    arduino.trial.robot.enable()
    arduino.trial.board.events()
    for _ in range(10):
        driver.line()
    assert arduino.motion() == []
    assert arduino.trial.robot.state.sources[0].state == "held"


def test_speeds_beyond_the_limits_are_clamped_and_reported_once(arduino: GuardScene, diffdrive: str) -> None:
    drives(arduino, diffdrive, speed="900")
    assert arduino.guard
    arduino.guard.until("which the setting limits.vx_mps allows")
    time.sleep(0.5)  # past the ramp
    fastest = max(max(map(abs, speeds)) for _, speeds in arduino.motion())
    diameter_m = float(arduino.trial.robot.settings["wheels.diameter_m"])
    assert fastest * 3.14159265 * diameter_m <= float(arduino.trial.robot.settings["limits.vx_mps"]) * 1.01


def test_raw_pwm_stops_the_wheels_and_everybody_can_see_why(arduino: GuardScene) -> None:
    arduino.enable()
    pwm = arduino.folder / "pwm"
    driver = arduino.python(
        "import os, sys, time\n"
        "port = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)\n"
        "print('open', flush=True)\n"
        "while time.sleep(0.02) is None:\n"
        "    os.write(port, b'o 100 100\\r' if os.path.exists(sys.argv[2]) else b'm 10 10\\r')\n",
        str(pwm),
    )
    driver.line()
    arduino.moves()
    pwm.touch()
    arduino.stands()

    def wrong() -> str:
        return "".join(client.wrong for client in arduino.trial.robot.state.clients)

    wait_for("its words", wrong)
    assert wrong().startswith("failstop refused raw PWM (o): its speed can't be limited")
    assert wrong() in str(arduino.trial.robot.why())
    pwm.unlink()
    arduino.moves()
    wait_for("nothing to be wrong any more", lambda: not wrong())


def test_a_driver_that_never_reads_is_driven_all_the_same(arduino: GuardScene, diffdrive: str) -> None:
    driver = drives(arduino, diffdrive, "serial", "mute")
    for _ in range(60):
        driver.line()
    assert arduino.trial.turning()
    driver.kill()
    arduino.stands()


def test_a_second_program_is_kept_out(arduino: GuardScene, diffdrive: str) -> None:
    """By the kernel where it is an ordinary user's; root's comes in, and nothing moves until one of them has gone."""
    first = drives(arduino, diffdrive)
    second = arduino.driver(diffdrive, arduino.path, "serial", "20", "20", RATE)
    if os.geteuid():
        assert second.line().startswith("error open: Device or resource busy")
        assert arduino.trial.turning()
        return
    assert arduino.guard
    assert "guard.openers" in arduino.guard.until("have the port open, and")
    arduino.stands()
    second.kill()
    arduino.guard.until("has ended")
    wait_for("motion to be disabled", lambda: not arduino.trial.robot.state.enabled)
    assert first.child.poll() is None


def test_the_end_of_the_guard_is_the_end_of_its_driver(arduino: GuardScene, diffdrive: str) -> None:
    driver = drives(arduino, diffdrive)
    assert arduino.guard
    arduino.guard.kill()
    arduino.stands()
    wait_for("motion to be disabled", lambda: not arduino.trial.robot.state.enabled)
    assert driver.until("error").startswith("error")
    arduino.start_guard()
    drives(arduino, diffdrive)


def test_a_guard_that_hangs_stops_its_driver(arduino: GuardScene, diffdrive: str) -> None:
    drives(arduino, diffdrive)
    assert arduino.guard
    os.kill(arduino.guard.pid, signal.SIGSTOP)
    try:
        arduino.stands()
    finally:
        os.kill(arduino.guard.pid, signal.SIGCONT)


def test_a_flood_holds_up_neither_the_guard_nor_the_stop(arduino: GuardScene) -> None:
    driver = arduino.python(
        "import os, sys\n"
        "port = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)\n"
        "print('open', flush=True)\n"
        "while True: os.write(port, b'm 10 10\\r' * 400)\n"
    )
    driver.line()
    wait_for("the guard to know it", lambda: "driver0.py" in arduino.clients())
    arduino.trial.robot.enable()
    time.sleep(1.0)
    driver.kill()
    arduino.stands()
    wait_for("the guard to have seen its end", lambda: "driver0.py" not in arduino.clients())
    arduino.trial.board.events()
    time.sleep(0.3)
    assert arduino.motion() == []


def test_the_death_of_a_large_driver_is_seen_before_its_memory_is_gone(arduino: GuardScene, diffdrive: str) -> None:
    """Its files are closed afterwards, 50 ms and more later."""
    driver = drives(arduino, diffdrive, "serial", "big")
    os.kill(driver.pid, signal.SIGKILL)
    arduino.stands()
    wait_for("motion to be disabled", lambda: not arduino.trial.robot.state.enabled)
    assert arduino.guard
    arduino.guard.until(f"(pid {driver.pid}) has ended or died, and the last speed that it wrote was not zero")


def test_a_driver_that_never_drove_is_not_said_to_have_driven(arduino: GuardScene, diffdrive: str) -> None:
    """It commands while motion is disabled. The guard gives back its own client slot meanwhile, and lives on."""

    def logged() -> list[str]:
        return [event.text for event in EventLog(arduino.trial.name).read()]

    driver = arduino.driver(diffdrive, arduino.path, "serial", "10", "10", RATE)
    who = f"diffdrive (pid {driver.pid})"
    wait_for("its command", lambda: driver.line() and "diffdrive" in arduino.clients())
    wait_for("its report in the log", lambda: any(text.startswith(f"{who}: uses the guard port") for text in logged()))
    driver.kill()
    wait_for("its death in the log", lambda: f"{who} has gone" in logged())
    assert arduino.guard
    assert f"failstop guard (pid {arduino.guard.pid}) has gone" not in logged()
    line = arduino.guard.until("has ended")
    assert line == f"{who} has ended or died, and the last speed that it wrote was not zero"
