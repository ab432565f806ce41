"""A descriptor that can be burst on: what the kernel takes, refuses and loses, and what reaches the board."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator

import pytest

from failstop.board import stop_port
from failstop.board.interface import SUPERVISOR_ROW
from failstop.board.kinds import board_of
from failstop.board.rrc import codec
from failstop.board.rrc.board import BOARD
from failstop.board.rrc.burst import BURST
from failstop.board.stop_port import DRAIN_S, EARLY_NS, TRIES, StopPort
from failstop.policy.layouts import BOARDS
from failstop.policy.settings import Settings
from tests.support.ptys import Board, Pty, new_pty
from tests.support.stage import MS, PortMachine

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
    monkeypatch.setattr(stop_port, "os", made)
    return made


@pytest.fixture
def pty() -> Iterator[Pty]:
    with new_pty() as made:
        yield made


def test_an_early_stop_is_a_burst_s_beginning_to_the_board(pty: Pty) -> None:
    own, board = StopPort(pty.slave, BOARD), Board()
    os.write(pty.slave, MOTION)
    own.early_stop()
    data = pty.read()
    assert data == MOTION + BURST[: len(data) - len(MOTION)]
    board.feed(data)
    assert [any(speeds) for _, speeds in board.executed] == [True, False]
    StopPort(-1, BOARD).early_stop()


WHOLE = len(BURST)


@pytest.mark.parametrize(
    ("planned", "lost", "left"),
    [
        *(([REFUSED] * times, False, 0) for times in range(TRIES)),
        ([REFUSED] * TRIES, False, WHOLE),
        *(([WHOLE - 1], False, 1), ([1], False, WHOLE - 1), ([REFUSED, 1], False, WHOLE - 1)),
        *(([NO_DEVICE], True, 0), ([REFUSED, NO_DEVICE], True, 0)),
    ],
)
def test_only_what_the_kernel_has_all_of_is_written(
    pty: Pty, kernel: Kernel, planned: list[int | str | None], lost: bool, left: int
) -> None:
    own = StopPort(pty.slave, BOARD)
    kernel.planned = planned
    assert own.burst() is not (lost or left > 0)
    assert (own.lost, own.errno, own.unsent) == (lost, errno.EIO * lost, BURST[WHOLE - left :])
    assert pty.read() == (b"" if lost else BURST[: WHOLE - left])


@pytest.mark.parametrize("cut", [0, 1, 31, 58, 59, 396])
@pytest.mark.parametrize("another", [False, True])
def test_the_rest_goes_first_and_the_board_is_stopped(pty: Pty, kernel: Kernel, cut: int, another: bool) -> None:
    own = StopPort(pty.slave, BOARD)
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


def test_a_burst_drops_the_rest_of_another_frame_and_one_that_failed_is_tried_again(pty: Pty, kernel: Kernel) -> None:
    own = StopPort(pty.slave, BOARD)
    assert own.flush()
    assert kernel.writes == 0, "nothing to go on with"
    own.unsent = MOTION[9:]
    kernel.planned = [NO_DEVICE]
    assert [own.burst(), own.lost] == [False, True]
    own.unsent = MOTION[9:]
    assert [own.burst(), own.lost] == [True, False]
    assert pty.read() == BURST
    writes = kernel.writes
    nowhere = StopPort(-1, BOARD)
    assert [nowhere.lost, nowhere.burst(), nowhere.drain()] == [True, False, False]
    nowhere.close()
    assert kernel.writes == writes, "no port takes nothing"


def test_the_rest_of_another_frame_is_still_one_when_a_part_of_it_has_gone(pty: Pty, kernel: Kernel) -> None:
    own = StopPort(pty.slave, BOARD)
    own.unsent = MOTION[9:]
    kernel.planned = [3]
    assert not own.flush()
    assert own.burst()
    assert pty.read() == MOTION[9:12] + BURST


def test_stops_do_not_pile_up_at_a_port_that_takes_nothing(pty: Pty, kernel: Kernel) -> None:
    own = StopPort(pty.slave, BOARD)
    kernel.planned = [REFUSED] * (2 * TRIES)
    assert [own.burst() for _ in range(3)] == [False, False, True]
    assert pty.read() == BURST


def test_a_last_byte_that_goes_to_no_device_is_not_written(pty: Pty, kernel: Kernel) -> None:
    own = StopPort(pty.slave, BOARD)
    kernel.planned = [WHOLE - 1, NO_DEVICE]
    assert [own.burst(), own.flush()] == [False, False]


class Line:
    """A board that needs silence on its line, and the port to it."""

    def __init__(self, kind: str) -> None:
        self.board = board_of(*Settings({"board.kind": kind}).board())
        self._machine = PortMachine()
        self.wire = self._machine.wire
        fd = self._machine.open(self.wire)
        self.own = self._machine.load("failstop.board.stop_port").StopPort(fd, self.board)
        self.begun_ns = self._machine.clock()
        self.ended_ns = self.begun_ns + len(self.board.burst) * self.board.port.byte_ns
        """When a stop that is written at once has left the line."""

    def bursts(self, at_ns: int) -> bytes:
        """The bytes that burst() writes at this time."""
        self._machine.clock.now_ns = at_ns
        assert self.own.burst()
        return self.wire.read()

    def early(self, at_ns: int) -> bytes:
        """The bytes that the thread writes when it learns of a death."""
        self._machine.clock.now_ns = at_ns
        self.own.early_stop()
        return self.wire.read()

    def replug(self) -> None:
        """Another port is handed over."""
        self.wire = self.wire.replug()
        self.own.adopt(self._machine.open(self.wire))


def test_a_stop_is_not_written_into_one_that_is_still_on_the_line() -> None:
    line = Line("hoverboard")
    silent_ns = line.ended_ns + line.board.after_ns
    assert line.bursts(line.begun_ns) == line.board.burst
    assert line.own.free_ns == line.ended_ns + line.board.idle_ns
    assert [line.bursts(silent_ns - 1), line.early(silent_ns - 1)] == [b"", b""]
    assert line.bursts(silent_ns) == line.board.burst


def test_nothing_is_on_the_line_of_a_port_that_has_gone() -> None:
    line = Line("hoverboard")
    assert line.bursts(line.begun_ns) == line.board.burst
    line.wire.unplug()
    assert [line.own.holds(), line.own.lost, line.own.burst()] == [False, True, False]


def test_another_descriptor_has_nothing_on_its_line() -> None:
    line = Line("hoverboard")
    assert line.bursts(line.begun_ns) == line.board.burst
    line.replug()
    assert line.bursts(line.begun_ns) == line.board.burst


@pytest.mark.parametrize("kind", ["arduino", "hoverboard"])
def test_the_loop_does_not_write_again_what_the_early_stop_has_just_written(kind: str) -> None:
    line = Line(kind)
    assert line.early(line.begun_ns) == line.board.burst
    assert line.bursts(line.begun_ns + EARLY_NS - 1) == b""
    assert line.bursts(line.begun_ns + EARLY_NS) == line.board.burst


def test_the_bytes_of_two_writes_follow_each_other_on_the_line() -> None:
    line = Line("arduino")
    bytes_ns = line.ended_ns - line.begun_ns
    for count, at_ns in ((1, 0), (2, 0), (3, bytes_ns)):
        assert line.bursts(line.begun_ns + at_ns) == line.board.burst
        assert line.own.free_ns == line.begun_ns + count * bytes_ns + line.board.idle_ns
    late_ns = line.own.free_ns
    assert line.bursts(late_ns) == line.board.burst
    assert line.own.free_ns == late_ns + bytes_ns + line.board.idle_ns


def test_another_descriptor_takes_the_place_of_the_old_which_is_closed(pty: Pty) -> None:
    with new_pty() as new:
        old = os.dup(pty.slave)
        own = StopPort(old, BOARD)
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
    ("held", "free_after_ms", "rest", "gone", "waited_ms"),
    [
        *((0, None, b"", False, 0), (1280, 1, b"", False, 1), (1, None, b"", False, round(DRAIN_S * 1000))),
        *((0, None, BURST[-7:], False, 0), (0, None, b"", True, 0)),
    ],
    ids=["nothing", "soon", "never", "the unsent rest is written first", "a port that has gone"],
)
def test_a_drain_waits_for_the_bytes_under_way_but_not_for_ever(
    held: int, free_after_ms: int | None, rest: bytes, gone: bool, waited_ms: int
) -> None:
    made = PortMachine()
    machine, wire = made.machine, made.wire
    own = made.load("failstop.board.stop_port").StopPort(made.open(wire), BOARD)
    wire.port.held += bytes(held)
    wire.port.drains = not held
    if free_after_ms is not None:
        machine.at(machine.now_ns + free_after_ms * MS, wire.port.drain)
    if gone:
        wire.unplug()
    own.unsent = rest
    began_ns = machine.now_ns
    assert own.drain() is not (gone or (held > 0 and not free_after_ms))
    assert machine.now_ns - began_ns == pytest.approx(waited_ms * MS, abs=0 if gone else MS)
    assert (own.lost, own.errno) == (gone, errno.EIO * gone)
    assert not gone or not own.holds(), "nobody knows what it holds"
    assert wire.read() == bytes(held) + rest
    assert not StopPort(-1, BOARD).holds()


@pytest.mark.parametrize("kind", BOARDS)
def test_a_stop_without_a_service_is_written_again_at_the_board_s_times(kind: str) -> None:
    board = board_of(*Settings({"board.kind": kind}).board())
    made, times = PortMachine(), list[int]()
    made.wire.on_bytes = lambda data: times.append(made.clock())
    own = made.load("failstop.board.stop_port").StopPort(made.open(made.wire), board)
    begun_ns, after_ns = made.clock(), board.repeats_ns[SUPERVISOR_ROW]
    own.burst()
    own.repeat(after_ns)
    assert times == [begun_ns, *(begun_ns + after for after in after_ns)]
    assert made.wire.read() == board.burst * len(times)
