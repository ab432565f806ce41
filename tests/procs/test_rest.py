"""Killing the rest of the control group: real processes, told apart by a /proc of the test's own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop import stopping
from tests.support.ptys import open_fds

OURS = "12:devices:/system.slice\n0::/system.slice/failstop.service\n"
THEIRS = "12:devices:/system.slice\n0::/system.slice/failstop@other.service\n"
SLEEP = "import signal, sys, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print(flush=True); time.sleep(60)"
LATEST_S = 10.0
MOST_PIDS = 1 << 22
"""The kernel gives no process this pid or a larger one."""


class Proc:
    """A directory like /proc, and the processes in it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.processes: list[subprocess.Popen[bytes]] = []
        self.put("self", OURS)
        self.put(str(os.getpid()), OURS)
        (path / "uptime").touch()

    def put(self, name: str, group: str) -> None:
        (self.path / name).mkdir()
        (self.path / name / "cgroup").write_text(group)

    def process(self, group: str = OURS, program: str = SLEEP) -> subprocess.Popen[bytes]:
        """A process that lives, by default, and takes no SIGTERM."""
        made = subprocess.Popen([sys.executable, "-I", "-S", "-c", program], stdout=subprocess.PIPE)
        self.processes.append(made)
        assert made.stdout is not None
        made.stdout.readline()
        self.put(str(made.pid), group)
        return made

    def kill(self, timeout_s: float = LATEST_S) -> tuple[int, int]:
        return stopping.kill_rest(timeout_s, str(self.path))


@pytest.fixture
def proc(tmp_path: Path) -> Iterator[Proc]:
    made = Proc(tmp_path)
    before = open_fds()
    yield made
    assert open_fds() == before + sum(process.stdout is not None for process in made.processes)
    for process in made.processes:
        with process:
            process.kill()


def test_kills_its_own_group_and_nobody_else(proc: Proc) -> None:
    ours, theirs = [proc.process() for _ in range(2)], proc.process(THEIRS)
    assert proc.kill() == (2, 0)
    assert [process.wait(0) for process in ours] == [-signal.SIGKILL] * 2, "they have ended by the time it returns"
    assert theirs.poll() is None


def test_what_people_have_put_into_a_group_for_processors_is_killed_too(proc: Proc) -> None:
    """The hierarchies of version 1 are independent of each other."""
    for name in ("self", str(os.getpid())):
        (proc.path / name / "cgroup").write_text("2:cpuset:/\n1:name=systemd:/system.slice/failstop.service\n0::/\n")
    ours = proc.process("2:cpuset:/fast\n1:name=systemd:/system.slice/failstop.service\n0::/\n")
    theirs = proc.process("2:cpuset:/\n1:name=systemd:/system.slice/cron.service\n0::/\n")
    assert proc.kill() == (1, 0)
    assert ours.wait(0) == -signal.SIGKILL
    assert theirs.poll() is None


def test_alone_there_is_nothing_to_kill(proc: Proc) -> None:
    proc.process(THEIRS)
    start_s = time.monotonic()
    assert proc.kill() == (0, 0)
    assert time.monotonic() - start_s < LATEST_S / 2


def test_what_has_ended_is_not_counted(proc: Proc) -> None:
    dead = proc.process(program="print(flush=True)")
    os.waitid(os.P_PID, dead.pid, os.WEXITED | os.WNOWAIT)
    gone = proc.process()
    gone.kill()
    gone.wait()
    for nobody in range(100):
        proc.put(str(MOST_PIDS + nobody), OURS)
    assert proc.kill() == (0, 0)
    ours = [proc.process() for _ in range(2)]
    for nobody in range(100, 200):  # a directory lists its newest first, or its oldest, or neither
        proc.put(str(MOST_PIDS + nobody), OURS)
    assert proc.kill() == (2, 0), "they are found among those that have gone"
    assert [process.wait(0) for process in ours] == [-signal.SIGKILL] * 2


def test_the_stop_does_not_wait_a_second_more_for_each_worker_that_still_lives(proc: Proc) -> None:
    """It is written when they have ended."""
    for _ in range(6):
        proc.process()
    start_s = time.monotonic()
    assert proc.kill() == (6, 0)
    assert time.monotonic() - start_s < 5.0


@pytest.mark.parametrize("becomes", [None, THEIRS])
def test_a_pid_that_is_another_s_by_the_time_it_is_opened_is_not_killed(
    proc: Proc, monkeypatch: pytest.MonkeyPatch, becomes: str | None
) -> None:
    """Or nobody's."""
    bystander = proc.process()
    real = os.pidfd_open

    def opened(pid: int) -> int:
        group = proc.path / str(pid) / "cgroup"
        if becomes:
            group.write_text(becomes)
        else:
            group.unlink()
        return real(pid)

    monkeypatch.setattr(os, "pidfd_open", opened)
    assert proc.kill() == (0, 0)
    assert bystander.poll() is None


def test_a_process_that_was_just_started_is_killed_too(proc: Proc, monkeypatch: pytest.MonkeyPatch) -> None:
    real = stopping._others
    first = proc.process()

    def starts_one(path: str, group: list[bytes]) -> dict[int, int]:
        found = real(path, group)
        if first.pid in found:
            proc.process()
        return found

    monkeypatch.setattr(stopping, "_others", starts_one)
    assert proc.kill() == (2, 0)
    assert [process.wait(0) for process in proc.processes] == [-signal.SIGKILL] * 2


@pytest.mark.parametrize("fails", [None, PermissionError()])
def test_what_does_not_end_is_told_of(proc: Proc, monkeypatch: pytest.MonkeyPatch, fails: Exception | None) -> None:
    def send(_fd: int, _number: int) -> None:
        if fails:
            raise fails

    proc.process()
    monkeypatch.setattr("_signal.pidfd_send_signal", send)
    start_s = time.monotonic()
    assert proc.kill(0.05) == (1, 1)
    assert 0.05 <= time.monotonic() - start_s < LATEST_S


def test_without_its_own_group_nobody_is_killed(proc: Proc) -> None:
    bystander = proc.process()
    (proc.path / "self" / "cgroup").unlink()
    with pytest.raises(FileNotFoundError):
        proc.kill()
    assert bystander.poll() is None


@pytest.mark.parametrize(
    ("group", "service"),
    [
        (OURS, True),
        ("0::/system.slice/system-failstop.slice/failstop@a.service\n", True),
        ("0::/system.slice/failstop@a:b.service\n", True),
        ("1:name=systemd:/system.slice/failstop.service\n", True),
        ("1:name=systemd:/\n0::/system.slice/failstop.service\n", True),
        ("2:cpuset:/a.service\n1:name=systemd:/\n0::/\n", False),
        ("0::/user.slice/user-1000.slice/session-2.scope\n", False),
        ("0::/user.slice/user-1000.slice/user@1000.service/app.slice/shell.scope\n", False),
        ("0::/\n", False),
    ],
)
def test_tells_a_service_from_a_login(proc: Proc, group: str, service: bool) -> None:
    (proc.path / "self" / "cgroup").write_text(group)
    assert stopping.of_a_service(str(proc.path)) is service


def test_the_real_proc_shows_a_child_and_not_oneself() -> None:
    with subprocess.Popen([sys.executable, "-I", "-S", "-c", SLEEP], stdout=subprocess.PIPE) as child:
        found = stopping._others("/proc", stopping._group("/proc", "self"))
        for fd in found.values():
            os.close(fd)
        child.kill()
    assert child.pid in found
    assert os.getpid() not in found
