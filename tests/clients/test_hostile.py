"""What a C program, and the service below it, may do to the library. The program closes its descriptors, cancels its
threads, forks while it connects, or unloads it; the service dies while it connects, or its files are damaged."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import time
from pathlib import Path

import pytest

from failstop.api import client
from failstop.messages import layout, segments
from failstop.shm import cell
from failstop_lab.stopped import judge
from failstop_lab.trial import Trial, wait_for
from tests.clients.scene import DAMAGED, INVALID, LATE_NS, NO_ANSWER, NO_SERVICE, OK, SYSTEM, seen, set_off, stays
from tests.support.c_client import SOURCE, Driver, compiled, library
from tests.support.c_client import driver as driver_program


def test_files_that_get_the_numbers_of_closed_descriptors_are_left_alone(
    trial: Trial, driver: Driver, tmp_path: Path
) -> None:
    driver.connect(trial.name)
    assert driver.do("drive 0 0 0") == OK
    own = tmp_path / "own"
    own.write_bytes(bytes(range(256)) * 64)
    before = own.read_bytes()
    assert driver.do(f"close-all-for {own}") == OK
    assert driver.do("drive 0.1 0 0") == NO_SERVICE
    assert driver.do("stop it still works") == OK
    wait_for("the stop to be latched", lambda: trial.robot.state.cause)
    driver.do("close")
    assert own.read_bytes() == before


def test_a_stop_is_not_written_to_a_file_that_got_the_pipe_s_number(
    fresh: Trial, driver: Driver, tmp_path: Path
) -> None:
    """Nor does a new connection take the number from that file. It is the first, because the pipe is opened first."""
    driver.connect(fresh.name)
    own = tmp_path / "own"
    own.write_bytes(b"mine" * 100)
    assert driver.do(f"close-all-for {own}") == OK
    fresh.leave()
    fresh.service.end()
    assert driver.do("stop nobody listens") == NO_SERVICE
    assert own.read_bytes() == b"mine" * 100
    fresh.service.start()
    numbers = own_numbers(driver, own)
    assert driver.do("connect") == OK
    assert own_numbers(driver, own)[0] == numbers[0]
    assert own.read_bytes() == b"mine" * 100


def test_a_pipe_that_gets_the_number_of_the_stop_pipe_is_left_alone(fresh: Trial, driver: Driver) -> None:
    """A stop in it would reach nobody, and a new connection must not put the service's pipe in its place."""
    driver.connect(fresh.name)
    assert driver.do("pipes-instead") == OK
    assert driver.do("stop it still works") == OK
    wait_for("the stop to be latched", lambda: fresh.robot.state.cause)
    fresh.leave()
    fresh.service.end()
    assert driver.do("stop nobody listens") == NO_SERVICE
    assert driver.do("in-pipes") == 0
    fresh.service.start()
    assert driver.do("connect") == OK
    assert driver.do("in-pipes") == 0
    assert driver.do("stop again") == OK


def test_a_program_that_closed_its_descriptors_keeps_the_files_that_it_opens_then(
    trial: Trial, driver: Driver, tmp_path: Path
) -> None:
    """A daemon does so: neither a new connection, nor a child, nor the end of the handle closes its files."""
    own = tmp_path / "own"
    own.write_bytes(b"mine" * 100)
    for end in ("connect", "fork-and-look", "close"):
        driver.connect(trial.name)
        assert driver.do("drive 0 0 0") == OK
        assert driver.do(f"close-all-for {own}") == OK
        before = own_numbers(driver, own)
        assert driver.do("drive 0 0 0") == NO_SERVICE
        assert driver.do(end) == OK
        assert own_numbers(driver, own) == before, end
        driver.do("close")
        assert own_numbers(driver, own) == before, end
    assert own.read_bytes() == b"mine" * 100


