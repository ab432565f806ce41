"""The pseudo-terminal between two drivers: the second one finds it as the first did, and one that stays keeps it."""

from __future__ import annotations

import os
import termios
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from failstop.guard.pty import Pty


@pytest.fixture
def pty(tmp_path: Path) -> Iterator[Pty]:
    pty = Pty(str(tmp_path / "port"))
    yield pty
    pty.close()


def _stop(fd: int) -> None:
    termios.tcflow(fd, termios.TCOOFF)


def _listen_to_xoff(fd: int) -> None:
    settings = termios.tcgetattr(fd)
    settings[0] |= termios.IXON
    termios.tcsetattr(fd, termios.TCSANOW, settings)


def _edit_lines(fd: int) -> None:
    settings = termios.tcgetattr(fd)
    settings[3] |= termios.ICANON | termios.ECHO | termios.ISIG
    settings[1] |= termios.OPOST | termios.ONLCR
    termios.tcsetattr(fd, termios.TCSANOW, settings)


@pytest.mark.parametrize("leaves", [_stop, _listen_to_xoff, _edit_lines], ids=["stopped", "XOFF", "lines"])
def test_nothing_that_a_driver_sets_is_left_for_the_next_one(pty: Pty, leaves: Callable[[int], None]) -> None:
    first = os.open(pty.path, os.O_RDWR | os.O_NOCTTY)
    leaves(first)
    pty.write(b"\x13")
    os.close(first)
    pty.clean()
    second = os.open(pty.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        os.write(second, b"m 10 10\r\n")
        assert pty.read()[0] == b"m 10 10\r\n"
        pty.write(b"OK\r\n")
        assert os.read(second, 100) == b"OK\r\n"
    finally:
        os.close(second)


def _wait_half_a_second(fd: int) -> None:
    settings = termios.tcgetattr(fd)
    settings[6][termios.VMIN], settings[6][termios.VTIME] = 0, 5
    termios.tcsetattr(fd, termios.TCSANOW, settings)


def test_for_a_program_that_stays_nothing_changes_when_another_one_closes_the_port(pty: Pty) -> None:
    stays, closes = (os.open(pty.path, os.O_RDWR | os.O_NOCTTY) for _ in range(2))
    try:
        _wait_half_a_second(stays)
        before = termios.tcgetattr(stays)
        pty.write(b"57600\r\n")
        os.write(stays, b"e\r")
        os.close(closes)
        assert pty.clean(shared=True, opened=True) == b"e\r"
        assert termios.tcgetattr(stays) == before
        assert os.read(stays, 100) == b"57600\r\n", "an answer that it has not read yet"
    finally:
        os.close(stays)


def test_a_program_that_opens_the_port_at_once_keeps_its_settings_and_gets_no_old_answer(pty: Pty) -> None:
    os.close(first := os.open(pty.path, os.O_RDWR | os.O_NOCTTY))
    pty.write(b"57600\r\n")
    second = os.open(pty.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        _wait_half_a_second(second)
        before = termios.tcgetattr(second)
        _stop(second)
        assert pty.clean(opened=True) == b""
        assert termios.tcgetattr(second) == before
        with pytest.raises(BlockingIOError):
            os.read(second, 100)
        assert os.write(second, b"e\r") == 2, f"descriptor {first} left the output stopped"
    finally:
        os.close(second)


@pytest.mark.parametrize("shared", [True, False])
def test_the_echo_is_off_for_whoever_has_the_port(pty: Pty, shared: bool) -> None:
    """The guard would read the board's bytes back as if a driver had written them."""
    fd = os.open(pty.path, os.O_RDWR | os.O_NOCTTY)
    try:
        _edit_lines(fd)
        pty.clean(shared=shared, opened=True)
        pty.write(b"57600\r\n")
        assert pty.read()[0] == b""
    finally:
        os.close(fd)
