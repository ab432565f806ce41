"""The end of a C program that drives, in every way that a program ends: the wheels stop, and nothing drives before an
enable. The board is the judge, and a Python program that dies in the same way is beside it."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import time
from pathlib import Path

import pytest

from failstop_lab.trial import Trial, wait_for
from tests.clients.scene import LATE_NS, OK, seen, set_off, stays
from tests.support.c_client import SOURCE, Driver, cpp_compiler, library

ENDS = {
    "kill -9": lambda driver: os.kill(driver.pid, signal.SIGKILL),
    "SIGHUP": lambda driver: os.kill(driver.pid, signal.SIGHUP),
    "SIGTERM": lambda driver: os.kill(driver.pid, signal.SIGTERM),
    "a segmentation fault": lambda driver: os.kill(driver.pid, signal.SIGSEGV),
    "SIGABRT": lambda driver: os.kill(driver.pid, signal.SIGABRT),
}


def driving(trial: Trial, driver: Driver) -> None:
    """Have it drive for as long as it lives, with motion that somebody else has enabled."""
    driver.connect(trial.name)
    set_off(trial, driver)
    driver.tell("for -1 0.2")
    assert driver.answer() == "driving"
    trial.board.wait_wheels(turning=True, timeout_s=5.0)
    trial.leave()


@pytest.mark.claim("CLIENT-1", "MOVE-2")
@pytest.mark.parametrize("way", ENDS)
def test_however_it_dies_the_wheels_stop(trial: Trial, driver: Driver, way: str) -> None:
    driving(trial, driver)
    fault_ns = time.monotonic_ns()
    ENDS[way](driver)
    stopped = seen(trial, fault_ns)
    assert stopped.stop_ns is not None
    assert stopped.stop_ns < LATE_NS
    assert stopped.motion_after == 0
    stays(trial, "driver.c", driver.pid)


@pytest.mark.parametrize("way", ["exit", "abort", "crash", "exec"])
def test_a_driver_that_ends_itself_without_a_goodbye_has_died(trial: Trial, driver: Driver, way: str) -> None:
    driver.connect(trial.name)
    set_off(trial, driver)
    assert driver.do("for 0.1 0.2") == OK
    trial.board.events()
    fault_ns = time.monotonic_ns()
    driver.tell(way)
    if way == "exec":
        wait_for("another program to run", lambda: Path(f"/proc/{driver.pid}/comm").read_text() == "sleep\n")
    else:
        driver.process.wait()
    stopped = seen(trial, fault_ns)
    assert stopped.stop_ns is not None
    assert stopped.stop_ns < LATE_NS
    assert stopped.motion_after == 0
    stays(trial, "driver.c", driver.pid)
    if way == "exec":
        assert driver.process.poll() is None, "another program goes on under its number"


def test_a_handle_that_is_abandoned_is_a_program_that_has_died(trial: Trial, driver: Driver) -> None:
    driver.connect(trial.name)
    set_off(trial, driver)
    assert driver.do("for 0.1 0.2") == OK
    trial.board.events()
    fault_ns = time.monotonic_ns()
    assert driver.do("abandon") == OK
    stopped = seen(trial, fault_ns)
    assert stopped.stop_ns is not None
    assert stopped.stop_ns < LATE_NS
    assert stopped.motion_after == 0
    stays(trial, "driver.c", driver.pid)


def test_an_abandoned_handle_takes_back_the_motion_that_it_enabled_and_did_not_use(
    trial: Trial, driver: Driver
) -> None:
    driver.connect(trial.name)
    assert driver.do("enable -1") == OK
    assert driver.do("abandon") == OK
    assert not trial.robot.state.enabled


THROWING = r"""
#include <failstop.hpp>
#include <cstdio>
#include <stdexcept>

static void work(const char *service, bool fails) {
  failstop::Robot own, robot;
  // What is moved counts from its new place.
  if (!own.open(service, "own.cpp") || !own.connect()) throw std::logic_error(own.last_error());
  robot = std::move(own);
  for (char letter = 0; std::scanf(" %c", &letter) == 1 && letter == 'd';) {
    robot.sensed();
    std::printf("%d\n", robot.drive(0.0, 0.0, 0.0).code());
    std::fflush(stdout);
  }
  if (fails) throw std::runtime_error("it fails");
}

