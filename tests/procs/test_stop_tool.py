"""The stop tool on a simulated machine: what it waits for, what it says, what reaches the board, and how it kills the
rest of the control group; and what a real /proc says."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import termios
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest

from failstop import stop_tool
from failstop.board.kinds import board_of
from failstop.board.rrc import codec
from failstop.board.rrc.board import BOARD
from failstop.board.rrc.burst import BURST
from failstop_lab.machine.kernel import TAKEDOWN_NS
from failstop_lab.machine.loading import File
from failstop_lab.machine.process import Process
from tests.support.arm_settings import SERVOS
from tests.support.ptys import Board
from tests.support.stage import MS, PortMachine, Wire

MOTION = codec.motor_speeds((0.8, 0.8, -0.8, -0.8), 2.0)
UGV = board_of("ugv", 0.08, 0.0)
ABSENT = "/dev/ttyACM1"
START_NS = PortMachine().clock()
Stop = Callable[..., float]


@pytest.fixture
def machine() -> Iterator[PortMachine]:
    made = PortMachine()
    yield made
    assert made.open_fds() == 0, "no descriptor is left"


@pytest.fixture
def refused(machine: PortMachine) -> Any:
    """The error that the tool raises."""
    return machine.load("failstop.board.port").PortError


@pytest.fixture
def said() -> list[str]:
    return []


@pytest.fixture
def stop(machine: PortMachine, said: list[str]) -> Stop:
    """Runs the tool, for so many seconds at most."""

    def stop(wait_s: float = 0.0, path: str = machine.wire.link) -> float:
        tool = machine.load("failstop.stop_tool")
        return float(tool.stop(partial(tool.write, path, BOARD), lambda _: wait_s, said.append)[0])

    return stop


def passed_s(machine: PortMachine) -> float:
    """The time since the machine's start."""
    return (machine.clock() - START_NS) / 1e9


def plug(machine: PortMachine) -> None:
    """A board at the path ABSENT."""
    machine.wire = Wire(machine.machine, 1)


def test_the_tool_writes_the_burst_and_takes_nobody_s_port(machine: PortMachine, stop: Stop, said: list[str]) -> None:
    fd = machine.open(machine.wire)
    fcntl = machine.system["fcntl"]
    fcntl.flock(fd, fcntl.LOCK_EX)
    assert stop(30.0) == 0.0
    assert machine.wire.read() == BURST
    assert (said, passed_s(machine)) == ([], 0.0)
    machine.os.close(fd)


@pytest.mark.parametrize("board", [BOARD, UGV])
def test_the_tool_speaks_as_fast_as_the_board_and_stops_an_arm_behind_the_wheels(
    machine: PortMachine, board: Any
) -> None:
    machine.load("failstop.stop_tool").write(machine.wire.link, board, SERVOS)
    assert machine.wire.read().startswith(board.burst + (board.arm.stops(SERVOS) if board.arm else b""))
    assert machine.wire.port.settings[4:6] == [getattr(termios, f"B{board.port.baud}")] * 2


@pytest.mark.parametrize("held", [True, False])
def test_the_tool_reports_a_service_that_has_the_port(machine: PortMachine, said: list[str], held: bool) -> None:
    tool, fd = machine.load("failstop.stop_tool"), machine.open(machine.wire)
    fcntl = machine.system["fcntl"]
    if held:
        fcntl.flock(fd, fcntl.LOCK_EX)
    assert tool.stop(partial(tool.write, machine.wire.link, BOARD), lambda _: 0.0, said.append)[1] is held
    machine.os.close(fd)
    assert machine.wire.read().startswith(BURST)


def test_how_long_to_try_is_asked_once_after_the_first_try(machine: PortMachine, said: list[str], refused: Any) -> None:
    asked: list[Any] = []
    tool = machine.load("failstop.stop_tool")

    def asks(error: object) -> float:
        asked.append(error)
        return 0.5

    tool.stop(partial(tool.write, machine.wire.link, BOARD), asks, said.append)
    assert asked == []
    with pytest.raises(refused, match="no device"):
        tool.stop(partial(tool.write, ABSENT, BOARD), asks, said.append)
    assert [error.kind for error in asked] == ["absent"]


