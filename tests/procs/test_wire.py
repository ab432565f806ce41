"""The wire on a real pty: short writes, a full port, cut frames and bursts, and a device that goes away.

What reaches the other side is judged by the board's own receiver and motors."""

from __future__ import annotations

import os
import select
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from failstop.board import codec
from failstop.board.burst import BURST
from failstop.board.interface import BOARD
from failstop.procs.port_owner.main import MOTION_BACKLOG, PING_BACKLOG
from failstop.procs.port_owner.wire import DRAIN_NS, Wire
from failstop.procs.world import World
from failstop.shm import box
from tests.support.played import PlayedWorld
from tests.support.ptys import Board, Pty, new_pty
from tests.support.stand_ins import before_write
from tests.support.waiting import until

MS = 1_000_000
T0 = 3_000 * MS
MAX_RPS = 2.0
MOTION = codec.motor_speeds((0.8, 0.8, -0.8, -0.8), MAX_RPS)
OTHER = codec.buzzer(1400, 100, 100, 5)


@pytest.fixture
def pty() -> Iterator[Pty]:
    with new_pty() as made:
        yield made


@pytest.fixture
def world() -> PlayedWorld:
    return PlayedWorld()


@pytest.fixture
def wire(pty: Pty, world: PlayedWorld) -> Wire:
    return Wire(pty.slave, world)


class Kernel:
    """Stands before os.write for the wire: takes at most `room` bytes in all, then EAGAIN; None takes everything."""

    def __init__(self) -> None:
        self.room: int | None = None

    def write(self, fd: int, data: bytes) -> int:
        if self.room is None:
            return os.write(fd, data)
        part = data[: self.room]
        if not part:
            raise BlockingIOError
        self.room -= len(part)
        return os.write(fd, part)


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch) -> Kernel:
    made = Kernel()
    before_write(monkeypatch, made.write)
    return made


class Held:
    """Answers for the kernel how many unsent bytes it holds."""

    def __init__(self) -> None:
        self.bytes = 0

    def __call__(self, _fd: int) -> int:
        return self.bytes


@pytest.fixture
def held(world: PlayedWorld) -> Held:
    made = Held()
    world.play("unsent_bytes", made)
    return made


def assert_stopped(stream: bytes) -> None:
    """The stream stops a board whose wheels turn, and nothing turns one again after its first stop."""
    board = Board()
    board.feed(stream)
    assert board.motors.stopped, board.motors.speeds_rps
    stops = [at for at, (body, _) in enumerate(board.executed) if body == codec.STOP[4:-1]]
    assert stops, "no stop frame was executed"
    assert not any(any(speeds) for _, speeds in board.executed[stops[0] :])
    assert board.receiver.state == 0, "the receiver is left between frames"


# Whole writes.


def test_frames_and_bursts_arrive_whole(pty: Pty, wire: Wire) -> None:
    assert wire.frame(MOTION)
    wire.burst()
    assert wire.frame(OTHER)
    assert pty.read() == MOTION + BURST + OTHER
    assert wire.unsent == b""


def test_no_port_takes_nothing(held: Held) -> None:
    wire = Wire(-1, World())
    assert wire.lost
    wire.burst()
    wire.flush()
    assert not wire.frame(MOTION)
    assert not wire.stuck(T0)
    wire.close()


# An early stop.


def test_between_an_early_stop_and_the_loop_that_heeds_it_only_a_burst_goes_out(
    pty: Pty, wire: Wire, kernel: Kernel
) -> None:
    kernel.room = 10
    assert wire.frame(MOTION)
    kernel.room = None
    wire.early_stop()
    assert not wire.flush(), "the rest of a frame of before"
    assert not wire.frame(OTHER)
    assert pty.read() == MOTION[:10] + BOARD.first_stop
    wire.burst()
    assert not wire.frame(OTHER), "of whatever cause that burst was"
    wire.heed()
    assert wire.frame(OTHER)
    assert pty.read() == BURST + OTHER


