"""The stop tool on real ptys with a fake clock: what it waits for, what it says, and what reaches the board."""

from __future__ import annotations

import errno
import os
import termios
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from failstop import stopping
from failstop.board import codec, stop_port
from failstop.board.burst import BURST
from failstop.board.port import PortError, open_port
from tests.support.ptys import Board, Pty, new_pty, open_fds

MOTION = codec.motor_speeds((0.8, 0.8, -0.8, -0.8), 2.0)


class Clock:
    """Stands for the time module: sleeping is what makes time pass, and what is planned happens then."""

    def __init__(self) -> None:
        self.now_s = 1000.0
        self.slept: list[float] = []
        self._planned: list[tuple[float, Callable[[], object]]] = []

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now_s += seconds
        for plan in [plan for plan in self._planned if plan[0] <= self.now_s]:
            self._planned.remove(plan)
            plan[1]()

    def after(self, seconds: float, action: Callable[[], object]) -> None:
        self._planned.append((self.now_s + seconds, action))


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    for module in (stopping, stop_port):
        monkeypatch.setattr(module, "time", made)
    return made


@pytest.fixture
def pty() -> Iterator[Pty]:
    with new_pty() as made:
        yield made


@pytest.fixture(autouse=True)
def no_descriptor_is_left(pty: Pty) -> Iterator[None]:
    before = open_fds()
    yield
    assert open_fds() == before - (pty.master < 0)


@pytest.fixture
def said() -> list[str]:
    return []


def wait(seconds: float) -> Callable[[PortError], float]:
    return lambda _: seconds


def test_writes_the_burst_and_says_how_long_it_took(pty: Pty, clock: Clock, said: list[str]) -> None:
    assert stopping.stop(pty.link, wait(30.0), said.append) == 0.0
    assert pty.read() == BURST
    assert (said, clock.slept) == ([], [])


def test_how_long_to_try_is_asked_once_and_when_the_first_try_has_failed(
    tmp_path: Path, pty: Pty, clock: Clock, said: list[str]
) -> None:
    asked: list[PortError] = []

    def asks(error: PortError) -> float:
        asked.append(error)
        return 0.5

    stopping.stop(pty.link, asks, said.append)
    assert asked == []
    with pytest.raises(PortError, match="no device"):
        stopping.stop(str(tmp_path / "board"), asks, said.append)
    assert [error.kind for error in asked] == ["absent"]
    pty.read()


def test_the_burst_stops_a_board_in_the_middle_of_a_frame(pty: Pty, clock: Clock, said: list[str]) -> None:
    os.write(pty.slave, MOTION + MOTION[:15])
    stopping.stop(pty.link, wait(0.0), said.append)
    board = Board()
    board.feed(pty.read())
    assert board.motors.stopped


def test_a_port_that_somebody_has_stopped_is_started_again(pty: Pty, clock: Clock, said: list[str]) -> None:
    termios.tcflow(pty.slave, termios.TCOOFF)
    stopping.stop(pty.link, wait(0.0), said.append)
    board = Board()
    board.feed(pty.read())
    assert board.motors.stopped


def test_an_absent_device_is_not_waited_for_without_a_wait(tmp_path: Path, clock: Clock, said: list[str]) -> None:
    path = str(tmp_path / "board")
    with pytest.raises(PortError, match=f"no device {path}") as raised:
        stopping.stop(path, wait(0.0), said.append)
    assert raised.value.kind == "absent"
    assert clock.slept == []


def test_a_device_that_comes_back_is_stopped_soon(tmp_path: Path, pty: Pty, clock: Clock, said: list[str]) -> None:
    path = tmp_path / "board"
    clock.after(0.3, lambda: path.symlink_to(pty.link))
    assert stopping.stop(str(path), wait(30.0), said.append) == pytest.approx(0.3, abs=stopping.RETRY_S + 1e-6)
    assert pty.read() == BURST
    assert said == []


def test_looks_often_enough() -> None:
    assert stopping.RETRY_S <= 0.2


def test_gives_up_after_the_wait_with_the_last_reason(tmp_path: Path, clock: Clock, said: list[str]) -> None:
    path = str(tmp_path / "board")
    with pytest.raises(PortError, match="no device"):
        stopping.stop(path, wait(5.0), said.append)
    assert 5.0 <= sum(clock.slept) <= 5.0 + stopping.RETRY_S + 1e-6


def test_warns_once_after_a_second(tmp_path: Path, pty: Pty, clock: Clock, said: list[str]) -> None:
    path = tmp_path / "board"
    clock.after(0.99, lambda: said.append("- 0.99 s -"))
    clock.after(1.05, lambda: said.append("- 1.05 s -"))
    clock.after(6.0, lambda: path.symlink_to(pty.link))
    assert stopping.stop(str(path), wait(30.0), said.append) == pytest.approx(6.0, abs=stopping.RETRY_S + 1e-6)
    expected = f"no device {path}: plug the board in, or name another with --device; trying for 30 s"
    assert said == ["- 0.99 s -", expected, "- 1.05 s -"]


