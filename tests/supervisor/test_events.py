"""Lines for people: one each, and never a reason to stop working."""

from __future__ import annotations

import contextlib
import os
import select
from collections.abc import Iterator

import pytest

from failstop.supervisor.events import say


@contextlib.contextmanager
def stderr_is(fd: int) -> Iterator[None]:
    """Another descriptor in the place of descriptor 2; inside the test, since the test runner moves it about too."""
    saved = os.dup(2)
    os.dup2(fd, 2)
    try:
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    ends = os.pipe()
    yield ends
    for fd in ends:
        os.close(fd)


@pytest.mark.parametrize(
    ("message", "line"),
    [
        ("E-STOP latched: key1", b"failstop: E-STOP latched: key1\n"),
        ("\udcff \u2713", "failstop: ? \u2713\n".encode()),
    ],
)
def test_one_line(pipe: tuple[int, int], message: str, line: bytes) -> None:
    with stderr_is(pipe[1]):
        say(message)
    assert os.read(pipe[0], 1000) == line


def test_a_pipe_that_nobody_reads_does_not_hold_up_the_supervisor(pipe: tuple[int, int]) -> None:
    """A plain write would block for ever, and the watch over every process with it."""
    while select.select((), (pipe[1],), (), 0)[1]:
        os.write(pipe[1], bytes(4096))
    with stderr_is(pipe[1]):
        say("E-STOP latched: key1")


def test_a_pipe_whose_reader_has_gone_is_no_error() -> None:
    out, into = os.pipe()
    os.close(out)
    with stderr_is(into):
        say("E-STOP latched: key1")
    os.close(into)


def test_a_closed_stderr_is_no_error() -> None:
    saved = os.dup(2)
    os.close(2)
    try:
        say("E-STOP latched: key1")
    finally:
        os.dup2(saved, 2)
        os.close(saved)
