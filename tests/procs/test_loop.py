"""Loop: what is ready, hang-ups alone, and time-outs finer than a millisecond."""

from __future__ import annotations

import os
import pty
import time
import tty
from collections.abc import Iterator

import pytest

from failstop.procs.loop import GONE, HANGUP, READ, WRITE, Loop

LATER_NS = 20_000_000_000


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    ends = os.pipe()
    yield ends
    for fd in ends:
        os.close(fd)


def test_ready_descriptors_with_their_events(pipe: tuple[int, int]) -> None:
    loop = Loop()
    loop.watch(pipe[0], READ)
    assert loop.wait(0) == {}
    os.write(pipe[1], b"x")
    assert loop.wait(time.monotonic_ns() + LATER_NS) == {pipe[0]: READ}
    assert loop.wait(0) == {pipe[0]: READ}, "it stays ready until it is read"
    os.read(pipe[0], 1)
    assert loop.wait(0) == {}


def test_a_time_that_is_over_returns_at_once(pipe: tuple[int, int]) -> None:
    loop = Loop()
    loop.watch(pipe[0], READ)
    assert loop.wait(time.monotonic_ns() - LATER_NS) == {}


def test_waits_until_the_time_and_no_shorter() -> None:
    loop = Loop()
    until_ns = time.monotonic_ns() + 2_000_000
    assert loop.wait(until_ns) == {}
    assert time.monotonic_ns() >= until_ns


def test_time_outs_are_finer_than_a_millisecond() -> None:
    loop = Loop()
    shortest_ns = LATER_NS
    for _ in range(200):
        start_ns = time.monotonic_ns()
        loop.wait(start_ns + 100_000)
        shortest_ns = min(shortest_ns, time.monotonic_ns() - start_ns)
    assert 100_000 <= shortest_ns < 1_000_000


def test_watching_again_changes_the_events(pipe: tuple[int, int]) -> None:
    loop = Loop()
    loop.watch(pipe[1], READ)
    assert loop.wait(0) == {}
    loop.watch(pipe[1], READ | WRITE)
    assert loop.wait(0) == {pipe[1]: WRITE}
    loop.watch(pipe[1], READ)
    assert loop.wait(0) == {}


def test_forgotten_descriptors_stay_out(pipe: tuple[int, int]) -> None:
    loop = Loop()
    loop.watch(pipe[0], READ)
    os.write(pipe[1], b"x")
    loop.forget(pipe[0])
    assert loop.wait(0) == {}
    loop.watch(pipe[0], READ)
    assert loop.wait(0) == {pipe[0]: READ}


def test_hang_up_alone_ignores_bytes_but_not_the_end() -> None:
    master, slave = pty.openpty()
    tty.setraw(slave)
    loop = Loop()
    loop.watch(slave, HANGUP)
    os.write(master, b"telemetry")
    assert loop.wait(time.monotonic_ns() + 5_000_000) == {}
    os.close(master)
    assert loop.wait(time.monotonic_ns() + LATER_NS)[slave] & GONE
    loop.forget(slave)
    os.close(slave)
