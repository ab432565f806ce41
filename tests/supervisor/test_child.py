"""How a process ends that does not know what to do."""

from __future__ import annotations

import atexit
import contextlib
import os

import pytest

from failstop.supervisor.child import fail
from tests.support.children import Child


def broken() -> None:
    """Fails as a defect would."""
    raise ValueError("seven\u2026 " + "x" * 10_000 if os.environ.get("LONG") else "seven\u2026")


def failing(stderr: int) -> int:
    """The exit code of a process that fails."""

    def work(*_: object) -> None:
        os.dup2(stderr, 2)
        atexit.register(os.write, 2, b"taken down")
        try:
            broken()
        except ValueError as error:
            fail(error)

    with Child(work) as child:
        return child.wait()


def test_it_says_what_went_wrong_and_is_gone(pipe: tuple[int, int]) -> None:
    """Without what an interpreter does at its end."""
    assert failing(pipe[1]) == 1
    first, *frames, last = os.read(pipe[0], 65536).decode().splitlines()
    assert (first, last) == ("Traceback (most recent call last):", "ValueError: seven\u2026")
    assert len(frames) == 2
    assert frames[1].endswith(", in broken")
    assert f'File "{__file__}", line ' in frames[1]


def test_what_is_long_is_cut(pipe: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LONG", "1")
    assert failing(pipe[1]) == 1
    assert len(os.read(pipe[0], 65536)) == 4096


def test_nobody_who_reads_it_holds_it_up(pipe: tuple[int, int]) -> None:
    os.set_blocking(pipe[1], False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(pipe[1], bytes(1))
    os.set_blocking(pipe[1], True)
    assert failing(pipe[1]) == 1


def test_nor_does_a_stderr_that_nobody_has_open() -> None:
    read, write = os.pipe()
    os.close(read)
    assert failing(write) == 1
    os.close(write)