def test_an_early_stop_waits_for_the_write_that_the_loop_is_in(
    pty: Pty, wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A frame that has passed its last look is before the stop, not behind it."""
    threads: list[threading.Thread] = []

    def held_up(fd: int, data: bytes) -> int:
        if not threads:
            threads.append(threading.Thread(target=wire.early_stop))
            threads[0].start()
            threads[0].join(0.05)
            assert threads[0].is_alive()
        return os.write(fd, data)

    before_write(monkeypatch, held_up)
    assert wire.frame(MOTION)
    threads[0].join()
    assert pty.read() == MOTION + BOARD.first_stop


def test_a_port_that_has_gone_gets_no_early_stop(pty: Pty, wire: Wire) -> None:
    wire.lost = True
    wire.early_stop()
    assert pty.read() == b""
    Wire(-1, World()).early_stop()


def test_an_early_stop_for_a_port_that_has_gone_is_not_in_the_black_box_as_written(pty: Pty, wire: Wire) -> None:
    kept: list[bytes] = []

    class Ring:
        put = kept.append

    wire.keep(Ring())  # type: ignore[arg-type]
    wire.lost = True
    wire.early_stop()
    with new_pty() as other:
        wire.adopt(other.slave)
        pty.slave = other.slave = -1
        kept.clear()
        wire.heed()
    assert kept == [box.pack_wire(box.BURST, BOARD.first_stop, 0)]
    wire.close()


# A full port.


def test_a_frame_that_a_full_port_takes_nothing_of_is_not_kept(pty: Pty, wire: Wire) -> None:
    filled = pty.fill()
    assert not wire.frame(MOTION)
    assert wire.unsent == b"", "kept for later it would be late"
    assert pty.read() == bytes(filled)


def test_a_burst_for_a_full_port_waits_for_room(pty: Pty, wire: Wire) -> None:
    filled = pty.fill()
    wire.burst()
    assert wire.unsent == BURST
    wire.flush()
    assert wire.unsent == BURST
    assert not wire.frame(MOTION), "nothing overtakes a stop"
    stream = b""

    def flushed() -> bool:
        nonlocal stream
        stream += pty.read()
        wire.flush()
        return not wire.unsent

    until(flushed, "the burst to be taken")
    stream += pty.read()
    assert stream == bytes(filled) + BURST
    assert_stopped(stream)


def test_stops_for_a_port_that_never_drains_do_not_pile_up(pty: Pty, wire: Wire) -> None:
    pty.fill()
    for _ in range(50):
        wire.burst()
    assert len(wire.unsent) <= 2 * len(BURST)


def test_bursts_until_the_port_is_full_are_cut_short_and_still_stop(pty: Pty, wire: Wire) -> None:
    assert wire.frame(MOTION)
    stream = b""
    for _ in range(200):
        wire.burst()
        if wire.unsent:
            break
    assert wire.unsent, "the port never filled up"

    def flushed() -> bool:
        nonlocal stream
        stream += pty.read()
        wire.flush()
        return not wire.unsent

    until(flushed, "the rest to be taken")
    wire.burst()
    assert_stopped(stream + pty.read())


# Short writes.


@pytest.mark.parametrize("cut", range(1, len(MOTION)))
def test_a_burst_after_a_cut_motion_frame_stops(pty: Pty, wire: Wire, kernel: Kernel, cut: int) -> None:
    kernel.room = cut
    assert wire.frame(MOTION)
    assert wire.unsent == MOTION[cut:]
    kernel.room = None
    wire.burst()
    stream = pty.read()
    assert stream == MOTION[:cut] + BURST, "the rest of the motion frame is dropped"
    assert_stopped(stream)


def test_nothing_is_added_to_a_cut_frame_and_the_rest_follows(pty: Pty, wire: Wire, kernel: Kernel) -> None:
    kernel.room = 10
    assert wire.frame(MOTION)
    kernel.room = 5
    assert not wire.frame(codec.STOP)
    assert kernel.room == 5, "not even tried"
    wire.flush()
    assert wire.unsent == MOTION[15:]
    kernel.room = None
    wire.flush()
    assert wire.unsent == b""
    assert pty.read() == MOTION


@pytest.mark.parametrize("cut", [0, 1, 31, 32, 33, 45, 58, 59, 60, 200, 315, 316, 330, 343, 396])
@pytest.mark.parametrize(
    "before", [b"", MOTION, MOTION[:20], MOTION[:3]], ids=["", "motion", "cut in data", "cut head"]
)
def test_a_cut_burst_is_finished(pty: Pty, wire: Wire, kernel: Kernel, before: bytes, cut: int) -> None:
    os.write(pty.slave, before)
    kernel.room = cut
    wire.burst()
    kernel.room = None
    wire.flush()
    stream = pty.read()
    assert stream == before + BURST
    assert_stopped(stream)


@pytest.mark.parametrize("cut", [0, 1, 33, 58, 59, 200, 330, 396])
def test_a_stop_after_a_cut_burst_begins_with_its_rest(pty: Pty, wire: Wire, kernel: Kernel, cut: int) -> None:
    kernel.room = cut
    wire.burst()
    kernel.room = None
    wire.burst()
    assert wire.unsent == b""
    stream = pty.read()
    assert stream == BURST + BURST
    assert_stopped(MOTION[:20] + stream)


@pytest.mark.parametrize("first", [0, 20, 300])
@pytest.mark.parametrize("second", [0, 100, 396, 397, 500])
def test_stops_cut_again_and_again_still_stop(pty: Pty, wire: Wire, kernel: Kernel, first: int, second: int) -> None:
    for room in (first, second, second):
        kernel.room = room
        wire.burst()
    kernel.room = None
    wire.burst()
    wire.flush()
    assert wire.unsent == b""
    assert_stopped(MOTION[:20] + pty.read())


def test_a_cut_zero_frame_then_a_stop(pty: Pty, wire: Wire, kernel: Kernel) -> None:
    kernel.room = 13
    assert wire.frame(codec.STOP)
    kernel.room = None
    wire.burst()
    assert_stopped(MOTION + pty.read())


# No backlog.


@pytest.mark.parametrize("unsent", [1, 27, 4096])
def test_a_motion_frame_is_not_added_to_a_backlog(pty: Pty, wire: Wire, held: Held, unsent: int) -> None:
    held.bytes = unsent
    assert not wire.frame(MOTION)
    assert pty.read() == b""
    held.bytes = 0
    assert wire.frame(MOTION)
    assert pty.read() == MOTION


def test_a_stop_is_added_to_any_backlog(pty: Pty, wire: Wire, held: Held) -> None:
    held.bytes = 4096
    wire.burst()
    assert pty.read() == BURST


URB = 1280
"""What cdc_acm counts for each write under way, whatever its length."""


@pytest.mark.parametrize("unit", [1, URB])
@pytest.mark.parametrize(("handed", "taken"), [(1, True), (128, True), (129, False)])
def test_other_frames_may_queue_behind_a_little_in_whatever_unit_the_driver_counts(
    pty: Pty, wire: Wire, held: Held, unit: int, handed: int, taken: bool
) -> None:
    assert wire.frame(bytes(handed))
    pty.read()
    held.bytes = unit
    assert wire.frame(OTHER, backlog=128) is taken
    assert pty.read() == (OTHER if taken else b"")


def test_what_the_port_has_drained_is_no_backlog(pty: Pty, wire: Wire, held: Held) -> None:
    assert wire.frame(bytes(129))
    assert wire.frame(bytes(1)), "the kernel holds nothing"
    held.bytes = URB
    assert wire.frame(OTHER, backlog=128)


def test_a_ping_follows_a_burst_that_is_still_under_way_and_motion_does_not(pty: Pty, wire: Wire, held: Held) -> None:
    wire.burst()
    held.bytes = URB
    assert not wire.frame(MOTION, backlog=MOTION_BACKLOG)
    assert wire.frame(BOARD.pings[0], backlog=PING_BACKLOG)
    assert pty.read() == BURST + BOARD.pings[0]


def test_motion_follows_a_ping_that_is_still_under_way(pty: Pty, wire: Wire, held: Held) -> None:
    assert wire.frame(BOARD.pings[0])
    held.bytes = URB
    assert wire.frame(MOTION, backlog=MOTION_BACKLOG)


# A port that does not drain.


def test_stuck_after_exactly_the_time(wire: Wire, held: Held) -> None:
    held.bytes = 1
    assert not wire.stuck(T0)
    assert not wire.stuck(T0 + DRAIN_NS - 1)
    assert wire.stuck(T0 + DRAIN_NS)
    assert wire.stuck(T0 + 10 * DRAIN_NS)


def test_a_port_that_cannot_say_what_it_holds_has_gone_and_is_not_stuck(
    wire: Wire, held: Held, world: PlayedWorld
) -> None:
    def gone(_fd: int) -> int:
        raise OSError

    held.bytes = 1
    assert not wire.stuck(T0)
    world.play("unsent_bytes", gone)
    assert not wire.stuck(T0 + DRAIN_NS)
    assert wire.lost


def test_drained_in_between_is_not_stuck(wire: Wire, held: Held) -> None:
    held.bytes = 1
    wire.stuck(T0)
    held.bytes = 0
    assert not wire.stuck(T0 + DRAIN_NS - 1)
    held.bytes = 1
    assert not wire.stuck(T0 + DRAIN_NS)
    assert not wire.stuck(T0 + 2 * DRAIN_NS - 1)
    assert wire.stuck(T0 + 2 * DRAIN_NS)


def test_a_full_port_is_stuck_and_recovers(pty: Pty, wire: Wire) -> None:
    pty.fill()
    wire.burst()
    assert not wire.stuck(T0)
    assert wire.stuck(T0 + DRAIN_NS)

    def flushed() -> bool:
        pty.read()
        wire.flush()
        return not wire.unsent

    until(flushed, "the burst to be taken")
    assert not wire.stuck(T0 + DRAIN_NS + 1)


def test_a_write_that_was_refused_is_held_back_until_one_is_taken(
    wire: Wire, kernel: Kernel, held: Held, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the kernel counts nothing and has no room all the same."""
    held.bytes = 0
    monkeypatch.setattr(Wire, "_has_room", lambda self: False)
    assert not wire.stuck(T0 - DRAIN_NS)
    assert not wire.stuck(T0), "nothing was refused yet"
    kernel.room = 0
    assert not wire.frame(MOTION)
    assert not wire.stuck(T0)
    assert wire.stuck(T0 + DRAIN_NS)
    kernel.room = None
    assert wire.frame(MOTION)
    assert not wire.stuck(T0 + DRAIN_NS + MS)


def test_a_write_that_was_refused_beside_somebody_else_s_holds_nothing_back(
    wire: Wire, kernel: Kernel, held: Held
) -> None:
    held.bytes = 0
    kernel.room = 0
    assert not wire.frame(MOTION)
    assert not wire.stuck(T0)
    assert not wire.stuck(T0 + DRAIN_NS), "there was room"


def test_a_full_port_is_not_waited_for(pty: Pty, world: PlayedWorld) -> None:
    wire, waited_s = Wire(pty.slave, world), []

    def timed(*given: Any) -> Any:
        waited_s.append(given[3])
        return select.select(*given[:3], 0)  # type: ignore[call-arg]

    pty.fill()
    world.play("select", timed)
    assert not wire.frame(MOTION)
    waited_s.clear()
    wire.stuck(T0)
    assert waited_s == [0]


def test_an_empty_port_is_not_stuck(wire: Wire) -> None:
    assert not any(wire.stuck(T0 + n * DRAIN_NS) for n in range(5))


# What the board sends, and its end.


def test_reads_what_waits_and_no_more(pty: Pty, wire: Wire) -> None:
    assert wire.read() == b""
    assert not wire.lost, "nothing to read is no hang-up"
    os.write(pty.master, b"telemetry")
    found = b""

    def arrived() -> bool:
        nonlocal found
        found += wire.read()
        return found == b"telemetry"

    until(arrived, "the bytes")
    assert not wire.lost


@pytest.mark.parametrize("touch", ["read", "frame", "burst", "stuck"])
def test_a_hang_up_is_noticed_by_whatever_touches_the_port(pty: Pty, wire: Wire, touch: str) -> None:
    pty.unplug()
    if touch == "read":
        assert wire.read() == b""
    elif touch == "frame":
        assert not wire.frame(MOTION)
    elif touch == "burst":
        wire.burst()
    else:
        assert not wire.stuck(T0)
    assert wire.lost
    assert wire.unsent == b""


def test_a_hang_up_in_the_middle_of_a_frame(pty: Pty, wire: Wire, kernel: Kernel) -> None:
    kernel.room = 10
    assert wire.frame(MOTION)
    kernel.room = None
    pty.unplug()
    wire.flush()
    assert wire.lost


def test_nothing_is_written_to_a_lost_port(pty: Pty, wire: Wire) -> None:
    wire.lost = True
    wire.burst()
    wire.unsent = MOTION[10:]
    wire.flush()
    assert not wire.frame(MOTION)
    assert pty.read() == b""


def test_close_lets_the_port_go_at_once(pty: Pty, wire: Wire) -> None:
    wire.close()
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(pty.slave)
    pty.slave = -1
    assert wire.fd == -1
    assert wire.lost
    wire.close()


def test_the_first_bytes_on_a_new_port_are_a_burst(pty: Pty, world: PlayedWorld, kernel: Kernel, held: Held) -> None:
    with new_pty() as old:
        wire = Wire(old.slave, world)
        kernel.room = 10
        wire.frame(MOTION)
        kernel.room = None
        old.unplug()
        assert wire.read() == b""
        wire.close()
        old.slave = -1
    wire.adopt(pty.slave)
    assert not wire.lost
    held.bytes = len(BURST)
    assert not wire.stuck(T0), "its time begins again"
    held.bytes = 0
    assert wire.frame(MOTION)
    assert pty.read() == BURST + MOTION
