"""A descriptor that can be burst on: what the kernel takes, refuses and loses, and what reaches the board."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator

import pytest

from failstop.board import codec, stop_port
from failstop.board.burst import BURST
from failstop.board.stop_port import DRAIN_S, TRIES, StopPort
from tests.support.ptys import Board, Pty, new_pty
from tests.support.stand_ins import Time, before_write

MOTION = codec.motor_speeds((0.8, 0.8, -0.8, -0.8), 2.0)
REFUSED = None
NO_DEVICE = "no device"


class Kernel:
    """Answers each write as planned: so many bytes taken, REFUSED, NO_DEVICE; then takes everything."""

    def __init__(self) -> None:
        self.planned: list[int | str | None] = []
        self.writes = 0

    def write(self, fd: int, data: bytes) -> int:
        self.writes += 1
        answer = self.planned.pop(0) if self.planned else len(data)
        if answer is REFUSED:
            raise BlockingIOError
        if answer == NO_DEVICE:
            raise OSError(errno.EIO, "Input/output error")
        assert isinstance(answer, int)
        return os.write(fd, data[:answer])


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch) -> Kernel:
    made = Kernel()
    before_write(monkeypatch, made.write)
    return made


@pytest.fixture
def pty() -> Iterator[Pty]:
    with new_pty() as made:
        yield made


def test_an_early_stop_is_a_burst_s_beginning_to_the_board(pty: Pty) -> None:
    own, board = StopPort(pty.slave), Board()
    os.write(pty.slave, MOTION)
    own.early_stop()
    data = pty.read()
    assert data == MOTION + BURST[: len(data) - len(MOTION)]
    board.feed(data)
    assert [any(speeds) for _, speeds in board.executed] == [True, False]
    StopPort(-1).early_stop()


WHOLE = len(BURST)


@pytest.mark.parametrize(
    ("planned", "written", "lost", "left"),
    [
        ([], True, False, 0),
        ([REFUSED], True, False, 0),
        ([REFUSED] * (TRIES - 1), True, False, 0),
        ([REFUSED] * TRIES, False, False, WHOLE),
        ([WHOLE - 1], False, False, 1),
        ([1], False, False, WHOLE - 1),
        ([REFUSED, 1], False, False, WHOLE - 1),
        ([NO_DEVICE], False, True, 0),
        ([REFUSED, NO_DEVICE], False, True, 0),
    ],
)
def test_only_what_the_kernel_has_all_of_is_written(
    pty: Pty, kernel: Kernel, planned: list[int | str | None], written: bool, lost: bool, left: int
) -> None:
    own = StopPort(pty.slave)
    kernel.planned = planned
    assert own.burst() is written
    assert (own.lost, own.errno) == ((True, errno.EIO) if lost else (False, 0))
    assert own.unsent == BURST[WHOLE - left :]
    assert pty.read() == (b"" if lost else BURST[: WHOLE - left])


@pytest.mark.parametrize("cut", [0, 1, 31, 58, 59, 396])
@pytest.mark.parametrize("another", [False, True])
def test_the_rest_goes_first_and_the_board_is_stopped(pty: Pty, kernel: Kernel, cut: int, another: bool) -> None:
    own = StopPort(pty.slave)
    os.write(pty.slave, MOTION + MOTION[:15])
    kernel.planned = [cut] if cut else [REFUSED] * TRIES
    own.burst()
    assert own.burst() if another else own.flush()
    assert own.unsent == b""
    stream = pty.read()
    assert stream == MOTION + MOTION[:15] + BURST * (1 + another)
    board = Board()
    board.feed(stream)
    assert board.motors.stopped


def test_the_rest_of_another_frame_is_dropped_for_a_burst(pty: Pty) -> None:
    own = StopPort(pty.slave)
    own.unsent = MOTION[9:]
    assert own.burst()
    assert pty.read() == BURST


def test_nothing_to_go_on_with_writes_nothing(pty: Pty, kernel: Kernel) -> None:
    own = StopPort(pty.slave)
    assert own.flush()
    assert kernel.writes == 0


def test_a_write_that_failed_once_is_no_reason_to_write_no_more(pty: Pty, kernel: Kernel) -> None:
    own = StopPort(pty.slave)
    kernel.planned = [NO_DEVICE]
    assert not own.burst()
    assert own.burst()
    assert not own.lost
    assert pty.read() == BURST


def test_no_port_takes_nothing_and_is_lost(kernel: Kernel) -> None:
    own = StopPort(-1)
    assert own.lost
    assert not own.burst()
    assert not own.drain()
    own.close()
    assert kernel.writes == 0


def test_another_descriptor_takes_the_place_of_the_old_which_is_closed(pty: Pty) -> None:
    with new_pty() as new:
        old = os.dup(pty.slave)
        own = StopPort(old)
        own.lost, own.unsent = True, b"x"
        own.adopt(os.dup(new.slave))
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(old)
        assert (own.lost, own.unsent) == (False, b"")
        assert own.burst()
        assert new.read() == BURST
        kept = own.fd
        own.close()
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(kept)
        assert (own.fd, own.lost) == (-1, True)


@pytest.mark.parametrize(
    ("held", "rest", "drained", "waited_s"),
    [
        ([0], b"", True, 0.0),
        ([1280, 1280, 0], b"", True, 0.001),
        ([1280], b"", False, DRAIN_S),
        ([None], b"", False, 0.0),
        ([0], BURST[-7:], True, 0.0),
    ],
    ids=["nothing", "soon", "never", "gone", "what is left is written first"],
)
def test_what_was_written_is_waited_for_but_not_for_ever(
    pty: Pty, monkeypatch: pytest.MonkeyPatch, held: list[int | None], rest: bytes, drained: bool, waited_s: float
) -> None:
    def unsent_bytes(fd: int) -> int:
        assert fd == pty.slave
        left = held.pop(0) if len(held) > 1 else held[0]
        if left is None:
            raise OSError(errno.EIO, "gone")
        return left

    clock = Time()
    monkeypatch.setattr(stop_port, "time", clock)
    own = StopPort(pty.slave, (), unsent_bytes)
    own.unsent = rest
    assert own.drain() is drained
    assert clock.now_s - 1000.0 == pytest.approx(waited_s, abs=0.002)
    assert own.lost is (held == [None])
    assert pty.read() == rest
