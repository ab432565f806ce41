"""The simulated board on its pty: times, telemetry, and that every fault is the fault it says it is."""

from __future__ import annotations

import errno
import itertools
import os
import select
import threading
import time
from pathlib import Path

import pytest

from failstop.board import port
from failstop.board.port import open_port
from failstop.board.rrc import codec, decoder, framing
from failstop.board.rrc.board import RRC_PORT
from failstop.board.rrc.burst import BURST
from failstop_lab.sim.client import Event, SimBoard, SimBoardError
from failstop_lab.trial import wait_for
from tests.support import frames

from .parts import DRIVE, FORWARD

MS = 1_000_000


class Host:
    """Reads and decodes what the board sends."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self.decoder = decoder.Decoder()
        self.frames: list[tuple[int, bytes]] = []
        self.lost = 0
        """Bytes of no good frame, and of one that has not come whole yet."""

    def read(self, timeout_s: float) -> bool:
        if not select.select([self.descriptor], [], [], timeout_s)[0]:
            return False
        chunk = os.read(self.descriptor, 65536)
        found = self.decoder.feed(chunk)
        self.lost += len(chunk) - sum(5 + len(data) for _, data in found)
        self.frames += found
        return True

    def wait(self, func: int, timeout_s: float = 10.0) -> bytes:
        """The data of the first frame of `func` from now on."""
        self.frames.clear()
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s:
            self.read(0.1)
            for found, data in self.frames:
                if found == func:
                    return data
        raise AssertionError(f"no frame of func {func} within {timeout_s} s")

    def count(self, func: int, seconds: float) -> int:
        """How many frames of `func` come in this time."""
        self.frames.clear()
        end_s = time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0:
            self.read(left_s)
        return sum(found == func for found, _ in self.frames)


def test_times_are_of_this_machine_and_in_order(board: SimBoard, client: int) -> None:
    written: list[tuple[int, Event]] = []
    for _ in range(30):
        before_ns = time.monotonic_ns()
        os.write(client, DRIVE)
        (event,) = board.events()
        written.append((before_ns, event))
    events = [event for _, event in written]
    assert all(0 < event.arrival_ns - before_ns < 1_000 * MS for before_ns, event in written)
    assert all(e.executed_ns >= e.arrival_ns + 270_000 for e in events)
    assert [e.executed_ns for e in events] == sorted(e.executed_ns for e in events)
    assert [e.arrival_ns for e in events] == sorted(e.arrival_ns for e in events)
    assert max(e.executed_ns for e in events) < time.monotonic_ns()


def test_back_to_back_frames_queue(board: SimBoard, client: int) -> None:
    os.write(client, DRIVE + DRIVE + codec.STOP)
    events = board.events()
    assert [event.is_stop for event in events] == [False, False, True]
    assert [event.is_motion for event in events] == [True, True, False]
    assert all(b.executed_ns - a.executed_ns >= 270_000 for a, b in itertools.pairwise(events))


def test_events_are_given_once_and_again_on_request(board: SimBoard, client: int) -> None:
    os.write(client, DRIVE)
    assert [event.index for event in board.events()] == [0]
    assert board.events() == []
    os.write(client, codec.STOP)
    assert board.wait_for(lambda event: event.is_stop, 5.0).index == 1
    with pytest.raises(TimeoutError, match=r"1 others from 1 on\n  #1 at .* func 3 0104"):
        board.wait_for(lambda event: event.is_motion, 0.05)
    assert [event.index for event in board.events()] == [1]
    assert [event.index for event in board.events(since=0)] == [0, 1]
    assert board.wait_for(lambda event: event.is_motion, 0.05, since=0).index == 0


def test_many_events_come_in_order(board: SimBoard, client: int) -> None:
    expected = 0
    for count in (1, 99, 100, 101, 350):
        for _ in range(count):
            select.select([], [client], [], 10.0)
            assert os.write(client, frames.PING) == 7
        expected += count
    assert [event.index for event in board.events()] == list(range(expected))
    assert len(board.events(since=expected - 250)) == 250


def test_waiting_costs_the_board_nothing_and_ends_with_the_event(board: SimBoard, client: int) -> None:
    found: list[Event] = []
    waiter = threading.Thread(target=lambda: found.append(board.wait_for(lambda event: event.is_stop, 100.0)))
    waiter.start()
    wait_for("the waiting request", lambda: board.info()["waiting"] == 1)
    os.write(client, DRIVE)
    os.write(client, codec.STOP)
    waiter.join(20.0)
    assert [event.is_stop for event in found] == [True]


def test_wait_wheels(board: SimBoard, client: int) -> None:
    assert board.wait_wheels(False, 1.0) == (0.0, 0.0, 0.0, 0.0)
    with pytest.raises(TimeoutError, match="none turns"):
        board.wait_wheels(True, 0.05)
    os.write(client, DRIVE)
    assert board.wait_wheels(True, 5.0) == pytest.approx(FORWARD)
    assert board.wheels() == pytest.approx(FORWARD)


def test_telemetry_ping_pad_and_keys(board: SimBoard, client: int) -> None:
    host = Host(client)
    os.write(client, frames.PING)
    assert decoder.servo_reply(framing.PWM_SERVO, host.wait(framing.PWM_SERVO)) == (1, 5, 1500)
    board.pad(0x0100, hat=3, lx=-128, ly=127, rx=1, ry=-1)
    assert decoder.gamepad(host.wait(framing.GAMEPAD)) == (0x0100, 3, -128, 127, 1, -1)
    assert host.count(framing.GAMEPAD, 0.2) == 0
    board.pad(0x0200, hold=True)
    assert 3 <= host.count(framing.GAMEPAD, 0.4) <= 9
    board.pad_silent()
    host.count(framing.GAMEPAD, 0.05)
    assert host.count(framing.GAMEPAD, 0.2) == 0
    board.key(1, 0x20)
    assert decoder.key(host.wait(framing.KEY_FUNC)) == (1, 0x20)
    board.battery(9000)
    assert decoder.battery_mv(host.wait(framing.SYS)) == 11_000
    assert 40 <= host.count(framing.IMU_FUNC, 0.5) <= 60


def test_imu_can_be_silenced(board: SimBoard, client: int) -> None:
    host = Host(client)
    host.wait(framing.IMU_FUNC)
    board.imu(False)
    host.count(framing.IMU_FUNC, 0.05)
    assert host.count(framing.IMU_FUNC, 0.2) == 0
    board.imu(True)
    host.wait(framing.IMU_FUNC)


def test_deaf_drops_frames_while_telemetry_goes_on(board: SimBoard, client: int) -> None:
    host = Host(client)
    board.deaf(True)
    os.write(client, DRIVE + frames.PING)
    host.wait(framing.IMU_FUNC)
    assert board.events() == []
    assert board.wheels() == (0.0, 0.0, 0.0, 0.0)
    board.deaf(False)
    os.write(client, frames.PING)
    host.wait(framing.PWM_SERVO)
    assert [event.func for event in board.events()] == [framing.PWM_SERVO]


def test_cut_loses_that_many_bytes(board: SimBoard, client: int) -> None:
    board.cut(3)
    os.write(client, codec.STOP + DRIVE)
    assert [event.is_motion for event in board.events()] == [True]
    board.cut(27 + 5)
    os.write(client, DRIVE + bytes(5) + codec.STOP)
    assert [event.is_stop for event in board.events()] == [True]


def test_garble_flips_bits_each_way(board: SimBoard, client: int) -> None:
    host = Host(client)
    board.garble(down=0.05)
    for _ in range(8):
        os.write(client, frames.PING * 25)
    heard = len(board.events())
    assert 20 < heard < 190
    host.count(framing.IMU_FUNC, 0.3)
    assert host.lost < decoder.LONGEST
    board.garble(up=0.05)
    os.write(client, codec.STOP * 3)
    assert [event.is_stop for event in board.events()][-3:] == [True] * 3
    host.count(framing.IMU_FUNC, 0.5)
    assert host.lost > 2 * decoder.LONGEST
    with pytest.raises(SimBoardError, match="must be from 0 to 1"):
        board.garble(down=1.5)


def test_refused_stop_is_received_and_the_wheels_turn_on(board: SimBoard, client: int) -> None:
    os.write(client, DRIVE)
    board.wait_wheels(True, 5.0)
    board.refuse_stop(True)
    os.write(client, BURST)
    board.wait_for(lambda event: event.is_stop, 5.0)
    assert [event.is_stop for event in board.events()][-4:] == [True] * 4
    assert board.wheels() == pytest.approx(FORWARD)
    board.refuse_stop(False)
    os.write(client, codec.STOP)
    board.wait_wheels(False, 5.0)


def test_unplug_hangs_up_keeps_the_wheels_and_replug_works(board: SimBoard, client: int, tmp_path: Path) -> None:
    os.write(client, DRIVE)
    board.wait_wheels(True, 5.0)
    before = os.stat(board.link).st_rdev
    board.unplug()
    assert not os.path.lexists(board.link)
    poll = select.poll()
    poll.register(client, select.POLLIN)
    assert poll.poll(1000)[0][1] & select.POLLHUP
    with pytest.raises(OSError, match=r"Errno 5") as caught:
        os.write(client, codec.STOP)
    assert caught.value.errno == errno.EIO
    assert Host(client).read(0.0), "a hung-up port reads at once"
    with pytest.raises(port.PortError) as absent:
        open_port(board.link, exclusive=True, line=RRC_PORT)
    assert absent.value.kind == "absent"
    assert board.wheels() == pytest.approx(FORWARD), "the board lives on its battery"
    board.replug()
    # The old node is held open here, so the new one has another number.
    assert os.stat(board.link).st_rdev != before
    again = open_port(board.link, exclusive=True, line=RRC_PORT)
    os.write(again, codec.STOP)
    board.wait_wheels(False, 5.0)
    Host(again).wait(framing.IMU_FUNC)
    with pytest.raises(SimBoardError, match="plugged in already"):
        board.replug()
    board.unplug()
    other = tmp_path / "another"
    board.replug(other)
    assert board.link == str(other)
    assert not (tmp_path / "board").is_symlink()
    third = open_port(str(other), exclusive=True, line=RRC_PORT)
    os.write(third, frames.PING)
    Host(third).wait(framing.PWM_SERVO)
    os.close(third)
    os.close(again)


def test_not_draining_fills_the_port_and_draining_takes_it_all(board: SimBoard, client: int) -> None:
    board.stop_draining()
    pings = frames.PING * 20_000
    sent = 0
    with pytest.raises(BlockingIOError):  # noqa: PT012
        while True:
            # From where the last write ended: it may have taken a part of a frame, and there may be room again.
            sent += os.write(client, pings[sent : sent + 700])
            assert sent < len(pings)
    assert 4096 < sent < 65536
    # A pty does not tell: the question has a seam so that a test can answer it.
    assert port.unsent_bytes(client) == 0
    assert board.events() == []
    drained_ns = time.monotonic_ns()
    board.drain()
    # Any further request would make the board read.
    assert select.select([], [client], [], 10.0)[1]
    wait_for("everything", lambda: board.info()["executed"] == sent // len(frames.PING))
    events = board.events()
    assert events[0].arrival_ns >= drained_ns
    assert events[-1].executed_ns - events[0].executed_ns >= 0.99 * sent * 10_000


def used_s(pid: int) -> float:
    """Processor time of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@pytest.mark.parametrize("at_work", [True, False])
def test_little_processor_time(board: SimBoard, at_work: bool) -> None:
    client = open_port(board.link, exclusive=True, line=RRC_PORT)
    host = Host(client)
    host.wait(framing.IMU_FUNC)
    if not at_work:
        os.close(client)
    before_s, begin_s = used_s(board.pid), time.monotonic()
    while time.monotonic() < begin_s + 1.5:
        if at_work:
            os.write(client, DRIVE)
            host.count(framing.IMU_FUNC, 0.02)
        else:
            time.sleep(0.1)
    # Measured 1.5 % at work and 1 % alone on an idle machine; the bound allows for a slow one.
    assert (used_s(board.pid) - before_s) / (time.monotonic() - begin_s) < 0.10
    if at_work:
        os.close(client)
