"""A C client of a real service: it drives, stops and is refused as a Python client is, and the board is the judge."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import threading
import time
from pathlib import Path

import pytest

from failstop import FailstopError, Refused
from failstop.api import client, words
from failstop.messages import layout, segments
from failstop.messages.layout import GATE
from failstop.policy import causes
from failstop.shm import cell
from failstop.shm.segment import HEADER_BYTES
from failstop_lab.trial import Trial, wait_for
from tests.clients.scene import (
    BLOCKED,
    DISABLED,
    DRIVING,
    HELD,
    INVALID,
    NO_ANSWER,
    NO_COMMAND,
    NO_PERMISSION,
    NO_SERVICE,
    NO_SLOT,
    NOT_CONNECTED,
    OK,
    OTHER_LAYOUT,
    PREEMPTED,
    REFUSED,
    UNDECLARED,
    set_off,
)
from tests.support.c_client import SOURCE, Driver, compiled, library
from tests.support.children import NOBODY, needs_root
from tests.support.pages import ROOT, blocks

PAGE = ROOT / "docs" / "c.md"


def test_a_program_drives_and_its_end_stops_the_wheels(trial: Trial, driver: Driver) -> None:
    driver.connect(trial.name)
    wait_for("it to be listed", lambda: trial.robot.state.clients)
    assert trial.robot.state.clients[0].name == "driver.c"
    assert trial.robot.state.clients[0].pid == driver.pid
    assert driver.do("drive 0.2 0 0") == OK
    wait_for("the command to be heard", lambda: driver.state()["answer"] == BLOCKED)
    assert driver.state()["answer_block"] == DISABLED
    trial.robot.enable()
    wait_for("the command to be held", lambda: driver.do("drive 0.2 0 0") or driver.state()["answer_block"] == HELD)
    assert driver.text("why") == "commanded before motion was enabled: send zero or pause, then drive"
    wait_for("the zero to be heard", lambda: driver.do("drive 0 0 0") or driver.state()["answer_block"] != HELD)
    wait_for("the wheels to turn", lambda: driver.do("for 0.05 0.2") or trial.turning())
    assert driver.state()["answer"] == DRIVING
    assert driver.do("close") == OK
    trial.board.wait_wheels(turning=False, timeout_s=5.0)
    state = trial.robot.state
    assert (state.enabled, state.cause) == (True, None), "it said goodbye, and somebody else had enabled motion"


def test_a_silent_program_does_not_drive_as_long_as_another_one_does(
    trial: Trial, driver: Driver, other: Driver
) -> None:
    """Both use the same source, whose command is then the other program's."""
    driver.connect(trial.name)
    other.connect(trial.name)
    assert driver.do("drive 0 0 0") == OK
    trial.robot.enable()
    wait_for("the wheels to turn", lambda: driver.do("for 0.05 0.2") or trial.turning())
    assert driver.do("drive 0 0 0") == OK
    wait_for("it to be too old", lambda: driver.state()["answer"] == BLOCKED)
    assert driver.state()["answer_block"] == NO_COMMAND
    assert driver.text("why") == "no program sends commands"
    other.tell("for 1.5 -0.1")
    wait_for("the other one to drive", lambda: driver.state()["answer"] == PREEMPTED)
    assert driver.text("why") == f"driver.c (pid {other.pid}) drives, and this program sends no commands"
    assert other.answer()
    wait_for("the other one to be silent", lambda: driver.state()["answer"] == BLOCKED)
    assert driver.state()["answer_block"] == NO_COMMAND


@pytest.mark.parametrize(("keep", "enabled"), [(False, False), (True, True)])
def test_a_program_takes_back_the_motion_that_it_enabled(
    trial: Trial, driver: Driver, keep: bool, enabled: bool
) -> None:
    driver.connect(trial.name)
    assert driver.do("enable -1") == OK
    assert trial.robot.state.enabled
    if keep:
        assert driver.do("keep") == OK
    assert driver.do("close") == OK
    assert trial.robot.state.enabled is enabled


def test_motion_that_somebody_else_has_enabled_since_is_not_taken_back(trial: Trial, driver: Driver) -> None:
    driver.connect(trial.name)
    assert driver.do("enable -1") == OK
    trial.robot.disable()
    trial.robot.enable()
    assert driver.do("close") == OK
    assert trial.robot.state.enabled


