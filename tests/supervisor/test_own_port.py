"""The supervisor's own descriptor: the first bytes of a run, and a burst that is whole or not said to be."""

from __future__ import annotations

import os

import pytest

from failstop.board.burst import BURST
from failstop.supervisor.port import OwnPort
from tests.procs.parts import new_pty


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
