"""The stop tool on a simulated machine: what it waits for, what it says, and what reaches the board."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from failstop import stopping
from failstop.board import codec
from failstop.board.burst import BURST
from failstop.board.rrc.board import BOARD
from failstop.lab.machine.port import Port
from tests.support.ptys import Board
from tests.support.stage import MS, PortMachine, Wire

MOTION = codec.motor_speeds((0.8, 0.8, -0.8, -0.8), 2.0)
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
        return float(machine.load("failstop.stopping").stop(path, BOARD, lambda _: wait_s, said.append))

    return stop


def passed_s(machine: PortMachine) -> float:
    """The time since the machine's start."""
    return (machine.clock() - START_NS) / 1e9


def plug(machine: PortMachine) -> None:
    """A board at the path ABSENT."""
    machine.wire = Wire(machine.machine, 1)


def test_the_tool_writes_the_burst_and_says_how_long_it_took(machine: PortMachine, stop: Stop, said: list[str]) -> None:
    assert stop(30.0) == 0.0
    assert machine.wire.read() == BURST
    assert (said, passed_s(machine)) == ([], 0.0)


def test_how_long_to_try_is_asked_once_and_when_the_first_try_has_failed(
    machine: PortMachine, said: list[str], refused: Any
) -> None:
    asked: list[Any] = []
    tool = machine.load("failstop.stopping")

    def asks(error: object) -> float:
        asked.append(error)
        return 0.5

    tool.stop(machine.wire.link, BOARD, asks, said.append)
    assert asked == []
    with pytest.raises(refused, match="no device"):
        tool.stop(ABSENT, BOARD, asks, said.append)
    assert [error.kind for error in asked] == ["absent"]


def test_the_burst_stops_a_board_in_the_middle_of_a_frame(machine: PortMachine, stop: Stop) -> None:
    machine.wire.receive(MOTION + MOTION[:15])
    stop()
    board = Board()
    board.feed(machine.wire.read())
    assert board.motors.stopped


def test_the_tool_takes_the_port_from_nobody(machine: PortMachine, stop: Stop) -> None:
    fd = machine.open(machine.wire)
    fcntl = machine.system["fcntl"]
    fcntl.flock(fd, fcntl.LOCK_EX)
    stop()
    assert machine.wire.read() == BURST
    machine.os.close(fd)


def test_a_device_that_comes_back_is_stopped_soon(machine: PortMachine, stop: Stop, said: list[str]) -> None:
    machine.after(300 * MS, lambda: plug(machine))
    assert stop(30.0, ABSENT) == pytest.approx(0.3, abs=stopping.RETRY_S + 1e-6)
    assert machine.wire.read() == BURST
    assert said == []


@pytest.mark.parametrize("wait_s", [0.0, 5.0])
def test_the_tool_gives_up_after_the_wait_with_the_last_reason(
    machine: PortMachine, stop: Stop, refused: Any, wait_s: float
) -> None:
    assert stopping.RETRY_S <= 0.2, "it looks often enough"
    with pytest.raises(refused, match=f"no device {ABSENT}") as raised:
        stop(wait_s, ABSENT)
    assert raised.value.kind == "absent"
    assert wait_s <= passed_s(machine) <= (wait_s + stopping.RETRY_S + 1e-6 if wait_s else 0.0)


def test_the_tool_warns_once_after_a_second(machine: PortMachine, stop: Stop, said: list[str]) -> None:
    machine.after(990 * MS, lambda: said.append("- 0.99 s -"))
    machine.after(1_050 * MS, lambda: said.append("- 1.05 s -"))
    machine.after(6_000 * MS, lambda: plug(machine))
    assert stop(30.0, ABSENT) == pytest.approx(6.0, abs=stopping.RETRY_S + 1e-6)
    expected = f"no device {ABSENT}: plug the board in, or name another with --device; trying for 30 s"
    assert said == ["- 0.99 s -", expected, "- 1.05 s -"]


@pytest.mark.parametrize(
    ("number", "kind"), [(errno.EBUSY, "busy"), (errno.EACCES, "permission"), (errno.EMFILE, "io")]
)
def test_any_other_obstacle_is_waited_for_too(
    machine: PortMachine, number: int, kind: str, stop: Stop, refused: Any
) -> None:
    def refuse(thread: object, call: str, about: object) -> None:
        if call == "open":
            raise OSError(number, os.strerror(number))

    machine.machine.at_seam = refuse
    with pytest.raises(refused) as raised:
        stop()
    assert raised.value.kind == kind
    machine.after(2_000 * MS, lambda: setattr(machine.machine, "at_seam", None))
    assert stop(30.0) == pytest.approx(2.0, abs=stopping.RETRY_S + 1e-6)
    assert machine.wire.read() == BURST


def test_a_port_that_takes_no_bytes_says_power_switch(machine: PortMachine, stop: Stop, refused: Any) -> None:
    machine.wire.fill()
    with pytest.raises(refused, match="takes no bytes: use the POWER SWITCH") as raised:
        stop()
    assert raised.value.kind == "io"
    assert passed_s(machine) == pytest.approx(0.1, abs=0.01)


@pytest.mark.parametrize(("drains_s", "wait_s", "told"), [(0.05, 0.0, 0), (3.0, 30.0, 1)])
def test_a_full_port_is_tried_for_as_long_as_it_may_wait_and_gets_the_whole_burst(
    machine: PortMachine, stop: Stop, said: list[str], drains_s: float, wait_s: float, told: int
) -> None:
    machine.wire.fill()
    machine.after(round(drains_s * 1000) * MS, machine.wire.port.drain)
    assert stop(wait_s) <= drains_s + 0.1 + stopping.RETRY_S + 0.01
    assert passed_s(machine) >= drains_s
    assert machine.wire.read() == bytes(Port.ROOM) + BURST
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
    """As a driver with a small buffer takes it: the first piece, nothing, then a few bytes at a time."""
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


def test_bytes_that_the_kernel_still_holds_are_no_stop(machine: PortMachine, stop: Stop, refused: Any) -> None:
    port = machine.wire.port
    port.under_way = 59
    machine.after(50 * MS, lambda: setattr(port, "under_way", 0))
    stop()
    assert passed_s(machine) >= 0.05
    port.under_way = 59
    with pytest.raises(refused, match="takes no bytes"):
        stop()