@pytest.mark.parametrize("wait_s", [0.0, 5.0])
def test_the_tool_gives_up_after_the_wait(machine: PortMachine, stop: Stop, refused: Any, wait_s: float) -> None:
    assert stop_tool.RETRY_S <= 0.2, "it looks often enough"
    with pytest.raises(refused, match=f"no device {ABSENT}") as raised:
        stop(wait_s, ABSENT)
    assert raised.value.kind == "absent"
    assert wait_s <= passed_s(machine) <= (wait_s + stop_tool.RETRY_S + 1e-6 if wait_s else 0.0)


@pytest.mark.parametrize("sent", [True, False])
def test_a_stop_that_another_way_has_sent_is_not_waited_for(machine: PortMachine, said: list[str], sent: bool) -> None:
    """After each failure it is tried, also where the port may not be tried again: a service that holds it can stop."""
    ways: list[str] = []
    waits: list[str] = []
    tool = machine.load("failstop.stop_tool")

    def another(error: Any) -> bool:
        ways.append(error.kind)
        return sent

    def wait(error: Any) -> float:
        waits.append(error.kind)
        return 0.05

    if sent:
        assert tool.stop(partial(tool.write, ABSENT, BOARD), wait, said.append, another) == (0.0, False)
        assert (ways, waits) == (["absent"], [])
    else:
        with pytest.raises(machine.load("failstop.board.port").PortError, match="no device"):
            tool.stop(partial(tool.write, ABSENT, BOARD), wait, said.append, another)
        assert len(ways) > 1
        assert (set(ways), waits) == ({"absent"}, ["absent"])


def test_a_port_that_a_user_s_file_names_is_opened_with_that_user_s_rights(machine: PortMachine) -> None:
    """What these rights are is in tests/board/test_named.py. Without such a file nobody is asked."""
    tool, opened = machine.load("failstop.stop_tool"), []
    opens = tool.open_port

    def noting(path: str, *, named_by: int, **given: Any) -> int:
        opened.append((named_by, given["exclusive"]))
        return int(opens(path, **given))

    tool.open_port = noting
    link = machine.wire.link
    for by in ({}, {"named_by": 1000}):
        tool.write(link, BOARD, **by)
        tool.answered(link, BOARD, patient=False, **by)
    assert opened == [(0, False)] * 2 + [(1000, False)] * 2


@pytest.fixture
def asked(machine: PortMachine) -> list[tuple[float, bool]]:
    """When a board was asked whether it hears, in seconds, and whether after one more stop; it answers nothing."""
    found: list[tuple[float, bool]] = []

    def ask(tap: Any, board: Any, *, stop: bool) -> None:
        found.append((passed_s(machine), stop))

    machine.load("failstop.board.asking").ask = ask
    return found


@pytest.mark.parametrize(
    ("kind", "patient", "resets"), [("rrc", True, False), ("ugv", True, True), ("ugv", False, False)]
)
def test_a_board_that_opening_its_port_resets_is_stopped_and_asked_again_once_it_hears(
    machine: PortMachine, asked: list[tuple[float, bool]], kind: str, patient: bool, resets: bool
) -> None:
    board = board_of(kind, 0.08, 0.0)
    tool = machine.load("failstop.stop_tool")
    assert tool.answered(machine.wire.link, board, patient=patient) is False
    waits_s = [stop_tool.OLDER_S, stop_tool.OLDER_S + board.port.deaf_ns / 1e9][: 1 + resets]
    assert [at_s for at_s, _ in asked] == pytest.approx(waits_s, rel=2e-10), "to the nanosecond"
    assert [stop for _, stop in asked] == [False, True][: 1 + resets]


@pytest.mark.parametrize("turn", [1, 2, 3])
def test_a_board_has_answered_whenever_it_did(machine: PortMachine, turn: int) -> None:
    answers = [3.1 if turn == at else None for at in (1, 2)]
    machine.load("failstop.board.asking").ask = lambda tap, board, *, stop: answers.pop(0)
    assert machine.load("failstop.stop_tool").answered(machine.wire.link, UGV, patient=True) is (turn < 3)