def test_a_stop_latches_and_the_words_are_python_s(trial: Trial, driver: Driver) -> None:
    driver.connect(trial.name)
    set_off(trial, driver)
    assert driver.do("stop hand near wheel") == OK
    trial.board.wait_wheels(turning=False, timeout_s=5.0)
    wait_for("the stop to be latched", lambda: trial.robot.state.cause)
    cause = trial.robot.state.cause
    assert cause == causes.REQUESTED("hand near wheel", "driver.c", driver.pid)
    assert (driver.state()["latched"], driver.state()["cause"]) == (1, cause.kind.number)
    assert driver.text("why") == str(cause)
    epoch = int(driver.state()["epoch"])
    assert driver.do("enable -1") == REFUSED
    with pytest.raises(Refused) as refused:
        trial.robot.enable()
    assert driver.text("error") == refused.value.reason
    assert driver.do(f"reset {epoch - 1}") == REFUSED, "of an earlier stop"
    assert driver.do(f"reset {epoch}") == OK
    assert trial.robot.state.cause is None
    assert driver.state()["latched"] == 0


def test_what_a_person_should_type_names_the_service(trial: Trial, driver: Driver) -> None:
    """A computer may have several services, and the same command without the name is for the default one."""
    driver.connect(trial.name)
    trial.leave()
    client.send_stop(trial.name, "the arm", "test", row=causes.ROS_ARM_NOT_HELD.name)
    wait_for("the stop to be latched", lambda: driver.state()["latched"])
    remedy = words.named(causes.ROS_ARM_NOT_HELD.remedy, trial.name)
    assert f"`failstop status --name {trial.name}`" in remedy
    assert driver.text("remedy") == remedy


def test_a_request_need_not_be_waited_for(trial: Trial, driver: Driver) -> None:
    driver.connect(trial.name)
    assert driver.do("enable 0") == OK
    wait_for("motion to be enabled", lambda: trial.robot.state.enabled)
    assert driver.do("disable 0") == OK
    wait_for("motion to be disabled", lambda: not trial.robot.state.enabled)


def test_nothing_moves_by_a_command_that_is_no_number(trial: Trial, driver: Driver) -> None:
    driver.connect(trial.name)
    set_off(trial, driver)
    for line in ("drive nan 0 0", "drive 0 inf 0", "drive 0 0 -inf", "wheels 4 1 1 nan 1", "wheels 3 1 1 1 1"):
        assert driver.do(line) == INVALID
    trial.board.wait_wheels(turning=False, timeout_s=5.0)  # by the command's timeout
    assert trial.robot.state.cause is None


def test_sources_and_interlocks_are_those_of_the_settings(trial: Trial, driver: Driver) -> None:
    driver.connect(trial.name)
    assert driver.do("as cmd_vel 0 0 0 0") == OK
    assert driver.do("as nobody 0 0 0 0") == UNDECLARED
    assert driver.do("assert nothing") == UNDECLARED
    for key, value in trial.robot.settings.items():
        assert driver.text(f"setting {key}") == str(value)
    assert driver.do("setting no.such") == UNDECLARED


def test_without_a_slot_it_reads_and_stops(trial: Trial, driver: Driver) -> None:
    assert driver.do(f"open {trial.name} 0") == OK
    assert driver.do("drive 0.1 0 0") == NOT_CONNECTED
    assert driver.do("enable -1") == NOT_CONNECTED
    assert "fs_connect()" in driver.text("error")
    assert driver.state()["ready"] == 1
    assert driver.do("stop no slot") == OK
    wait_for("the stop to be latched", lambda: driver.state()["latched"])


def test_a_service_that_does_not_run_is_named(driver: Driver) -> None:
    assert driver.do("open nobody-there 0") == NO_SERVICE
    assert "`failstop run --name nobody-there`" in driver.text("error")
    assert driver.state()["result"] == NO_SERVICE
    assert driver.do("connect") == NO_SERVICE
    assert driver.do("stop anybody") == NO_SERVICE
    assert driver.do("close") == OK
    assert driver.do("open NO/NAME 1") == INVALID


def test_all_slots_are_taken_and_given_back(trial: Trial, driver: Driver) -> None:
    trial.leave()
    for number in range(layout.CLIENT_SLOTS - 1):
        assert driver.do(f"open {trial.name} {number}") == OK
        assert driver.do("connect") == OK
    with Driver() as other:
        other.connect(trial.name)
        driver.do(f"open {trial.name} 7")
        assert driver.do("connect") == NO_SLOT
        assert f"`failstop status --name {trial.name}`" in driver.text("error")
        with pytest.raises(FailstopError) as full:
            trial.robot.assert_interlocks()
        assert str(full.value) == driver.text("error")
    wait_for("its slot to be free", lambda: driver.do("connect") == OK)


