"""Opening the port: raw and transparent, the right refusals with their remedies, and nothing left behind. And closing
it: at once, even where the kernel would wait for bytes that nobody takes."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import re
import select
import signal
import socket
import struct
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from failstop.board import port
from failstop.board.port import PortError, open_port
from failstop.board.rrc.board import RRC_PORT
from tests.support.unprivileged import unprivileged

TIOCGEXCL = 0x80045440


@pytest.fixture
def pty() -> Iterator[tuple[int, str]]:
    """A pty as the kernel makes it, in the terminal mode of a real port: (master, path of the slave)."""
    master, slave = os.openpty()
    yield master, os.ttyname(slave)
    os.close(slave)
    os.close(master)


def read_exactly(descriptor: int, size: int) -> bytes:
    data = b""
    while len(data) < size:
        assert select.select([descriptor], [], [], 10.0)[0], f"{len(data)} of {size} bytes within 10 s"
        data += os.read(descriptor, size - len(data))
    return data


def refusal(path: str) -> str:
    """Kind and message of the error that opening gives."""
    try:
        os.close(open_port(path, exclusive=True, line=RRC_PORT))
    except PortError as error:
        return f"{error.kind}|{error.errno}|{error}"
    return "opened"


def test_every_byte_passes_unchanged_both_ways(pty: tuple[int, str]) -> None:
    master, path = pty
    descriptor = open_port(path, exclusive=False, line=RRC_PORT)
    everything = bytes(range(256)) * 4
    os.write(descriptor, everything)
    assert read_exactly(master, len(everything)) == everything
    os.write(master, everything)
    assert read_exactly(descriptor, len(everything)) == everything
    # And nothing was echoed.
    assert select.select([master], [], [], 0.05)[0] == []
    os.close(descriptor)


def test_the_terminal_is_raw_and_the_descriptor_neither_blocks_nor_is_inherited(pty: tuple[int, str]) -> None:
    descriptor = open_port(pty[1], exclusive=False, line=RRC_PORT)
    iflag, oflag, cflag, lflag, *speeds, cc = termios.tcgetattr(descriptor)
    assert (iflag, oflag, lflag, speeds) == (0, 0, 0, [termios.B1000000] * 2)
    assert cflag & (termios.CSIZE | termios.CSTOPB | termios.PARENB | termios.CRTSCTS) == termios.CS8
    assert [bool(cflag & flag) for flag in (termios.CREAD, termios.CLOCAL, termios.HUPCL)] == [True, True, False]
    assert (cc[termios.VMIN], cc[termios.VTIME]) == (1, 0)
    assert fcntl.fcntl(descriptor, fcntl.F_GETFD) & fcntl.FD_CLOEXEC
    with pytest.raises(BlockingIOError):
        os.read(descriptor, 1)
    os.close(descriptor)


def test_hupcl_is_cleared_when_it_was_set(pty: tuple[int, str]) -> None:
    slave = os.open(pty[1], os.O_RDWR | os.O_NOCTTY)
    settings = termios.tcgetattr(slave)
    settings[2] |= termios.HUPCL | termios.CSTOPB | termios.PARENB
    termios.tcsetattr(slave, termios.TCSANOW, settings)
    assert termios.tcgetattr(slave)[2] & termios.HUPCL
    os.close(open_port(pty[1], exclusive=False, line=RRC_PORT))
    assert not termios.tcgetattr(slave)[2] & (termios.HUPCL | termios.CSTOPB | termios.PARENB)
    os.close(slave)


def test_output_that_somebody_has_stopped_goes_on(pty: tuple[int, str]) -> None:
    master, path = pty
    stop = "import sys, termios; termios.tcflow(sys.stdin.fileno(), termios.TCOOFF)"
    with open(path, "rb", buffering=0) as held:
        subprocess.run([sys.executable, "-c", stop], stdin=held, timeout=20, check=True)
        with pytest.raises(BlockingIOError):
            os.write(other := os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK), b"kept back")
        os.close(other)
    descriptor = open_port(path, exclusive=True, line=RRC_PORT)
    os.write(descriptor, b"stop")
    assert read_exactly(master, 4) == b"stop"
    os.close(descriptor)


def test_it_does_not_become_the_controlling_terminal(pty: tuple[int, str]) -> None:
    def work() -> str:
        os.setsid()
        os.close(open_port(pty[1], exclusive=False, line=RRC_PORT))
        try:
            os.close(os.open("/dev/tty", os.O_RDWR))
        except OSError as error:
            return str(error.errno)
        return "has a controlling terminal"

    os.chmod(pty[1], 0o666)
    assert unprivileged(work) == str(errno.ENXIO)


def test_dtr_is_set_and_rts_cleared_and_a_failure_leaks_nothing(
    pty: tuple[int, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[int, int]] = []
    really, before = fcntl.ioctl, sorted(os.listdir("/proc/self/fd"))

    def ioctl(descriptor: int, request: int, argument: bytes = b"") -> object:
        if request not in (termios.TIOCMBIS, termios.TIOCMBIC, termios.TIOCMSET):
            return really(descriptor, request, argument)
        asked.append((request, struct.unpack("i", argument)[0]))
        if len(asked) == 4:
            raise OSError(errno.EIO, "gone")
        return 0

    monkeypatch.setattr(fcntl, "ioctl", ioctl)
    os.close(open_port(pty[1], exclusive=True, line=RRC_PORT))
    assert asked == [(termios.TIOCMBIS, termios.TIOCM_DTR), (termios.TIOCMBIC, termios.TIOCM_RTS)]
    kind, number, text = refusal(pty[1]).split("|")
    assert (kind, int(number)) == ("io", errno.EIO)
    assert "unplug the board and plug it in again" in text
    assert sorted(os.listdir("/proc/self/fd")) == before


def claimed(descriptor: int) -> bool:
    return bool(struct.unpack("i", fcntl.ioctl(descriptor, TIOCGEXCL, struct.pack("i", 0)))[0])


def test_exclusive_is_the_terminals_own_and_can_be_released(pty: tuple[int, str]) -> None:
    shared = open_port(pty[1], exclusive=False, line=RRC_PORT)
    assert not claimed(shared)
    exclusive = open_port(pty[1], exclusive=True, line=RRC_PORT)
    assert claimed(shared)
    port.release_exclusive(exclusive)
    assert not claimed(shared)
    os.close(exclusive)
    os.close(shared)


def let_everybody_open(descriptor: int) -> None:
    """As root may, whom TIOCEXCL does not hold up."""
    fcntl.ioctl(descriptor, termios.TIOCNXCL)


def test_a_second_service_is_kept_out_by_the_lock_where_the_claim_does_not_hold(pty: tuple[int, str]) -> None:
    first = open_port(pty[1], exclusive=True, line=RRC_PORT)
    let_everybody_open(first)
    settings = termios.tcgetattr(first)
    settings[2] |= termios.HUPCL
    termios.tcsetattr(first, termios.TCSANOW, settings)
    with pytest.raises(PortError) as caught:
        open_port(pty[1], exclusive=True, line=RRC_PORT)
    assert (caught.value.kind, caught.value.errno) == ("busy", errno.EBUSY)
    assert str(caught.value) == f"{pty[1]} is held by another process (flock): stop it first"
    assert not claimed(first), "a refusal leaves no claim, which would outlive it"
    assert termios.tcgetattr(first) == settings, "nor anything else"
    assert port.open_if_there(pty[1], RRC_PORT) == -1
    os.close(open_port(pty[1], exclusive=False, line=RRC_PORT))
    os.close(first)
    os.close(open_port(pty[1], exclusive=True, line=RRC_PORT))


def test_the_lock_is_held_by_every_duplicate_and_let_go_with_the_claim(pty: tuple[int, str]) -> None:
    first = open_port(pty[1], exclusive=True, line=RRC_PORT)
    handed = os.dup(first)
    os.close(first)
    let_everybody_open(handed)
    with pytest.raises(PortError, match="flock"):
        open_port(pty[1], exclusive=True, line=RRC_PORT)
    port.release_exclusive(handed)
    second = open_port(pty[1], exclusive=True, line=RRC_PORT)
    os.close(second)
    os.close(handed)


def test_busy_names_the_claim(pty: tuple[int, str]) -> None:
    os.chmod(pty[1], 0o666)
    descriptor = open_port(pty[1], exclusive=True, line=RRC_PORT)
    kind, number, message = unprivileged(lambda: refusal(pty[1])).split("|")
    assert (kind, int(number)) == ("busy", errno.EBUSY)
    assert message == f"{pty[1]} is held exclusively by another process (TIOCEXCL): stop it first"
    port.release_exclusive(descriptor)
    assert unprivileged(lambda: refusal(pty[1])) == "opened"
    os.close(descriptor)


def test_permission_names_owner_group_and_remedy(pty: tuple[int, str]) -> None:
    os.chmod(pty[1], 0o000)
    kind, number, message = unprivileged(lambda: refusal(pty[1])).split("|")
    assert (kind, int(number)) == ("permission", errno.EACCES)
    told = rf"no permission to open {pty[1]}: .* belongs to \w+:\w+, mode 0000: run as the service's"
    assert re.search(told, message)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give the node to another group")
def test_permission_says_which_group_to_join(pty: tuple[int, str]) -> None:
    os.chown(pty[1], 0, 20)
    os.chmod(pty[1], 0o660)
    assert "mode 0660: usermod -aG dialout USER" in unprivileged(lambda: refusal(pty[1]))
    # A group without a name is named by its number.
    os.chown(pty[1], 54321, 54322)
    said = unprivileged(lambda: refusal(pty[1]))
    assert "belongs to 54321:54322" in said
    assert "usermod -aG 54322 USER" in said


def test_a_directory_in_the_way_is_named_and_what_is_absent_has_its_remedy(tmp_path: Path) -> None:
    shut = tmp_path / "shut"
    shut.mkdir(mode=0o000)
    said = unprivileged(lambda: refusal(str(shut / "port")))
    assert said.startswith("permission|")
    assert "open its directory" in said
    (tmp_path / "board").symlink_to("/dev/pts/no-such")
    for path in ("/dev/failstop-no-such-device", "/etc/passwd/port", str(tmp_path / "board")):
        kind, _, text = refusal(path).split("|")
        assert (kind, text) == ("absent", f"no device {path}: plug the board in, or name another with --device")


MADE: dict[str, Callable[[Path], object]] = {
    "a regular file": lambda path: path.write_bytes(b"precious"),
    "a FIFO": os.mkfifo,
    "a directory": Path.mkdir,
    "a socket": lambda path: socket.socket(socket.AF_UNIX).bind(str(path)),
    "a character device": lambda path: path.symlink_to("/dev/null"),
}


@pytest.mark.parametrize("what", MADE)
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_what_is_no_terminal_is_refused_untouched(what: str, tmp_path: Path) -> None:
    path = tmp_path / "thing"
    MADE[what](path)
    before = path.stat()
    kind, _, said = refusal(str(path)).split("|")
    assert (kind, said.startswith(str(path)), "--device" in said) == ("not-a-tty", True, True)
    assert what == "a character device" or what in said
    after = path.stat()
    assert (after.st_mtime_ns, after.st_size, after.st_mode) == (before.st_mtime_ns, before.st_size, before.st_mode)
    if what == "a FIFO":
        reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        assert refusal(str(path)).startswith("not-a-tty|")
        # No writer has ever come: a FIFO would otherwise be at its end with a hang-up.
        poll = select.poll()
        poll.register(reader, select.POLLIN)
        assert poll.poll(0) == []
        os.close(reader)


def test_no_descriptor_is_left_after_any_refusal(pty: tuple[int, str], tmp_path: Path) -> None:
    before = sorted(os.listdir("/proc/self/fd"))
    for path in ("/dev/null", str(tmp_path), "/dev/failstop-no-such-device"):
        assert refusal(path) != "opened"
    assert refusal(pty[1]) == "opened"
    master, slave = os.openpty()
    hung_up = f"/proc/self/fd/{slave}"
    os.close(master)
    kind, _, message = refusal(hung_up).split("|")
    os.close(slave)
    assert (kind, hung_up in message) == ("io", True)
    assert sorted(os.listdir("/proc/self/fd")) == before


def speeds_told(monkeypatch: pytest.MonkeyPatch, path: str, *, exclusive: bool) -> list[int]:
    """The output speeds that one opening has set, in order."""
    told: list[int] = []
    real = termios.tcsetattr

    def watched(descriptor: int, when: int, attributes: list[Any]) -> None:
        told.append(attributes[5])
        real(descriptor, when, attributes)

    with monkeypatch.context() as patch:
        patch.setattr(termios, "tcsetattr", watched)
        os.close(open_port(path, exclusive=exclusive, line=RRC_PORT))
    return told


@pytest.mark.parametrize("exclusive", [True, False])
def test_the_speed_is_set_to_another_and_back_although_it_is_set_already(
    pty: tuple[int, str], monkeypatch: pytest.MonkeyPatch, exclusive: bool
) -> None:
    """cdc_acm sends a line coding only when it differs from the last one, and a chip that was reset has lost it."""
    for _ in range(2):
        told = speeds_told(monkeypatch, pty[1], exclusive=exclusive)
        assert told[-1] == termios.B1000000
        assert any(speed != termios.B1000000 for speed in told[:-1])


def test_beside_a_service_with_the_port_no_speed_is_changed(
    pty: tuple[int, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    service = open_port(pty[1], exclusive=True, line=RRC_PORT)
    if os.geteuid():
        port.fcntl.ioctl(service, termios.TIOCNXCL)  # type: ignore[attr-defined]
    assert set(speeds_told(monkeypatch, pty[1], exclusive=False)) == {termios.B1000000}
    os.close(service)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root opens a port that a service has")
def test_the_rate_of_a_service_stays_whatever_board_root_takes_its_board_for(pty: tuple[int, str]) -> None:
    """The service's own stops would not arrive at another rate."""
    master, path = pty
    service = open_port(path, exclusive=True, line=RRC_PORT.at(115_200))
    settings = termios.tcgetattr(service)
    termios.tcflow(service, termios.TCOOFF)
    root_s = open_port(path, exclusive=False, line=RRC_PORT)
    assert termios.tcgetattr(service) == settings
    os.write(root_s, b"stop")
    assert read_exactly(master, 4) == b"stop"
    os.close(root_s)
    os.close(service)


