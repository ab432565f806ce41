"""Waits and ptys for tests of the processes: waiting for a condition, raw ptys, and the board at their other end."""

from __future__ import annotations

import contextlib
import fcntl
import gc
import os
import pty
import select
import termios
import tty
from collections.abc import Iterator
from pathlib import Path

from failstop.board.rrc.framing import MOTOR
from failstop_lab.sim.motors import Motors
from failstop_lab.sim.receiver import Receiver

DEADLINE_S = 20.0
HELD = 4095
"""Bytes that a side of a pty holds unread, at least (the kernel's N_TTY_BUF_SIZE less one)."""


def open_fds() -> int:
    """The number of descriptors that this process has open, but for those of garbage that earlier tests have left."""
    gc.collect()
    return len(os.listdir("/proc/self/fd"))


def fill(port: int, board: int) -> int:
    """Write zeros, which the board ignores, to this side of a raw pty until the kernel takes no more; returns how many
    it took. It goes on moving bytes to the other side, which makes room again, until that side holds all that it can,
    and gives room back a moment later: so until that is over too."""
    taken = refused = there = 0
    while refused < 20 or there < HELD:
        try:
            taken += os.write(port, bytes(1000 if refused == 0 else 1))
            refused = 0
        except BlockingIOError:
            refused += 1
            there = int.from_bytes(fcntl.ioctl(board, termios.FIONREAD, bytes(4)), "little")
            select.select([], [], [], 0.0005)
    return taken


class Pty:
    """A raw, non-blocking pty: `slave` is the port, `master` the board's side; `link` is the port's path."""

    def __init__(self) -> None:
        self.master, self.slave = pty.openpty()
        tty.setraw(self.slave)
        os.set_blocking(self.slave, False)
        os.set_blocking(self.master, False)
        self.link = os.ttyname(self.slave)

    def read(self) -> bytes:
        data = b""
        with contextlib.suppress(BlockingIOError):
            while part := os.read(self.master, 65536):
                data += part
        return data

    def fill(self) -> int:
        """Write until the kernel takes no more; returns how many bytes it took."""
        return fill(self.slave, self.master)

    def unplug(self) -> None:
        """The board's side goes away: the port is hung up."""
        if self.master >= 0:
            os.close(self.master)
            self.master = -1

    def close(self) -> None:
        """Give both sides back; a side that the test has closed must be set to -1."""
        self.unplug()
        if self.slave >= 0:
            os.close(self.slave)
            self.slave = -1


@contextlib.contextmanager
def new_pty() -> Iterator[Pty]:
    made = Pty()
    try:
        yield made
    finally:
        made.close()


@contextlib.contextmanager
def bare_port(link: Path) -> Iterator[int]:
    """A port behind this link that no program has open for writing, as a driver would; yields the board's side."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    link.symlink_to(os.ttyname(slave))
    keeps = os.open(link, os.O_RDONLY | os.O_NOCTTY)
    os.close(slave)
    try:
        yield master
    finally:
        os.close(master)
        os.close(keeps)


class Board:
    """The board's receiver and motors: `executed` holds the four speeds after each motor frame, with its data."""

    def __init__(self, speeds: tuple[float, float, float, float] = (0.5, -0.25, 0.75, -1.0)) -> None:
        self.receiver = Receiver()
        self.motors = Motors(speeds)
        self.executed: list[tuple[bytes, tuple[float, ...]]] = []

    def feed(self, data: bytes) -> None:
        for _, func, body in self.receiver.feed(data):
            if func == MOTOR:
                self.executed.append((body, self.motors.execute(body)))