def test_what_the_board_has_sent_before_it_was_asked_answers_nothing(machine: PortMachine) -> None:
    left: list[bytes] = []

    def ask(tap: Any, board: Any, *, stop: bool) -> None:
        left.append(bytes(machine.wire.port.came))

    machine.load("failstop.board.asking").ask = ask
    for after_s in (0.04, 0.04 + UGV.port.deaf_ns / 1e9):
        machine.after(round(after_s * 1000) * MS, lambda: machine.wire.port.send(b"an answer to the service"))
    machine.load("failstop.stop_tool").answered(machine.wire.link, UGV, patient=True)
    assert left == [b"", b""]


def test_whether_it_answers_is_unknown_where_a_service_reads_or_nothing_can_be_asked(
    machine: PortMachine, asked: list[tuple[float, bool]]
) -> None:
    tool, link = machine.load("failstop.stop_tool"), machine.wire.link
    mute: Any = board_of("ugv", 0.08, 0.0)
    mute.pings, mute.echo_ns = (), 0
    assert tool.answered(ABSENT, mute, patient=True) is None
    assert tool.answered(ABSENT, BOARD, patient=True) is False
    fd = machine.open(machine.wire)
    fcntl = machine.system["fcntl"]
    fcntl.flock(fd, fcntl.LOCK_EX)
    assert tool.answered(link, BOARD, patient=True) is None
    machine.os.close(fd)
    assert asked == []
    machine.after(20 * MS, machine.wire.unplug)
    assert tool.answered(link, BOARD, patient=True) is False, "it goes before it is asked"


def test_the_tool_warns_once_after_a_second(machine: PortMachine, stop: Stop, said: list[str]) -> None:
    machine.after(990 * MS, lambda: said.append("- 0.99 s -"))
    machine.after(1_050 * MS, lambda: said.append("- 1.05 s -"))
    machine.after(6_000 * MS, lambda: plug(machine))
    assert stop(30.0, ABSENT) == pytest.approx(6.0, abs=stop_tool.RETRY_S + 1e-6)
    expected = f"no device {ABSENT}: plug the board in, or name another with --device; trying for 30 s"
    assert said == ["- 0.99 s -", expected, "- 1.05 s -"]
    assert machine.wire.read() == BURST, "soon after it is back"


@pytest.mark.parametrize("error", [(errno.EBUSY, "busy"), (errno.EACCES, "permission"), (errno.EMFILE, "io")])
def test_other_obstacles_are_waited_for(machine: PortMachine, error: tuple[int, str], stop: Stop, refused: Any) -> None:
    def refuse(thread: object, call: str, about: object) -> None:
        if call == "open":
            raise OSError(error[0], os.strerror(error[0]))

    machine.machine.at_seam = refuse
    with pytest.raises(refused) as raised:
        stop()
    assert raised.value.kind == error[1]
    machine.after(2_000 * MS, lambda: setattr(machine.machine, "at_seam", None))
    assert stop(30.0) == pytest.approx(2.0, abs=stop_tool.RETRY_S + 1e-6)
    assert machine.wire.read() == BURST


@pytest.mark.parametrize("holds", ["bytes of others", "its own"])
def test_a_port_that_takes_none_says_power_switch(machine: PortMachine, stop: Stop, refused: Any, holds: str) -> None:
    port = machine.wire.port
    if holds == "its own":  # which are no stop while the kernel has them
        port.under_way = 59
        machine.after(50 * MS, lambda: setattr(port, "under_way", 0))
        assert stop() >= 0.0
        assert passed_s(machine) >= 0.05
        port.under_way = 59
    else:
        machine.wire.fill()
    begun_s = passed_s(machine)
    with pytest.raises(refused, match="takes no bytes: use the POWER SWITCH") as raised:
        stop()
    assert raised.value.kind == "io"
    assert passed_s(machine) - begun_s == pytest.approx(0.1, abs=0.01)