def test_a_restarted_service_is_followed_by_a_new_connection(fresh: Trial, driver: Driver) -> None:
    driver.connect(fresh.name)
    set_off(fresh, driver)
    fresh.leave()
    fresh.service.kill()
    wait_for("the run to be over", lambda: driver.do("drive 0.2 0 0") == NO_SERVICE)
    fresh.board.wait_wheels(turning=False, timeout_s=5.0)
    assert driver.state()["result"] == NO_SERVICE
    assert driver.state()["enabled"] == 0
    fresh.service.start()
    assert driver.do("drive 0.2 0 0") == NO_SERVICE, "of the run before"
    assert driver.do("connect") == OK
    assert driver.do("for 0.2 0.2") == OK
    assert not fresh.turning()
    assert driver.state()["enabled"] == 0
    set_off(fresh, driver)


def test_a_request_to_a_gate_that_hangs_is_not_waited_for_long(fresh: Trial, driver: Driver) -> None:
    driver.connect(fresh.name)
    os.kill(gate := fresh.service.pids()[GATE], signal.SIGSTOP)
    try:
        assert driver.do("disable 0.05") == NO_ANSWER
        assert f"`failstop status --name {fresh.name}`" in driver.text("error")
    finally:
        os.kill(gate, signal.SIGCONT)


@needs_root
def test_another_user_may_stop_but_not_drive(trial: Trial) -> None:
    """The library and the program must be readable to that user."""
    program = compiled(SOURCE / "tests" / "driver.c", Path(os.environ["FAILSTOP_ROOT"]) / "driver")
    run = subprocess.Popen(
        (program, "0"),
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1, user=NOBODY, group=NOBODY, extra_groups=[],
    )  # fmt: skip
    answers, _ = run.communicate(f"open {trial.name} 0\nconnect\nerror\nstate\nstop by nobody\n", timeout=10)
    opened, connected, error, state, stopped = answers.splitlines()
    assert (opened, connected, stopped) == ("0", str(NO_PERMISSION), "0")
    assert "may stop" in error
    assert "group `failstop`" in error
    assert state.startswith("0 ")
    wait_for("the stop to be latched", lambda: trial.robot.state.cause)


def of_another_layout(run: str, version: bytes) -> None:
    """Change the header of a run's segment, as a service of another version would have made it."""
    with open(segments.path_of(run, layout.SUPERVISOR), "r+b") as file:
        seed = cell.seed("header", 0)
        found = cell.check(file.read(HEADER_BYTES), seed)
        assert found
        *rest, known, _ = segments.SEGMENT_HEADER.unpack(found[2])
        header = segments.SEGMENT_HEADER.pack(*rest, known ^ 1, version)
        file.seek(0)
        file.write(cell.build(1, 0, header, seed, HEADER_BYTES - cell.CELL_HEADER_BYTES))


def test_a_library_of_another_layout_says_so_and_stops(fresh: Trial, driver: Driver) -> None:
    of_another_layout(client.run(fresh.name)[0], b"9.8.7")
    assert driver.do(f"open {fresh.name} 0") == OTHER_LAYOUT
    assert "failstop 9.8.7" in driver.text("error")
    assert driver.do("connect") == OTHER_LAYOUT
    assert driver.do("stop it") == OK
    wait_for("the stop to be latched", lambda: fresh.robot.state.cause)


def test_a_service_that_is_upgraded_under_a_program_is_told_once_and_still_stopped(
    fresh: Trial, driver: Driver
) -> None:
    """Its commands return one thing, and a new connection says which versions don't fit."""
    driver.connect(fresh.name)
    set_off(fresh, driver)
    fresh.leave()
    fresh.service.end()
    assert {driver.do("drive 0.2 0 0") for _ in range(20)} == {NO_SERVICE}
    fresh.service.start()
    of_another_layout(client.run(fresh.name)[0], b"9.8.7")
    assert driver.do("for 0.1 0.2") == NO_SERVICE
    assert driver.do("connect") == OTHER_LAYOUT
    error = driver.text("error")
    assert "failstop 9.8.7" in error
    assert "start the service and this program again" in error
    assert driver.do("drive 0.2 0 0") == NOT_CONNECTED
    assert driver.state()["result"] == OTHER_LAYOUT
    assert not fresh.turning()
    assert driver.do("stop after the upgrade") == OK
    wait_for("the stop to be latched", lambda: fresh.robot.state.cause)
    assert "after the upgrade" in str(fresh.robot.state.cause)


