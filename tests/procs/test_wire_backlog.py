"""The wire: bytes under way, a port that does not drain, what the board sends, and a device that goes away."""

from __future__ import annotations

from typing import Any

import pytest

from failstop.board import codec
from failstop.board.burst import BURST
from failstop.board.rrc.board import BOARD
from failstop.procs.port_owner.port_writer import DRAIN_NS
from tests.support.stage import MS, PortMachine, Wire

T0 = 3_000 * MS
MOTION = codec.motor_speeds((0.8, 0.8, -0.8, -0.8), 2.0)
OTHER = codec.buzzer(1400, 100, 100, 5)
PING_BACKLOG = 2 * len(BOARD.burst)
MOTION_BACKLOG = len(BOARD.pings[0])


# No backlog.


def test_a_motion_frame_is_not_added_to_a_backlog_and_a_stop_to_any(board: Wire, wire: Any) -> None:
    for unsent in (1, 4096):
        board.port.under_way = unsent
        assert not wire.frame(MOTION)
        assert board.read() == b""
        wire.burst()
        assert board.read() == BURST
    board.port.under_way = 0
    assert wire.frame(MOTION)
    assert board.read() == MOTION


URB = 1280
"""Bytes that cdc_acm counts for each write under way, of any length."""


@pytest.mark.parametrize("unit", [1, URB])
@pytest.mark.parametrize(("handed", "taken"), [(1, True), (128, True), (129, False)])
def test_other_frames_may_queue_behind_a_little_in_whatever_unit_the_driver_counts(
    board: Wire, wire: Any, unit: int, handed: int, taken: bool
) -> None:
    assert wire.frame(bytes(handed))
    board.read()
    board.port.under_way = unit
    assert wire.frame(OTHER, backlog=128) is taken
    assert board.read() == (OTHER if taken else b"")


def test_bytes_that_the_port_has_drained_are_no_backlog(board: Wire, wire: Any) -> None:
    assert wire.frame(bytes(129))
    assert wire.frame(bytes(1)), "the kernel holds nothing"
    board.port.under_way = URB
    assert wire.frame(OTHER, backlog=128)


def test_a_ping_follows_a_burst_that_is_under_way_and_motion_a_ping_alone(board: Wire, wire: Any) -> None:
    wire.burst()
    board.port.under_way = URB
    assert not wire.frame(MOTION, backlog=MOTION_BACKLOG)
    assert wire.frame(BOARD.pings[0], backlog=PING_BACKLOG)
    assert board.read() == BURST + BOARD.pings[0]
    board.port.under_way = 0
    assert wire.frame(BOARD.pings[0])
    board.port.under_way = URB
    assert wire.frame(MOTION, backlog=MOTION_BACKLOG)


# A port that does not drain.


def test_a_port_is_stuck_after_exactly_the_time_unless_it_drained_in_between(board: Wire, wire: Any) -> None:
    assert not any(wire.stuck(T0 - n * DRAIN_NS) for n in range(5, 0, -1)), "an empty one is not"
    board.port.under_way = 1
    assert not wire.stuck(T0)
    assert not wire.stuck(T0 + DRAIN_NS - 1)
    assert wire.stuck(T0 + DRAIN_NS)
    assert wire.stuck(T0 + 10 * DRAIN_NS)
    board.port.under_way = 0
    assert not wire.stuck(T0 + 11 * DRAIN_NS - 1)
    board.port.under_way = 1
    assert not wire.stuck(T0 + 11 * DRAIN_NS)
    assert not wire.stuck(T0 + 12 * DRAIN_NS - 1)
    assert wire.stuck(T0 + 12 * DRAIN_NS)


def test_a_port_that_cannot_say_what_it_holds_has_gone_and_is_not_stuck(board: Wire, wire: Any) -> None:
    board.port.under_way = 1
    assert not wire.stuck(T0)
    board.unplug()
    assert not wire.stuck(T0 + DRAIN_NS)
    assert wire.lost


def test_a_full_port_is_stuck_and_recovers(board: Wire, wire: Any) -> None:
    board.fill()
    wire.burst()
    assert not wire.stuck(T0)
    assert wire.stuck(T0 + DRAIN_NS)
    board.read()
    wire.flush()
    assert not wire.stuck(T0 + DRAIN_NS + 1)


def test_a_write_that_was_refused_is_held_back_until_one_is_taken(machine: PortMachine, board: Wire, wire: Any) -> None:
    """Where the kernel counts nothing and has no room all the same."""
    assert not wire.stuck(T0 - DRAIN_NS)
    assert not wire.stuck(T0), "nothing was refused yet"
    board.port.takes(0)
    begun_ns = machine.clock()
    assert not wire.frame(MOTION)
    assert not wire.stuck(T0)
    assert machine.clock() == begun_ns, "it is not waited for"
    assert wire.stuck(T0 + DRAIN_NS)
    board.port.takes(len(MOTION))
    assert wire.frame(MOTION)
    assert not wire.stuck(T0 + DRAIN_NS + MS)


def test_a_write_that_was_refused_beside_somebody_else_s_holds_nothing_back(machine: PortMachine, wire: Any) -> None:
    def refuse(thread: object, call: str, about: object) -> None:
        if call == "write":
            raise BlockingIOError

    machine.machine.at_seam = refuse
    assert not wire.frame(MOTION)
    assert not wire.stuck(T0)
    assert not wire.stuck(T0 + DRAIN_NS), "there was room"


# What the board sends, and its end.


def test_a_read_takes_what_waits_and_no_more(machine: PortMachine, board: Wire, wire: Any) -> None:
    read = machine.load("failstop.board.port").waiting_bytes
    assert read(wire.fd) == b"", "nothing to read is no hang-up"
    board.port.send(b"telemetry")
    assert [read(wire.fd), read(wire.fd)] == [b"telemetry", b""]
    board.unplug()
    assert read(wire.fd) is None


@pytest.mark.parametrize("touch", ["frame", "burst", "stuck", "flush"])
def test_a_hang_up_is_noticed_by_whatever_touches_the_port(board: Wire, wire: Any, touch: str) -> None:
    if touch == "flush":
        board.port.takes(10)
        assert wire.frame(MOTION)
        board.port.takes()
    board.unplug()
    arguments = {"frame": (MOTION,), "stuck": (T0,)}.get(touch, ())
    assert not getattr(wire, touch)(*arguments)
    assert wire.lost
    assert touch == "flush" or wire.unsent == b""


def test_nothing_is_written_to_a_lost_port(board: Wire, wire: Any) -> None:
    wire.lost = True
    wire.burst()
    wire.unsent = MOTION[10:]
    wire.flush()
    assert not wire.frame(MOTION)
    assert board.read() == b""


def test_close_lets_the_port_go_at_once(machine: PortMachine, wire: Any) -> None:
    fd = wire.fd
    wire.close()
    with pytest.raises(OSError, match="Bad file descriptor"):
        machine.os.fstat(fd)
    assert wire.fd == -1
    assert wire.lost
    wire.close()


def test_the_first_bytes_on_a_new_port_are_a_burst(machine: PortMachine, board: Wire, wire: Any) -> None:
    board.port.takes(10)
    wire.frame(MOTION)
    new = board.replug()
    wire.close()
    wire.adopt(machine.open(new))
    assert not wire.lost
    new.port.under_way = len(BURST)
    assert not wire.stuck(T0), "its time begins again"
    new.port.under_way = 0
    assert wire.frame(MOTION)
    assert new.read() == BURST + MOTION