@pytest.mark.parametrize(("drains_s", "wait_s", "told"), [(0.05, 0.0, 0), (3.0, 30.0, 1)])
def test_a_full_port_is_tried_for_as_long_as_it_may_wait_and_gets_the_whole_burst(
    machine: PortMachine, stop: Stop, said: list[str], drains_s: float, wait_s: float, told: int
) -> None:
    machine.wire.fill()
    machine.after(round(drains_s * 1000) * MS, machine.wire.port.drain)
    assert stop(wait_s) <= drains_s + 0.1 + stop_tool.RETRY_S + 0.01
    assert passed_s(machine) >= drains_s
    came = machine.wire.read()
    assert came.endswith(BURST)
    assert not any(came[: -len(BURST)]), "what filled it, unless a close has dropped that"
    assert len(said) == told
    assert all("POWER SWITCH" in text for text in said)


def test_a_device_that_goes_away_while_writing_is_told(machine: PortMachine, stop: Stop, refused: Any) -> None:
    machine.wire.fill()
    machine.after(20 * MS, machine.wire.unplug)
    with pytest.raises(refused, match="went away while writing") as raised:
        stop()
    assert (raised.value.kind, raised.value.errno) == ("io", errno.EIO)


def test_something_that_is_no_port_is_refused(machine: PortMachine, stop: Stop, refused: Any) -> None:
    path = "/dev/file"
    machine.os.close(machine.os.open(path, os.O_CREAT | os.O_WRONLY))
    with pytest.raises(refused) as raised:
        stop(path=path)
    assert raised.value.kind == "not-a-tty"
    assert machine.os.stat(path).st_size == 0


