"""The supervisor's own descriptor: the first bytes of a run, and a burst that is whole or not said to be."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Iterator

import pytest

from failstop.board import port
from failstop.board.burst import BURST
from failstop.supervisor.port import OwnPort
from tests.procs.parts import Pty, new_pty
from tests.unprivileged import unprivileged


def test_the_first_bytes_of_a_run_are_a_burst() -> None:
    with new_pty() as pty:
        own = OwnPort.open_and_stop(pty.link)
        assert pty.read() == BURST
        own.replace(-1)


@pytest.mark.parametrize(
    ("answers", "written"),
    [((397,), True), ((396,), False), ((None, 397), True), ((None, None, None), False)],
    ids=["whole", "cut", "refused once", "refused"],
)
def test_only_a_whole_burst_was_written(
    monkeypatch: pytest.MonkeyPatch, answers: tuple[int | None, ...], written: bool
) -> None:
    left = iter(answers)

    def write(_fd: int, data: bytes) -> int:
        assert data == BURST
        taken = next(left)
        if taken is None:
            raise BlockingIOError
        return taken

    with new_pty() as pty, monkeypatch.context() as patch:
        patch.setattr(os, "write", write)
        assert OwnPort(pty.slave).burst() is written


def test_the_old_descriptor_is_closed() -> None:
    with new_pty() as old, new_pty() as new:
        fd = os.dup(old.slave)
        own = OwnPort(fd)
        own.replace(os.dup(new.slave))
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(fd)
        own.replace(-1)


def opened_by_nobody(path: str, tried: int) -> str:
    """Open as nobody; `tried` is a pipe's end that is closed when it was refused for the first time."""
    real = port.open_port

    def watched(name: str, *, exclusive: bool) -> int:
        try:
            return real(name, exclusive=exclusive)
        finally:
            os.write(tried, b".")

    port.open_port = watched
    try:
        OwnPort.open_and_stop(path)
    except port.PortError as error:
        return error.kind
    return "opened"


@contextlib.contextmanager
def given_to(group: int, mode: int) -> Iterator[tuple[Pty, int, int]]:
    """A port of root's with this group and mode, and a pipe for opened_by_nobody(): what is read, what is written."""
    with new_pty() as pty:
        os.chown(pty.link, 0, group)
        os.chmod(pty.link, mode)
        reader, tried = os.pipe()
        yield pty, reader, tried
        os.close(reader)
        os.close(tried)


@pytest.mark.skipif(os.geteuid() != 0, reason="gives a device away as udev does: only root")
def test_at_boot_a_device_that_udev_is_still_to_give_away_is_waited_for() -> None:
    with given_to(0, 0o600) as (pty, reader, tried):
        udev = threading.Thread(target=lambda: os.read(reader, 1) and os.chmod(pty.link, 0o666))
        udev.start()
        assert unprivileged(lambda: opened_by_nobody(pty.link, tried)) == "opened"
        udev.join()
        assert pty.read() == BURST


@pytest.mark.skipif(os.geteuid() != 0, reason="takes a device away from nobody: only root")
def test_a_device_that_udev_has_given_to_others_is_refused_at_the_first_try() -> None:
    with given_to(1, 0o660) as (pty, reader, tried):
        assert unprivileged(lambda: opened_by_nobody(pty.link, tried)) == "permission"
        assert os.read(reader, 100) == b"."