def own_numbers(driver: Driver, path: Path) -> list[int]:
    folder = f"/proc/{driver.pid}/fd"
    return sorted(int(fd) for fd in os.listdir(folder) if os.readlink(f"{folder}/{fd}") == str(path))


def test_a_cancelled_thread_sends_its_stop(trial: Trial, driver: Driver) -> None:
    driver.connect(trial.name)
    assert driver.do("stop-cancelled") == OK
    wait_for("the stop to be latched", lambda: trial.robot.state.cause)
    assert "of a cancelled thread" in str(trial.robot.state.cause)


def test_a_cancelled_request_leaves_no_lock_behind(fresh: Trial, driver: Driver) -> None:
    driver.connect(fresh.name)
    os.kill(gate := fresh.service.pids()[layout.GATE], signal.SIGSTOP)
    try:
        driver.tell("ask-cancelled")
        done = driver.answer_within(3.0)
    finally:
        with contextlib.suppress(ProcessLookupError):  # its supervisor may have lost patience
            os.kill(gate, signal.SIGCONT)
    assert done == f"{NO_ANSWER} {NO_ANSWER}"


def test_a_child_that_is_forked_meanwhile_holds_no_claim(trial: Trial, driver: Driver) -> None:
    """It would keep the slot from the next program for as long as it lives."""
    driver.connect(trial.name)
    assert driver.do("fork-meanwhile 400") == 0


def test_a_child_drives_by_a_handle_of_its_own(trial: Trial, driver: Driver) -> None:
    driver.connect(trial.name)
    driver.tell("fork-with-own")
    found = re.fullmatch(r"child (\d+) open=0 connect=0 drive=0", driver.answer())
    assert found
    child = int(found[1])
    try:
        trial.robot.enable()
        trial.board.wait_wheels(turning=True, timeout_s=5.0)
        trial.leave()
        trial.board.events()
        fault_ns = time.monotonic_ns()
        os.kill(child, signal.SIGKILL)
        stopped = seen(trial, fault_ns)
        assert stopped.stop_ns is not None
        assert stopped.stop_ns < LATE_NS
        stays(trial, "child", child)
        assert driver.do("drive 0 0 0") == OK, "its parent is a client as before"
    finally:
        os.kill(child, signal.SIGKILL)  # its parent has not collected it


def test_an_unloaded_library_still_drives_and_reports_the_death(trial: Trial, tmp_path: Path) -> None:
    program = compiled(SOURCE / "tests" / "unload.c", tmp_path / "unload", "-ldl")
    command = (program, library() / "libfailstop.so.0", trial.name)
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as run:
        try:
            assert run.stdout
            assert run.stdout.readline() == "unloaded\n"
            trial.robot.enable()
            trial.board.wait_wheels(turning=True, timeout_s=5.0)
            trial.leave()
            trial.board.events()
            fault_ns = time.monotonic_ns()
        finally:
            run.kill()
    stopped = seen(trial, fault_ns)
    assert stopped.stop_ns is not None
    assert stopped.stop_ns < LATE_NS
    assert stopped.motion_after == 0
    stays(trial, "unload", run.pid)


def test_a_constructor_of_a_program_may_open_a_handle_of_the_static_library(trial: Trial, tmp_path: Path) -> None:
    source = tmp_path / "early.c"
    source.write_text(
        "#include <failstop.h>\n#include <stdio.h>\nstatic int opened;\nstatic fs_robot *robot;\n"
        "__attribute__((constructor)) static void early(void) "
        f'{{ opened = fs_open(&robot, "{trial.name}", "early"); }}\n'
        'int main(void) { printf("%d\\n", opened); fs_close(robot); return 0; }\n'
    )
    program = tmp_path / "early"
    command = ("cc", f"-I{SOURCE}/include", "-pthread", "-o", program, source, library() / "libfailstop.a", "-lm")
    subprocess.run(command, check=True)
    done = subprocess.run((program,), capture_output=True, text=True, check=True)
    assert done.stdout == f"{OK}\n"