def test_beside_a_program_that_only_locks_the_port_the_rate_is_set(pty: tuple[int, str]) -> None:
    """As pyserial's `exclusive` does. Its rate is that of whatever it takes the board for."""
    other = open_port(pty[1], exclusive=False, line=RRC_PORT.at(115_200))
    fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
    os.close(open_port(pty[1], exclusive=False, line=RRC_PORT))
    assert termios.tcgetattr(other)[4:6] == [termios.B1000000] * 2
    os.close(other)


def stuck_socket() -> tuple[int, socket.socket]:
    """A descriptor whose close waits, as a port's that does not drain: TCP with a full buffer, an hour of linger and a
    peer that does not read; and the peer."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        sender = socket.create_connection(server.getsockname())
        peer, _ = server.accept()
    sender.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 3600))
    sender.setblocking(False)
    with contextlib.suppress(BlockingIOError):
        while True:
            sender.send(bytes(65536))
    sender.setblocking(True)
    return sender.detach(), peer


def test_a_close_that_would_wait_for_an_hour_is_cut_short_and_gives_the_timer_back() -> None:
    handler = signal.getsignal(signal.SIGALRM)
    descriptor, peer = stuck_socket()
    others = signal.setitimer(signal.ITIMER_REAL, 1000.0, 7.0)
    started_s = time.monotonic()
    port.close_port(descriptor)
    took_s = time.monotonic() - started_s
    left_s, every_s = signal.setitimer(signal.ITIMER_REAL, *others)
    assert took_s < 5.0
    assert 900.0 < left_s <= 1000.0
    assert every_s == 7.0
    assert signal.getsignal(signal.SIGALRM) == handler
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(descriptor)
    peer.close()


def test_closing_what_is_closed_already_is_fine() -> None:
    reader, writer = os.pipe()
    os.close(writer)
    port.close_port(reader)
    port.close_port(reader)


def test_closing_in_another_thread_closes() -> None:
    master, slave = os.openpty()
    descriptor = open_port(os.ttyname(slave), exclusive=True, line=RRC_PORT)
    thread = threading.Thread(target=port.close_port, args=(descriptor,))
    thread.start()
    thread.join(10.0)
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(descriptor)
    os.close(slave)
    os.close(master)
