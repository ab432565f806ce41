"""The wire: short writes, a full port, cut frames and bursts, bytes under way, and a device that goes away."""

from __future__ import annotations

from typing import Any

import pytest

from failstop.board.kinds import board_of
from failstop.board.rrc import codec
from failstop.board.rrc.board import BOARD
from failstop.board.rrc.burst import BURST
from failstop.messages import box
from failstop.procs.port_owner.port_writer import DRAIN_NS
from failstop_lab.machine.port import Port
from tests.support.stage import MS, PortMachine, Wire

MODULE = "failstop.procs.port_owner.port_writer"
MOTION = codec.motor_speeds((0.8, 0.8, -0.8, -0.8), 2.0)
OTHER = codec.buzzer(1400, 100, 100, 5)
FILL = bytes(Port.ROOM)
"""Bytes that fill a port."""


def test_frames_and_bursts_arrive_whole_where_there_is_a_port(machine: PortMachine, board: Wire, wire: Any) -> None:
    assert wire.frame(MOTION)
    wire.burst()
    assert wire.frame(OTHER)
    assert (board.read(), wire.unsent) == (MOTION + BURST + OTHER, b"")
    nowhere = machine.load(MODULE).PortWriter(-1, BOARD)
    assert nowhere.lost
    for write in (nowhere.burst, nowhere.flush, nowhere.early_stop):
        write()
    assert (nowhere.frame(MOTION), nowhere.stuck(1)) == (False, False)
    nowhere.close()


def test_until_the_loop_heeds_an_early_stop_only_a_burst_goes_out(board: Wire, wire: Any) -> None:
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


def test_a_full_port_keeps_no_frame_and_a_burst_until_there_is_room(board: Wire, wire: Any) -> None:
    board.fill()
    assert not wire.frame(MOTION)
    assert wire.unsent == b"", "kept for later it would be late"
    for _ in range(50):
        wire.burst()
        assert BURST in wire.unsent
        assert len(wire.unsent) <= 2 * len(BURST), "stops for a port that never drains do not pile up"
    kept = wire.unsent
    wire.flush()
    assert wire.unsent == kept
    assert not wire.frame(MOTION), "nothing overtakes a stop"
    stream = board.read()
    wire.flush()
    assert wire.unsent == b""
    assert stream + board.read() == FILL + kept


@pytest.mark.parametrize("frame", [MOTION, codec.STOP])
def test_a_burst_after_a_cut_frame_is_whole(machine: PortMachine, frame: bytes) -> None:
    """Wherever it was cut. The rest of it is dropped, but for that of a zero frame; so the board stops by what
    test_burst.py proves."""
    made = machine.load(MODULE).PortWriter
    for cut in range(1, len(frame)):
        wire, board = made(machine.open(machine.wire), BOARD), machine.wire
        board.port.takes(cut)
        assert wire.frame(frame)
        assert wire.unsent == frame[cut:]
        board.port.takes()
        wire.burst()
        assert board.read() == (frame if frame == codec.STOP else frame[:cut]) + BURST


def test_the_rest_of_a_question_is_dropped_even_if_it_looks_like_a_stop_s(machine: PortMachine) -> None:
    """An Arduino's lines all end alike."""
    arduino = board_of("arduino", 0.1, 0.0)
    ping = arduino.pings[0]
    assert arduino.burst.endswith(ping[1:])
    wire, board = machine.load(MODULE).PortWriter(machine.open(machine.wire), arduino), machine.wire
    board.port.takes(1)
    assert wire.frame(ping)
    board.port.takes()
    wire.burst()
    assert board.read() == ping[:1] + arduino.burst


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


@pytest.mark.parametrize("again", [False, True])
def test_a_cut_burst_is_finished_also_by_a_stop_after_it(machine: PortMachine, again: bool) -> None:
    made = machine.load(MODULE).PortWriter
    for cut in (0, 1, 31, 32, 33, 45, 58, 59, 60, 200, 315, 316, 330, 343, 396):
        wire, board = made(machine.open(machine.wire), BOARD), machine.wire
        board.port.takes(cut)
        wire.burst()
        board.port.takes()
        (wire.burst if again else wire.flush)()
        assert (wire.unsent, board.read()) == (b"", BURST * (1 + again))


T0 = 3_000 * MS
PING_BACKLOG = 2 * len(BOARD.burst)
MOTION_BACKLOG = len(BOARD.pings[0])


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


def test_a_ping_follows_a_burst_that_is_under_way_and_motion_a_ping_alone(board: Wire, wire: Any) -> None:
    wire.burst()
    board.port.under_way = URB
    assert not wire.frame(MOTION, backlog=MOTION_BACKLOG)
    assert wire.frame(BOARD.pings[0], backlog=PING_BACKLOG)
    assert board.read() == BURST + BOARD.pings[0]
    board.port.under_way = 0
    assert wire.frame(BOARD.pings[0]), "what the port has drained is no backlog"
    board.port.under_way = URB
    assert wire.frame(MOTION, backlog=MOTION_BACKLOG)


def test_a_port_is_stuck_after_exactly_the_time_unless_it_drained_in_between(board: Wire, wire: Any) -> None:
    assert not any(wire.stuck(T0 - n * DRAIN_NS) for n in range(5, 0, -1)), "an empty one is not"
    for begun_ns in (T0, T0 + 11 * DRAIN_NS):
        board.port.under_way = 1
        found = [wire.stuck(begun_ns + ns) for ns in (0, DRAIN_NS - 1, DRAIN_NS, 10 * DRAIN_NS)]
        assert found == [False, False, True, True]
        board.port.under_way = 0
        assert not wire.stuck(begun_ns + 11 * DRAIN_NS - 1)
    board.fill()
    wire.burst()
    later_ns = T0 + 30 * DRAIN_NS
    assert [wire.stuck(later_ns), wire.stuck(later_ns + DRAIN_NS)] == [False, True], "a full one"
    board.read()
    wire.flush()
    assert not wire.stuck(later_ns + DRAIN_NS + 1)
    board.unplug()
    assert not wire.stuck(later_ns + 3 * DRAIN_NS)
    assert wire.lost, "one that cannot say what it holds has gone"


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


def test_a_read_takes_what_waits_and_no_more(machine: PortMachine, board: Wire, wire: Any) -> None:
    read = machine.load("failstop.board.port").waiting_bytes
    assert read(wire.fd) == b"", "nothing to read is no hang-up"
    board.port.send(b"telemetry")
    assert [read(wire.fd), read(wire.fd)] == [b"telemetry", b""]
    board.unplug()
    assert read(wire.fd) is None


@pytest.mark.parametrize("touch", ["frame", "burst", "stuck", "flush"])
def test_whatever_touches_the_port_notices_a_hang_up_and_writes_no_more(board: Wire, wire: Any, touch: str) -> None:
    if touch == "flush":
        board.port.takes(10)
        assert wire.frame(MOTION)
        board.port.takes()
    board.unplug()
    arguments = {"frame": (MOTION,), "stuck": (T0,)}.get(touch, ())
    assert not getattr(wire, touch)(*arguments)
    assert wire.lost
    assert touch == "flush" or wire.unsent == b""
    board.read()
    wire.burst()
    wire.unsent = MOTION[10:]
    wire.flush()
    assert (wire.frame(MOTION), board.read()) == (False, b"")


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