def test_a_service_whose_supervisor_has_just_died_is_not_connected_to(fresh: Trial, driver: Driver) -> None:
    """Its other processes have the pipes open until they have ended."""
    fresh.leave()
    others = [pid for name, pid in fresh.service.pids().items() if name != layout.SUPERVISOR]
    for pid in others:
        os.kill(pid, signal.SIGSTOP)
    try:
        fresh.service.kill()
        driver.do(f"open {fresh.name} 0")
        assert driver.do("connect") == NO_SERVICE
        assert "is ending: try again" in driver.text("error")
    finally:
        for pid in others:
            os.kill(pid, signal.SIGCONT)
    fresh.service.start()
    wait_for("a connection to the next run", lambda: driver.do("connect") == OK)


def test_an_error_of_an_earlier_connection_is_not_told_again(fresh: Trial, driver: Driver) -> None:
    fresh.leave()
    fresh.service.end()
    assert driver.do(f"open {fresh.name} 0") == NO_SERVICE
    no_service = f"no service named '{fresh.name}' is running: start it with `failstop run --name {fresh.name}`"
    assert driver.text("error") == no_service
    fresh.service.start()
    assert driver.do("connect") == OK
    assert driver.text("error") == ""
    fresh.service.end()
    assert driver.do("drive 0 0 0") == NO_SERVICE
    assert "the service has ended" in driver.text("error")


def test_a_slot_that_is_truncated_under_a_program_does_not_kill_it(fresh: Trial, driver: Driver) -> None:
    trial = fresh
    driver.connect(trial.name)
    set_off(trial, driver)
    slot = next(index for index in range(layout.CLIENT_SLOTS) if holds(trial, driver, index))
    os.truncate(segments.path_of(client.run(trial.name)[0], f"client.{slot}"), 0)
    assert driver.do("for 0.3 0.2") == OK
    assert driver.state()["result"] == OK
    trial.leave()
    trial.board.events()
    fault_ns = time.monotonic_ns()
    os.kill(driver.pid, signal.SIGKILL)
    trial.board.wait_wheels(turning=False, timeout_s=5.0)
    assert judge(trial.board.events(), fault_ns, was_turning=True).motion_after == 0


def holds(trial: Trial, driver: Driver, slot: int) -> bool:
    path = segments.path_of(client.run(trial.name)[0], f"client.{slot}")
    return any(os.path.realpath(f"/proc/{driver.pid}/fd/{fd}") == path for fd in os.listdir(f"/proc/{driver.pid}/fd"))


def test_a_record_that_is_longer_than_its_place_is_damage(fresh: Trial, driver: Driver) -> None:
    memory, _ = client.run(fresh.name)
    spec = layout.SEGMENT_BY_NAME[layout.SUPERVISOR]
    record, at = spec.records["rules"], spec.offsets["rules"]
    size = cell.cell_bytes(record.capacity)
    longest = size - cell.CELL_HEADER_BYTES
    assert longest > record.capacity, "the cell has room for it"
    seed = cell.seed("supervisor.rules", int(memory.rpartition(".")[2], 16))
    with open(segments.path_of(memory, layout.SUPERVISOR), "r+b") as file:
        file.seek(at)
        both = file.read(2 * size)
        known = max(filter(None, (cell.check(both[:size], seed), cell.check(both[size:], seed))))
        number = known[0] + 1
        file.seek(at + number % 2 * size)
        file.write(cell.build(number, known[1], known[2].ljust(longest, b"\0"), seed, longest))
    assert driver.do(f"open {fresh.name} 0") == DAMAGED
    assert driver.do("stop it") == OK


