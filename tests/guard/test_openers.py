"""What the kernel says of those who open and close the pseudo-terminal."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from failstop.guard.openers import Watch


@pytest.fixture
def pty_path() -> Iterator[str]:
    master, slave = os.openpty()
    yield os.ttyname(slave)
    for fd in (master, slave):
        os.close(fd)


@pytest.fixture
def watch(pty_path: str) -> Iterator[Watch]:
    watch = Watch(pty_path)
    yield watch
    watch.close()


def test_two_that_close_it_in_one_moment_are_two(watch: Watch, pty_path: str) -> None:
    several = [os.open(pty_path, os.O_RDWR | os.O_NOCTTY) for _ in range(3)]
    for fd in several:
        os.close(fd)
    assert watch.events() == [True, True, True, False, False, False]


def test_other_terminals_say_nothing_of_it(watch: Watch) -> None:
    master, other = os.openpty()
    os.close(os.open(os.ttyname(other), os.O_RDWR | os.O_NOCTTY))
    assert watch.events() == []
    for fd in (master, other):
        os.close(fd)
