"""The simulated board's process: its link, its control socket, its record, its clients and its end."""

from __future__ import annotations

import fcntl
import json
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.board.port import open_port
from failstop.board.rrc import codec
from failstop.board.rrc.board import RRC_PORT
from failstop_lab.sim.client import SimBoard, SimBoardError
from failstop_lab.sim.control import connect
from failstop_lab.sim.options import Options
from failstop_lab.sim.process import Simulator
from failstop_lab.trial import wait_for
from tests.support.children import NOBODY, become

from .parts import DRIVE, FORWARD


def test_clients_may_come_go_and_crash(board: SimBoard) -> None:
    for _ in range(3):
        descriptor = open_port(board.link, exclusive=True, line=RRC_PORT)
        os.write(descriptor, codec.STOP)
        os.close(descriptor)
    child = os.fork()
    if child == 0:
        try:
            os.write(open_port(board.link, exclusive=True, line=RRC_PORT), DRIVE)
        finally:
            os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(child, 0)
    board.wait_wheels(True, 5.0)
    assert sum(event.is_stop for event in board.events()) == 3, "what was written before a close still arrives"
    wait_for("the port to be free", lambda: not board.info()["opened"])
    assert board.wheels() == pytest.approx(FORWARD)


def test_two_clients_at_a_time(board: SimBoard, client: int) -> None:
    other = open_port(board.link, exclusive=False, line=RRC_PORT)
    os.write(client, DRIVE)
    board.wait_wheels(True, 5.0)
    os.write(other, codec.STOP)
    board.wait_wheels(False, 5.0)
    os.close(other)
    os.write(client, DRIVE)
    board.wait_wheels(True, 5.0)
    assert board.info()["opened"]


def exclusively_claimed(descriptor: int) -> bool:
    return bool(struct.unpack("i", fcntl.ioctl(descriptor, 0x80045440, struct.pack("i", 0)))[0])