def test_what_a_program_prints_without_its_standard_streams_reaches_nothing_of_the_service(
    trial: Trial, tmp_path: Path
) -> None:
    """As a daemon that has closed them: the next file that is opened gets their numbers."""
    source = tmp_path / "daemon.c"
    source.write_text(
        "#include <failstop.h>\n#include <fcntl.h>\n#include <stdio.h>\n#include <unistd.h>\n"
        "int main(void) {\n"
        "  fs_robot *robot, *other;\n"
        "  for (int fd = 0; fd < 3; fd++) close(fd);\n"
        f'  if (fs_open(&robot, "{trial.name}", "daemon") || fs_connect(robot)) return 10;\n'
        f'  if (fs_open(&other, "{trial.name}", "other") || fs_connect(other)) return 11;\n'
        "  fs_drive(robot, 0, 0, 0);\n"
        "  for (int fd = 0; fd < 3; fd++) if (fcntl(fd, F_GETFD) >= 0) return 1 + fd;\n"
        '  printf("on my way\\n"), fflush(stdout), perror("daemon");\n'
        "  fs_close(other), fs_close(robot);\n"
        "  return 0;\n}\n"
    )
    done = subprocess.run((compiled(source, tmp_path / "daemon"),), check=False)
    assert done.returncode == 0
    assert trial.robot.state.cause is None


def test_a_program_that_may_not_write_its_slot_is_told_and_lives(trial: Trial) -> None:
    """By default the kernel ends one that writes into a file after its limit."""
    with Driver(command=("sh", "-c", 'ulimit -f 1 && exec "$0" "$@"', str(driver_program()))) as limited:
        assert limited.do(f"open {trial.name} 0") == OK
        assert limited.do("connect") == SYSTEM
        assert "`ulimit -f`" in limited.text("error")
        assert limited.do("stop it") == OK
    wait_for("the stop to be latched", lambda: trial.robot.state.cause)


def test_a_program_without_descriptors_learns_that_its_stop_was_not_sent(fresh: Trial, driver: Driver) -> None:
    """The service was started after the handle was made, which therefore keeps no pipe of it."""
    fresh.leave()
    fresh.service.end()
    assert driver.do(f"open {fresh.name} 0") == NO_SERVICE
    fresh.service.start()
    assert driver.do("stop with descriptors") == OK
    assert driver.do("no-descriptors") == OK
    assert driver.do("stop without") == SYSTEM
    assert driver.do("connect") == SYSTEM


def test_a_program_without_descriptors_stops_by_the_pipe_that_it_keeps(trial: Trial, driver: Driver) -> None:
    driver.connect(trial.name)
    assert driver.do("no-descriptors") == OK
    assert driver.do("stop it still works") == OK
    wait_for("the stop to be latched", lambda: trial.robot.state.cause)


def test_a_program_that_has_another_shm_is_told_and_stops(trial: Trial) -> None:
    """As in a container that shares the service's directory alone."""
    words = ("unshare", "--mount", "sh", "-c", 'mount -t tmpfs none /dev/shm && exec "$0" "$@"', str(driver_program()))
    with Driver(command=words) as apart:
        if os.geteuid():
            pytest.skip("only root may mount")
        assert apart.do(f"open {trial.name} 0") == NO_SERVICE
        assert "does not exist" in apart.text("error")
        assert apart.do("connect") == NO_SERVICE
        assert apart.do("stop it") == OK
    wait_for("the stop to be latched", lambda: trial.robot.state.cause)


def test_numbers_are_those_of_the_service_in_every_locale(trial: Trial, comma: dict[str, str]) -> None:
    with Driver(environment=comma) as german:
        assert german.do("locale") == OK
        german.connect(trial.name)
        assert german.text("setting gate.lease_s") == str(trial.robot.settings["gate.lease_s"])
        assert "." in german.text("setting gate.lease_s")


@pytest.mark.parametrize("size", [0, 8, 65537, -1])
def test_a_state_without_its_size_is_refused(trial: Trial, driver: Driver, size: int) -> None:
    driver.connect(trial.name)
    assert driver.do(f"state-of {size}") == INVALID
    assert driver.do("state-of 4096") == OK