int main(int, char **words) {
  try {
    work(words[1], *words[2] == 'f');
  } catch (const std::runtime_error &) {
    std::puts("caught");
  }
  std::puts("goes on");
  std::fflush(stdout);
  while (std::getchar() != EOF) continue;
}
"""


@pytest.mark.parametrize("standard", ["c++11", "c++20"])
@pytest.mark.parametrize(("way", "stays_enabled"), [("fails", False), ("returns", True)])
def test_a_c_plus_plus_program_that_catches_an_exception_has_died(
    trial: Trial, tmp_path: Path, standard: str, way: str, stays_enabled: bool
) -> None:
    source = tmp_path / "own.cpp"
    source.write_text(THROWING)
    where = library()
    command = (cpp_compiler(), f"-std={standard}", f"-I{SOURCE}/include", source, "-o", tmp_path / "own")
    subprocess.run((*command, f"-L{where}", "-lfailstop", f"-Wl,-rpath,{where}"), check=True)
    with Driver(command=(str(tmp_path / "own"), trial.name, way)) as driver:
        assert driver.do("d") == OK
        trial.robot.enable()  # whose answer comes after the gate has heard the command
        driver.tell("e")
        answers = [driver.answer() for _ in range(1 if stays_enabled else 2)]
        assert answers[-1] == "goes on"
        wait_for("the slot to be free", lambda: not [c for c in trial.robot.state.clients if c.pid == driver.pid])
        assert trial.robot.state.enabled is stays_enabled
        assert driver.process.poll() is None


def test_a_child_that_lives_on_does_not_hide_the_death_of_its_parent(trial: Trial, driver: Driver) -> None:
    driver.connect(trial.name)
    set_off(trial, driver)
    driver.tell("fork")
    found = re.fullmatch(r"child (\d+) drive=-10 enable=-10 state=-10 connect=-10 stop=0", driver.answer())
    assert found, "nothing of the parent's handle may be used in the child"
    child = int(found[1])
    try:
        assert not os.readlink(f"/proc/{child}/cwd").startswith("/dev/shm")
        held = [os.readlink(f"/proc/{child}/fd/{fd}") for fd in os.listdir(f"/proc/{child}/fd")]
        assert not [path for path in held if path.endswith("/claims") or ".client." in path]
        driver.tell("for -1 0.2")
        assert driver.answer() == "driving"
        trial.board.wait_wheels(turning=True, timeout_s=5.0)
        trial.board.events()
        fault_ns = time.monotonic_ns()
        os.kill(driver.pid, signal.SIGKILL)
        stopped = seen(trial, fault_ns)
        assert stopped.stop_ns is not None
        assert stopped.stop_ns < LATE_NS
        stays(trial, "driver.c", driver.pid)
        os.kill(child, 0)
        wait_for("the slot to be free", lambda: not [c for c in trial.robot.state.clients if c.pid == driver.pid])
    finally:
        os.kill(child, signal.SIGKILL)


def test_the_death_of_a_child_stops_nothing(trial: Trial, driver: Driver) -> None:
    driver.connect(trial.name)
    set_off(trial, driver)
    driver.tell("fork")
    child = int(driver.answer().split()[1])
    driver.tell("for 0.3 0.2")
    time.sleep(0.1)
    os.kill(child, signal.SIGKILL)
    assert driver.answer() == "0"
    assert trial.turning()
    assert trial.robot.state.enabled


def test_a_signal_handler_stops(trial: Trial, driver: Driver) -> None:
    driver.connect(trial.name)
    assert driver.do(f"on-signal {int(signal.SIGUSR1)}") == 0
    set_off(trial, driver)
    driver.tell("for -1 0.2")
    driver.answer()
    trial.board.wait_wheels(turning=True, timeout_s=5.0)
    os.kill(driver.pid, signal.SIGUSR1)
    trial.board.wait_wheels(turning=False, timeout_s=5.0)
    wait_for("the stop to be latched", lambda: trial.robot.state.cause)
    assert "from a signal handler" in str(trial.robot.state.cause)


def test_a_driver_that_hangs_is_waited_for_no_longer_than_its_command_counts(trial: Trial, driver: Driver) -> None:
    driving(trial, driver)
    os.kill(driver.pid, signal.SIGSTOP)
    trial.board.wait_wheels(turning=False, timeout_s=5.0)
    os.kill(driver.pid, signal.SIGKILL)


def test_two_handles_of_a_program_are_two_clients(trial: Trial, driver: Driver) -> None:
    driver.connect(trial.name)
    assert driver.do(f"open {trial.name} 1") == OK
    assert driver.do("connect") == OK
    wait_for("both to be listed", lambda: [one.pid for one in trial.robot.state.clients].count(driver.pid) == 2)
    assert driver.do("use 0") == OK
    set_off(trial, driver)
    assert driver.do("use 1") == OK
    assert driver.do("close") == OK, "of the one that does not drive"
    assert driver.do("use 0") == OK
    assert driver.do("for 0.2 0.2") == OK
    assert trial.turning()
    fault_ns = time.monotonic_ns()
    os.kill(driver.pid, signal.SIGKILL)
    stopped = seen(trial, fault_ns)
    assert stopped.stop_ns is not None
    assert stopped.stop_ns < LATE_NS
    stays(trial, "driver.c", driver.pid)


def test_the_service_is_told_of_a_death_before_the_memory_is_taken_down(trial: Trial) -> None:
    """By the robust futex: freeing this much takes many times as long as the stop."""
    with Driver(megabytes=300) as driver:
        driving(trial, driver)
        fault_ns = time.monotonic_ns()
        os.kill(driver.pid, signal.SIGKILL)
        stopped = seen(trial, fault_ns)
        assert stopped.stop_ns is not None
        assert stopped.stop_ns < LATE_NS
        assert stopped.motion_after == 0


def test_a_thread_of_the_library_holds_the_notice_and_takes_no_signal(trial: Trial, driver: Driver) -> None:
    before = len(os.listdir(f"/proc/{driver.pid}/task"))
    driver.connect(trial.name)
    threads = {task.name: (task / "comm").read_text().strip() for task in Path(f"/proc/{driver.pid}/task").iterdir()}
    assert list(threads.values()).count("failstop") == 1
    holder = next(task for task, name in threads.items() if name == "failstop")
    with open(f"/proc/{driver.pid}/task/{holder}/status") as status:
        blocked = next(line for line in status if line.startswith("SigBlk:")).split()[1]
    assert int(blocked, 16) & 1 << signal.SIGTERM - 1
    assert driver.do("close") == OK
    assert len(os.listdir(f"/proc/{driver.pid}/task")) == before