def test_the_last_close_frees_the_port_as_on_a_real_one(board: SimBoard) -> None:
    descriptor = open_port(board.link, exclusive=True, line=RRC_PORT)
    assert exclusively_claimed(descriptor)
    wait_for("unread telemetry", lambda: bool(select.select([descriptor], [], [], 1.0)[0]))
    os.close(descriptor)
    wait_for("the port to be free", lambda: not board.info()["opened"])
    again = os.open(board.link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    assert not exclusively_claimed(again)
    os.close(again)


@pytest.mark.parametrize("reader", ["nobody", "somebody who did not read"])
def test_no_telemetry_is_kept_for_a_client_that_comes_later(board: SimBoard, reader: str) -> None:
    descriptor = open_port(board.link, exclusive=False, line=RRC_PORT)
    if reader == "nobody":
        os.close(descriptor)
        wait_for("the port to be free", lambda: not board.info()["opened"])
    if reader == "nobody":
        time.sleep(0.3)  # nothing to wait for: some thirty IMU frames go nowhere
    else:
        wait_for("unread telemetry", lambda: unread_bytes(descriptor) > 20 * 29)
        os.close(descriptor)
        wait_for("the port to be free", lambda: not board.info()["opened"])
    descriptor = open_port(board.link, exclusive=False, line=RRC_PORT)
    assert unread_bytes(descriptor) <= 2 * 29
    os.close(descriptor)


def unread_bytes(descriptor: int) -> int:
    return int(struct.unpack("i", fcntl.ioctl(descriptor, termios.FIONREAD, struct.pack("i", 0)))[0])


@pytest.fixture
def unprivileged_board() -> Iterator[str]:
    """The link of a board that runs without privileges, in a directory of its own."""
    with tempfile.TemporaryDirectory() as directory:
        os.chown(directory, NOBODY, NOBODY)
        link = f"{directory}/board"
        child = os.fork()
        if child == 0:
            try:
                become(NOBODY)
                Simulator(Options(link, imu_hz=0)).run()
            finally:
                os._exit(0)
        try:
            wait_for("the link", lambda: os.path.islink(link))
            yield link
        finally:
            os.kill(child, signal.SIGTERM)
            os.waitpid(child, 0)
        assert os.listdir(directory) == []


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become somebody else")
def test_an_unprivileged_board_frees_its_port_too(unprivileged_board: str) -> None:
    descriptor = open_port(unprivileged_board, exclusive=True, line=RRC_PORT)
    os.write(descriptor, DRIVE)
    os.close(descriptor)
    wait_for("a port that is not claimed", lambda: not _claimed_path(unprivileged_board))
    assert os.stat(unprivileged_board).st_uid == NOBODY
    with connect(unprivileged_board + ".ctl", 5.0) as control:
        control.send(b'{"op": "wheels"}')
        assert json.loads(control.recv(65536))["speeds_rps"] == pytest.approx(FORWARD)


def _claimed_path(path: str) -> bool:
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        return exclusively_claimed(descriptor)
    finally:
        os.close(descriptor)


def test_a_cooked_port_echoes_until_it_is_opened_right(tmp_path: Path) -> None:
    with SimBoard(tmp_path / "board", cooked=True, mode=0o606) as board:
        raw = os.open(board.link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        assert termios.tcgetattr(raw)[3] & termios.ECHO
        assert os.fstat(raw).st_mode & 0o777 == 0o606
        descriptor = open_port(board.link, exclusive=True, line=RRC_PORT)
        assert not termios.tcgetattr(raw)[3] & termios.ECHO
        os.close(raw)
        os.close(descriptor)


def run_sim(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "failstop_lab.sim", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, stdin=subprocess.DEVNULL)


def refused(link: Path) -> str:
    done = run_sim("--device", str(link))
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    return done.stderr


def test_a_link_that_is_something_else_is_refused_untouched(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("precious")
    assert f"{file} exists and is not a symbolic link: remove it" in refused(file)
    assert file.read_text() == "precious"
    device = tmp_path / "device"
    device.symlink_to("/dev/null")
    assert "points to /dev/null, which is no simulated board" in refused(device)
    assert os.readlink(device) == "/dev/null"
    assert "is not a directory" in refused(tmp_path / "none" / "board")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["device", "file"]
    (tmp_path / "board.ctl").write_text("no socket")
    assert "board.ctl exists and is not a socket" in refused(tmp_path / "board")


def test_a_living_boards_link_is_refused_even_unplugged(board: SimBoard) -> None:
    assert "is running at" in refused(Path(board.link))
    board.unplug()
    assert "is running at" in refused(Path(board.link))
    with pytest.raises(SimBoardError, match="is running at"), SimBoard(board.link):
        pass
    board.replug()
    assert board.wheels() == (0.0, 0.0, 0.0, 0.0)


def test_a_dead_boards_link_is_replaced(tmp_path: Path) -> None:
    dead = SimBoard(tmp_path / "board")
    dead.start()
    os.kill(dead.pid, signal.SIGKILL)
    with pytest.raises(SimBoardError, match=r"exit code -9"):
        wait_for("its end", lambda: dead.wheels() is None)
    dead.close()
    assert (tmp_path / "board").is_symlink()
    assert (tmp_path / "board.ctl").exists()
    with SimBoard(tmp_path / "board") as board:
        os.close(open_port(board.link, exclusive=True, line=RRC_PORT))


def test_it_says_which_setting_a_service_for_another_board_needs(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "failstop_lab.sim", "--device", str(tmp_path / "board"), "--board", "hoverboard"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().endswith(' --config FILE, which says board.kind = "hoverboard"\n')
        process.terminate()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_ends_clean_by_signal(number: signal.Signals, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "failstop_lab.sim", "--device", str(tmp_path / "board"), "--verbose"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        ready = process.stdout.readline()
        assert ready.startswith(f"simulated board at {tmp_path}/board (/dev/pts/")
        assert ready.endswith(f"): failstop run --device {tmp_path}/board\n")
        descriptor = open_port(str(tmp_path / "board"), exclusive=True, line=RRC_PORT)
        os.write(descriptor, DRIVE)
        assert "wheels turn   +0.796   +0.796   -0.796   -0.796 rps" in process.stdout.readline()
        os.write(descriptor, codec.STOP)
        assert "wheels stop" in process.stdout.readline()
        process.send_signal(number)
        assert process.wait(20) == 0
        os.close(descriptor)
    assert list(tmp_path.iterdir()) == []


def test_ends_with_its_parent(tmp_path: Path) -> None:
    code = f"import time; from failstop_lab.sim.client import SimBoard; b = SimBoard({str(tmp_path / 'board')!r})\n"
    code += "b.start(); print(b.pid, flush=True); time.sleep(60)"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        parent.kill()
    wait_for("the end of the board", lambda: not os.path.exists(f"/proc/{pid}"))
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_left_after_close(tmp_path: Path) -> None:
    before = sorted(os.listdir("/proc/self/fd"))
    with SimBoard(tmp_path / "board") as board:
        assert os.stat(board.link + ".ctl").st_mode & 0o777 == 0o600
        pid = board.pid
    assert list(tmp_path.iterdir()) == []
    assert not os.path.exists(f"/proc/{pid}")
    assert sorted(os.listdir("/proc/self/fd")) == before
    board.close()
    with pytest.raises(SimBoardError, match="start it first"):
        board.wheels()


def test_bad_requests_are_answered_and_change_nothing(board: SimBoard) -> None:
    with connect(board.link + ".ctl", 5.0) as control:
        for request in (b"no json", b"[]", b"{}", b'{"op": "fly"}', b'{"op": "cut"}', b'{"op": "deaf", "on": 1}'):
            control.send(request)
            assert "error" in json.loads(control.recv(65536)), request
        control.send(b'{"op": "events", "since": 0, "timeout_s": 100}')
    # Gone while waiting, and a board that serves on.
    assert board.info()["executed"] == 0


def test_a_long_path_works(tmp_path: Path) -> None:
    deep = tmp_path / ("d" * 100)
    deep.mkdir()
    with SimBoard(deep / "board") as board:
        os.close(open_port(board.link, exclusive=True, line=RRC_PORT))
        assert board.wheels() == (0.0, 0.0, 0.0, 0.0)
    assert list(deep.iterdir()) == []


def test_record(tmp_path: Path) -> None:
    record = tmp_path / "record.jsonl"
    with SimBoard(tmp_path / "board", record=record) as board:
        descriptor = open_port(board.link, exclusive=True, line=RRC_PORT)
        os.write(descriptor, DRIVE)
        event = board.wait_for(lambda e: e.is_motion, 5.0)
        board.deaf(True)
        os.write(descriptor, codec.STOP)
        os.close(descriptor)
        wait_for("the last chunk", lambda: not board.info()["opened"])
        pid = board.pid
    lines = [json.loads(line) for line in record.read_text().splitlines()]
    assert [line["kind"] for line in lines] == ["chunk", "frame", "fault", "chunk"]
    assert lines[0] == {"kind": "chunk", "t_ns": event.arrival_ns, "hex": DRIVE.hex()}
    assert lines[1].pop("speeds_rps") == pytest.approx(FORWARD)
    times = {"arrival_ns": event.arrival_ns, "executed_ns": event.executed_ns}
    assert lines[1] == {"kind": "frame", "index": 0, **times, "func": 3, "hex": DRIVE[4:-1].hex()}
    assert lines[2]["request"] == {"op": "deaf", "on": True}
    assert lines[3]["hex"] == codec.STOP.hex()
    assert not os.path.exists(f"/proc/{pid}")


def test_record_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    done = run_sim("--device", str(tmp_path / "board"), "--record", str(tmp_path))
    assert done.returncode == 1
    assert "name another file with --record" in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("words", [("--imu-hz", "-1"), ("--imu-hz", "nan"), ("--battery-mv", "70000"), ("--mode", "9")])
def test_impossible_settings_are_refused(words: tuple[str, str], tmp_path: Path) -> None:
    done = run_sim("--device", str(tmp_path / "board"), *words)
    assert done.returncode == 2
    assert words[0] in done.stderr


def test_control_socket_is_a_packet_socket(board: SimBoard) -> None:
    with connect(board.link + ".ctl", 5.0) as control:
        assert control.getsockopt(socket.SOL_SOCKET, socket.SO_TYPE) == socket.SOCK_SEQPACKET
