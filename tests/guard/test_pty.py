"""The pseudo-terminal between two drivers: the second one finds it as the first did."""

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