@pytest.mark.parametrize("kind", ["busy", "permission", "io"])
def test_any_other_obstacle_is_waited_for_too(
    pty: Pty, clock: Clock, said: list[str], monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    real = open_port
    free = [False]

    def refuses(path: str, *, exclusive: bool) -> int:
        assert not exclusive, "it takes the port from nobody"
        if free[0]:
            return real(path, exclusive=exclusive)
        raise PortError(kind, f"{path} is held")  # type: ignore[arg-type]

    monkeypatch.setattr(stopping, "open_port", refuses)
    clock.after(2.0, lambda: free.__setitem__(0, True))
    assert stopping.stop(pty.link, wait(30.0), said.append) == pytest.approx(2.0, abs=stopping.RETRY_S + 1e-6)
    assert pty.read() == BURST
    free[0] = False
    with pytest.raises(PortError, match="is held") as raised:
        stopping.stop(pty.link, wait(0.0), said.append)
    assert raised.value.kind == kind


def test_a_port_that_takes_no_bytes_says_power_switch(pty: Pty, clock: Clock, said: list[str]) -> None:
    pty.fill()
    with pytest.raises(PortError, match="takes no bytes: use the POWER SWITCH") as raised:
        stopping.stop(pty.link, wait(0.0), said.append)
    assert raised.value.kind == "io"
    assert sum(clock.slept) == pytest.approx(0.1, abs=0.01)


def test_a_full_port_that_drains_in_time_gets_the_whole_burst(pty: Pty, clock: Clock, said: list[str]) -> None:
    taken = pty.fill()
    found = []
    clock.after(0.05, lambda: found.append(pty.read()))
    stopping.stop(pty.link, wait(0.0), said.append)
    assert b"".join([*found, pty.read()]) == bytes(taken) + BURST


def test_a_full_port_is_tried_again_for_as_long_as_it_may_wait(pty: Pty, clock: Clock, said: list[str]) -> None:
    pty.fill()
    found = []
    clock.after(3.0, lambda: found.append(pty.read()))
    assert stopping.stop(pty.link, wait(30.0), said.append) == pytest.approx(3.0, abs=0.1 + stopping.RETRY_S + 0.01)
    stream = b"".join([*found, pty.read()])
    assert stream.endswith(BURST)
    assert len(said) == 1
    assert "POWER SWITCH" in said[0]


def test_a_device_that_goes_away_while_writing(pty: Pty, clock: Clock, said: list[str]) -> None:
    pty.fill()
    clock.after(0.02, pty.unplug)
    with pytest.raises(PortError, match="went away while writing") as raised:
        stopping.stop(pty.link, wait(0.0), said.append)
    assert (raised.value.kind, raised.value.errno) == ("io", errno.EIO)


def test_something_that_is_no_port_is_refused(tmp_path: Path, clock: Clock, said: list[str]) -> None:
    path = tmp_path / "file"
    path.touch()
    with pytest.raises(PortError) as raised:
        stopping.stop(str(path), wait(0.0), said.append)
    assert raised.value.kind == "not-a-tty"
    assert path.read_bytes() == b""


@pytest.mark.parametrize("cut", [1, 31, 32, 58, 59, 300, 396])
def test_a_burst_that_is_taken_in_pieces_is_written_to_its_end(
    pty: Pty, clock: Clock, said: list[str], monkeypatch: pytest.MonkeyPatch, cut: int
) -> None:
    """As a driver with a small buffer takes it: the first piece, nothing, then a few bytes at a time."""
    rooms = [cut, 0, *[8] * len(BURST)]
    write = os.write

    def taken(fd: int, data: bytes) -> int:
        room = rooms.pop(0)
        if not room:
            raise BlockingIOError
        return write(fd, data[:room])

    os.write(pty.slave, MOTION[:15])
    monkeypatch.setattr(os, "write", taken)
    stopping.stop(pty.link, lambda _: 0.0, said.append)
    monkeypatch.undo()
    stream = pty.read()
    assert stream == MOTION[:15] + BURST
    board = Board()
    board.feed(stream)
    assert board.motors.stopped
    assert len(BURST) - len(rooms) == -(-(len(BURST) - cut) // 8), "once each byte is out nothing more is written"


def test_bytes_that_the_kernel_still_holds_are_no_stop(
    pty: Pty, clock: Clock, said: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    held = [59]
    monkeypatch.setattr(stopping, "unsent_bytes", lambda _: held[0])
    clock.after(0.05, lambda: held.__setitem__(0, 0))
    stopping.stop(pty.link, wait(0.0), said.append)
    assert sum(clock.slept) >= 0.05
    held[0] = 59
    with pytest.raises(PortError, match="takes no bytes"):
        stopping.stop(pty.link, wait(0.0), said.append)