@pytest.mark.parametrize("cut", [1, 31, 32, 58, 59, 300, 396])
def test_a_burst_that_is_taken_in_pieces_is_written_to_its_end(machine: PortMachine, cut: int, stop: Stop) -> None:
    rooms = [cut, 0, *[8] * len(BURST)]

    def take(thread: object, call: str, about: object) -> None:
        if call == "write":
            machine.wire.port.takes(rooms.pop(0))

    machine.wire.receive(MOTION[:15])
    machine.machine.at_seam = take
    stop()
    stream = machine.wire.read()
    assert stream == MOTION[:15] + BURST
    board = Board()
    board.feed(stream)
    assert board.motors.stopped
    assert len(BURST) - len(rooms) == -(-(len(BURST) - cut) // 8), "once each byte is out nothing more is written"


OURS = "12:devices:/system.slice\n0::/system.slice/failstop.service\n"
THEIRS = "12:devices:/system.slice\n0::/system.slice/failstop@other.service\n"
PROC = "/groups"
"""A folder in the place of /proc."""
NOBODY = 1 << 22
"""No process has this pid or a larger one."""
SIGKILL = 9


@pytest.fixture
def grouped() -> Iterator[PortMachine]:
    made = PortMachine()
    for name in ("self", made.me.pid, "uptime"):
        put(made, name, OURS)
    yield made
    assert made.open_fds() == 0, "no descriptor is left"


def put(grouped: PortMachine, name: object, group: str) -> None:
    """The control group of a process."""
    grouped.os.makedirs(f"{PROC}/{name}")
    with File(grouped.os, cgroup(name), "w", None) as file:
        file.write(group)


def cgroup(name: object) -> str:
    return f"{PROC}/{name}/cgroup"


def start(grouped: PortMachine, group: str = OURS) -> Process:
    """A process that lives."""
    made = grouped.machine.process("worker", lambda _: grouped.machine.block(), parent=grouped.me)
    put(grouped, made.pid, group)
    return made


def kill(grouped: PortMachine, timeout_s: float = 10.0) -> tuple[int, int]:
    found: tuple[int, int] = grouped.load("failstop.stop_tool").kill_rest(timeout_s, PROC)
    return found


def test_the_tool_kills_its_own_group_and_nobody_else(grouped: PortMachine) -> None:
    theirs, begun_ns = start(grouped, THEIRS), grouped.clock()
    assert kill(grouped) == (0, 0)
    assert grouped.clock() == begun_ns
    ours = [start(grouped) for _ in range(6)]
    assert kill(grouped) == (6, 0)
    assert [process.code for process in ours] == [-SIGKILL] * 6, "they have ended by the time it returns"
    assert grouped.clock() == begun_ns + TAKEDOWN_NS
    assert not theirs.dead


def test_a_worker_in_a_group_for_processors_is_killed_too(grouped: PortMachine) -> None:
    for name in ("self", grouped.me.pid):
        put(grouped, name, "2:cpuset:/\n1:name=systemd:/system.slice/failstop.service\n0::/\n")
    ours = start(grouped, "2:cpuset:/fast\n1:name=systemd:/system.slice/failstop.service\n0::/\n")
    theirs = start(grouped, "2:cpuset:/\n1:name=systemd:/system.slice/cron.service\n0::/\n")
    assert kill(grouped) == (1, 0)
    assert ours.code == -SIGKILL
    assert not theirs.dead


def test_the_dead_are_not_counted_and_who_was_just_started_is_killed(grouped: PortMachine) -> None:
    dead, gone = start(grouped), start(grouped)
    for process in (dead, gone):
        grouped.machine.die(process, 0)
    grouped.clock.now_ns += TAKEDOWN_NS
    gone.reaped = True
    put(grouped, NOBODY, OURS)
    assert kill(grouped) == (0, 0)
    ours = [start(grouped) for _ in range(2)]
    put(grouped, NOBODY + 1, OURS)
    grouped.at_next("kill", lambda: ours.append(start(grouped)))
    assert kill(grouped) == (3, 0), "they are found among those that have gone"
    assert [process.code for process in ours] == [-SIGKILL] * 3
    bystander = start(grouped)
    grouped.os.unlink(cgroup("self"))
    with pytest.raises(FileNotFoundError):
        kill(grouped)
    assert not bystander.dead, "without its own group nobody is killed"


@pytest.mark.parametrize("becomes", [None, THEIRS])
def test_a_pid_that_is_another_s_when_it_is_opened_is_not_killed(grouped: PortMachine, becomes: str | None) -> None:
    bystander = start(grouped)
    change = grouped.os.unlink if becomes is None else lambda _: put(grouped, bystander.pid, str(becomes))
    grouped.at_next("pidfd_open", lambda: change(cgroup(bystander.pid)))
    assert kill(grouped) == (0, 0)
    assert not bystander.dead


@pytest.mark.parametrize("refused", [False, True])
def test_a_process_that_does_not_end_is_told_of(grouped: PortMachine, refused: bool) -> None:
    def refuse(thread: object, call: str, about: object) -> None:
        if call == "kill":
            raise PermissionError

    stays = start(grouped)
    if refused:
        grouped.machine.at_seam = refuse
    else:
        stays.dead = True  # and the kernel never takes it down
    begun_ns = grouped.clock()
    assert kill(grouped, 0.05) == (1, 1)
    assert grouped.clock() == begun_ns + 50 * MS


SLICE = "/system.slice"
SERVICES = [
    OURS,
    f"0::{SLICE}/system-failstop.slice/failstop@a.service\n",
    f"0::{SLICE}/failstop@a:b.service\n",
    f"1:name=systemd:{SLICE}/failstop.service\n",
    f"1:name=systemd:/\n0::{SLICE}/failstop.service\n",
]
LOGINS = [
    "2:cpuset:/a.service\n1:name=systemd:/\n0::/\n",
    "0::/user.slice/user-1000.slice/session-2.scope\n",
    "0::/user.slice/user-1000.slice/user@1000.service/app.slice/shell.scope\n",
    "0::/\n",
]


@pytest.mark.parametrize("group", [*SERVICES, *LOGINS])
def test_the_tool_tells_a_service_from_a_login(grouped: PortMachine, group: str) -> None:
    put(grouped, "self", group)
    assert grouped.load("failstop.stop_tool").of_a_service(PROC) is (group in SERVICES)


def test_the_real_proc_shows_a_child_and_not_oneself() -> None:
    with subprocess.Popen([sys.executable, "-I", "-S", "-c", "input()"], stdin=subprocess.PIPE) as child:
        found = stop_tool._others("/proc", stop_tool._group("/proc", "self"))
        for fd in found.values():
            os.close(fd)
        child.kill()
    assert child.pid in found
    assert os.getpid() not in found
