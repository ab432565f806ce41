"""The wire: short writes, a full port, cut frames and bursts.

What reaches the other side is judged by the board's own receiver and motors."""

from __future__ import annotations

from typing import Any

import pytest

from failstop.board import codec
from failstop.board.burst import BURST
from failstop.board.rrc.board import BOARD
from failstop.lab.machine.port import Port
from failstop.messages import box
from tests.support.ptys import Board
from tests.support.stage import MS, PortMachine, Wire

MODULE = "failstop.procs.port_owner.port_writer"
MOTION = codec.motor_speeds((0.8, 0.8, -0.8, -0.8), 2.0)
OTHER = codec.buzzer(1400, 100, 100, 5)
FILL = bytes(Port.ROOM)
"""Bytes that fill a port."""


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


def test_frames_and_bursts_arrive_whole(board: Wire, wire: Any) -> None:
    assert wire.frame(MOTION)
    wire.burst()
    assert wire.frame(OTHER)
    assert board.read() == MOTION + BURST + OTHER
    assert wire.unsent == b""


def test_no_port_takes_nothing(machine: PortMachine) -> None:
    wire = machine.load(MODULE).PortWriter(-1, BOARD)
    assert wire.lost
    wire.burst()
    wire.flush()
    assert not wire.frame(MOTION)
    assert not wire.stuck(1)
    wire.early_stop()
    wire.close()


# An early stop.


def test_between_an_early_stop_and_the_loop_that_heeds_it_only_a_burst_goes_out(board: Wire, wire: Any) -> None:
    board.port.takes(10)
    assert wire.frame(MOTION)
    board.port.takes()
    wire.early_stop()
    assert not wire.flush(), "the rest of a frame of before"
    assert not wire.frame(OTHER)
    assert board.read() == MOTION[:10] + BOARD.first_stop
    wire.burst()
    assert not wire.frame(OTHER), "of whatever cause that burst was"
    wire.heed()
    assert wire.frame(OTHER)
    assert board.read() == BURST + OTHER


def test_an_early_stop_waits_for_the_write_that_the_loop_is_in(machine: PortMachine, board: Wire, wire: Any) -> None:
    """A frame that has passed its last look is before the stop, not behind it."""

    def pass_time() -> None:
        machine.clock.now_ns += MS

    def stop_early() -> None:
        machine.machine.thread(machine.me, wire.early_stop)
        pass_time()

    machine.at_next("write", stop_early)
    assert wire.frame(MOTION)
    pass_time()
    assert board.read() == MOTION + BOARD.first_stop


def test_an_early_stop_for_a_port_that_has_gone_is_not_written(machine: PortMachine, board: Wire, wire: Any) -> None:
    """The black box tells of it as not written."""
    kept: list[bytes] = []

    class Ring:
        put = kept.append

    wire.keep(Ring())
    wire.lost = True
    wire.early_stop()
    assert board.read() == b""
    wire.adopt(machine.open(machine.wire))
    kept.clear()
    wire.heed()
    assert kept == [box.pack_wire(box.WIRE_BURST, BOARD.first_stop, 0)]


# A full port.


def test_a_frame_that_a_full_port_takes_nothing_of_is_not_kept(board: Wire, wire: Any) -> None:
    board.fill()
    assert not wire.frame(MOTION)
    assert wire.unsent == b"", "kept for later it would be late"
    assert board.read() == FILL


def test_a_burst_for_a_full_port_waits_for_room(board: Wire, wire: Any) -> None:
    board.fill()
    wire.burst()
    assert wire.unsent == BURST
    wire.flush()
    assert wire.unsent == BURST
    assert not wire.frame(MOTION), "nothing overtakes a stop"
    stream = board.read()
    wire.flush()
    assert wire.unsent == b""
    stream += board.read()
    assert stream == FILL + BURST
    assert_stopped(stream)


def test_stops_for_a_port_that_never_drains_do_not_pile_up(board: Wire, wire: Any) -> None:
    board.fill()
    for _ in range(50):
        wire.burst()
    assert len(wire.unsent) <= 2 * len(BURST)


def test_bursts_until_the_port_is_full_are_cut_short_and_still_stop(board: Wire, wire: Any) -> None:
    assert wire.frame(MOTION)
    board.port.drains = False
    while not wire.unsent:
        wire.burst()
    stream = board.read()
    wire.flush()
    wire.burst()
    assert_stopped(stream + board.read())


# Short writes.


@pytest.mark.parametrize("frame", [MOTION, codec.STOP])
def test_a_burst_after_a_cut_motion_frame_stops(machine: PortMachine, frame: bytes) -> None:
    """Wherever it was cut. The rest of it is dropped, but for that of a zero frame."""
    made = machine.load(MODULE).PortWriter
    for cut in range(1, len(frame)):
        wire, board = made(machine.open(machine.wire), BOARD), machine.wire
        board.port.takes(cut)
        assert wire.frame(frame)
        assert wire.unsent == frame[cut:]
        board.port.takes()
        wire.burst()
        stream = board.read()
        assert stream == (frame if frame == codec.STOP else frame[:cut]) + BURST
        assert_stopped(MOTION + stream)


def test_nothing_is_added_to_a_cut_frame_and_the_rest_follows(board: Wire, wire: Any) -> None:
    board.port.takes(10)
    assert wire.frame(MOTION)
    board.port.takes(5)
    assert not wire.frame(codec.STOP)
    assert board.port.room == 5, "not even tried"
    wire.flush()
    assert wire.unsent == MOTION[15:]
    board.port.takes()
    wire.flush()
    assert wire.unsent == b""
    assert board.read() == MOTION


@pytest.mark.parametrize(
    "before", [b"", MOTION, MOTION[:20], MOTION[:3]], ids=["", "motion", "cut in data", "cut head"]
)
@pytest.mark.parametrize("again", [False, True])
def test_a_cut_burst_is_finished_also_by_a_stop_after_it(machine: PortMachine, before: bytes, again: bool) -> None:
    made = machine.load(MODULE).PortWriter
    for cut in (0, 1, 31, 32, 33, 45, 58, 59, 60, 200, 315, 316, 330, 343, 396):
        wire, board = made(machine.open(machine.wire), BOARD), machine.wire
        board.receive(before)
        board.port.takes(cut)
        wire.burst()
        board.port.takes()
        if again:
            wire.burst()
        else:
            wire.flush()
        assert wire.unsent == b""
        stream = board.read()
        assert stream == before + BURST * (1 + again)
        assert_stopped(stream)


@pytest.mark.parametrize("first", [0, 20, 300])
@pytest.mark.parametrize("second", [0, 100, 396, 397, 500])
def test_stops_cut_again_and_again_still_stop(board: Wire, wire: Any, first: int, second: int) -> None:
    for room in (first, second, second):
        board.port.takes(room)
        wire.burst()
    board.port.takes()
    wire.burst()
    wire.flush()
    assert wire.unsent == b""
    assert_stopped(MOTION[:20] + board.read())
