"""Killing the rest of the control group, on a simulated machine; and what a real /proc says."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator

import pytest

from failstop import stopping
from failstop.lab.machine.kernel import TAKEDOWN_NS
from failstop.lab.machine.loading import File
from failstop.lab.machine.process import Process
from tests.support.stage import MS, PortMachine

OURS = "12:devices:/system.slice\n0::/system.slice/failstop.service\n"
THEIRS = "12:devices:/system.slice\n0::/system.slice/failstop@other.service\n"
PROC = "/groups"
"""A folder in the place of /proc."""
NOBODY = 1 << 22
"""No process has this pid or a larger one."""
SIGKILL = 9


@pytest.fixture
def machine() -> Iterator[PortMachine]:
    made = PortMachine()
    for name in ("self", made.me.pid, "uptime"):
        put(made, name, OURS)
    yield made
    assert made.open_fds() == 0, "no descriptor is left"


def put(machine: PortMachine, name: object, group: str) -> None:
    """The control group of a process."""
    machine.os.makedirs(f"{PROC}/{name}")
    with File(machine.os, cgroup(name), "w", None) as file:
        file.write(group)


def cgroup(name: object) -> str:
    return f"{PROC}/{name}/cgroup"


def start(machine: PortMachine, group: str = OURS) -> Process:
    """A process that lives."""
    made = machine.machine.process("worker", lambda _: machine.machine.block(), parent=machine.me)
    put(machine, made.pid, group)
    return made


def kill(machine: PortMachine, timeout_s: float = 10.0) -> tuple[int, int]:
    found: tuple[int, int] = machine.load("failstop.stopping").kill_rest(timeout_s, PROC)
    return found


def test_the_tool_kills_its_own_group_and_nobody_else(machine: PortMachine) -> None:
    """The stop is written when all of them together have ended."""
    theirs, begun_ns = start(machine, THEIRS), machine.clock()
    assert kill(machine) == (0, 0)
    assert machine.clock() == begun_ns
    ours = [start(machine) for _ in range(6)]
    assert kill(machine) == (6, 0)
    assert [process.code for process in ours] == [-SIGKILL] * 6, "they have ended by the time it returns"
    assert machine.clock() == begun_ns + TAKEDOWN_NS
    assert not theirs.dead


def test_a_worker_in_a_group_for_processors_is_killed_too(machine: PortMachine) -> None:
    """The hierarchies of version 1 are independent of each other."""
    for name in ("self", machine.me.pid):
        put(machine, name, "2:cpuset:/\n1:name=systemd:/system.slice/failstop.service\n0::/\n")
    ours = start(machine, "2:cpuset:/fast\n1:name=systemd:/system.slice/failstop.service\n0::/\n")
    theirs = start(machine, "2:cpuset:/\n1:name=systemd:/system.slice/cron.service\n0::/\n")
    assert kill(machine) == (1, 0)
    assert ours.code == -SIGKILL
    assert not theirs.dead


def test_a_process_that_has_ended_is_not_counted(machine: PortMachine) -> None:
    dead, gone = start(machine), start(machine)
    for process in (dead, gone):
        machine.machine.die(process, 0)
    machine.clock.now_ns += TAKEDOWN_NS
    gone.reaped = True
    put(machine, NOBODY, OURS)
    assert kill(machine) == (0, 0)
    ours = [start(machine) for _ in range(2)]
    put(machine, NOBODY + 1, OURS)
    assert kill(machine) == (2, 0), "they are found among those that have gone"
    assert [process.code for process in ours] == [-SIGKILL] * 2


@pytest.mark.parametrize("becomes", [None, THEIRS])
def test_a_pid_that_is_another_s_by_the_time_it_is_opened_is_not_killed(
    machine: PortMachine, becomes: str | None
) -> None:
    """The pid may be nobody's by then."""
    bystander = start(machine)
    change = machine.os.unlink if becomes is None else lambda _: put(machine, bystander.pid, str(becomes))
    machine.at_next("pidfd_open", lambda: change(cgroup(bystander.pid)))
    assert kill(machine) == (0, 0)
    assert not bystander.dead


def test_a_process_that_was_just_started_is_killed_too(machine: PortMachine) -> None:
    started = [start(machine)]
    machine.at_next("kill", lambda: started.append(start(machine)))
    assert kill(machine) == (2, 0)
    assert [process.code for process in started] == [-SIGKILL] * 2


@pytest.mark.parametrize("refused", [False, True])
def test_a_process_that_does_not_end_is_told_of(machine: PortMachine, refused: bool) -> None:
    def refuse(thread: object, call: str, about: object) -> None:
        if call == "kill":
            raise PermissionError

    stays = start(machine)
    if refused:
        machine.machine.at_seam = refuse
    else:
        stays.dead = True  # and the kernel never takes it down
    begun_ns = machine.clock()
    assert kill(machine, 0.05) == (1, 1)
    assert machine.clock() == begun_ns + 50 * MS


def test_without_its_own_group_nobody_is_killed(machine: PortMachine) -> None:
    bystander = start(machine)
    machine.os.unlink(cgroup("self"))
    with pytest.raises(FileNotFoundError):
        kill(machine)
    assert not bystander.dead


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
def test_the_tool_tells_a_service_from_a_login(machine: PortMachine, group: str, service: bool) -> None:
    put(machine, "self", group)
    assert machine.load("failstop.stopping").of_a_service(PROC) is service


def test_the_real_proc_shows_a_child_and_not_oneself() -> None:
    with subprocess.Popen([sys.executable, "-I", "-S", "-c", "input()"], stdin=subprocess.PIPE) as child:
        found = stopping._others("/proc", stopping._group("/proc", "self"))
        for fd in found.values():
            os.close(fd)
        child.kill()
    assert child.pid in found
    assert os.getpid() not in found