def test_wheel_speeds_drive_the_base_that_has_them(trial: Trial, driver: Driver) -> None:
    driver.connect(trial.name)
    driver.do("drive 0 0 0")
    trial.robot.enable()
    speeds = (2.0, 2.0, 2.0, 2.0)

    def turns() -> bool:
        driver.do("sensed")
        driver.do(f"wheels 4 {' '.join(map(str, speeds))}")
        time.sleep(0.02)
        return trial.robot.state.wheels_radps == pytest.approx(speeds, rel=1e-6)

    wait_for("the wheels to turn so", turns)
    assert trial.turning()


def of_the_page(language: str, words: str) -> str:
    """The one program of docs/c.md in this language that has these words."""
    (found,) = (block.text for block in blocks(PAGE) if block.language == language and words in block.text)
    return found


def test_the_example_of_the_page_drives(trial: Trial, tmp_path: Path) -> None:
    source = SOURCE / "examples" / "patrol.c"
    own = tmp_path / "patrol.c"
    own.write_text(source.read_text().replace("fs_open(&robot, NULL,", f'fs_open(&robot, "{trial.name}",'))
    patrols(trial, compiled(own, tmp_path / "patrol"))


def test_the_example_of_the_page_in_c_plus_plus_drives(trial: Trial, tmp_path: Path) -> None:
    if not (found := shutil.which("c++")):
        pytest.skip("no C++ compiler here: apt install g++")
    where, own, program = library(), tmp_path / "patrol.cpp", tmp_path / "patrol"
    own.write_text(of_the_page("cpp", "int main").replace("open(nullptr,", f'open("{trial.name}",'))
    command = (found, "-Wall", "-Wextra", "-Werror", f"-I{SOURCE / 'include'}", "-o", program, own)
    linked = (f"-L{where}", "-lfailstop", f"-Wl,-rpath,{where}", "-pthread")
    done = subprocess.run((*command, *linked), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    patrols(trial, program)


CRASHES = """
#include <stdlib.h>

int main(int count, char **words) {
  if (count < 3 || fs_open(&robot, words[1], "crash")) return 1;
  catch_crashes();
  return raise(atoi(words[2]));
}
"""


@pytest.mark.parametrize("number", [signal.SIGABRT, signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL])
def test_the_handler_of_the_page_stops_the_robot_and_the_crash_goes_on(
    trial: Trial, tmp_path: Path, number: int
) -> None:
    own = tmp_path / "crash.c"
    own.write_text(of_the_page("c", "on_crash") + CRASHES)
    program = compiled(own, tmp_path / "crash")
    words = ("sh", "-c", 'ulimit -c 0 && exec "$0" "$@"', program, trial.name, str(int(number)))
    done = subprocess.run(words, check=False)
    assert done.returncode == -number
    wait_for("the stop", lambda: trial.robot.state.cause)
    assert "crashed" in str(trial.robot.state.cause)


def patrols(trial: Trial, program: Path) -> None:
    """It waits for an enable, drives, and says what stopped it."""
    with subprocess.Popen((program,), stdout=subprocess.PIPE, text=True) as run:
        try:
            wait_for("it to connect", lambda: any(client.name == "patrol" for client in trial.robot.state.clients))
            trial.robot.enable()
            trial.board.wait_wheels(turning=True, timeout_s=5.0)
            trial.robot.estop("enough")
            words, _ = run.communicate(timeout=5)
        finally:
            run.kill()
    assert words.startswith("stop request: enough")
    assert run.returncode == 0
    assert not trial.turning()


def test_the_page_has_the_example() -> None:
    page, example = PAGE.read_text(), (SOURCE / "examples" / "patrol.c").read_text()
    assert f"```c\n{example}```" in page
    assert len(example.splitlines()) <= 30


def test_the_example_without_a_service_says_what_to_do(tmp_path: Path) -> None:
    program = compiled(SOURCE / "examples" / "patrol.c", tmp_path / "patrol")
    done = subprocess.run((program,), capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "failstop run" in done.stderr


def test_state_is_read_by_many_threads_while_one_drives(trial: Trial, driver: Driver) -> None:
    """In C by test_threads.c; here, what a state read meanwhile from another process says."""
    driver.connect(trial.name)
    set_off(trial, driver)
    ended = threading.Event()
    with Driver() as other:
        assert other.do(f"open {trial.name} 0") == OK
        driver.tell("for 0.5 0.2")
        seen: list[dict[str, float]] = []
        while not ended.wait(0.01) and len(seen) < 30:
            seen.append(other.state())
        driver.answer()
    assert all(state["result"] == OK for state in seen)
    assert any(state["moving"] for state in seen)
