"""The opener: a thread that opens the lost port and stops on it, and holds nobody up."""

from __future__ import annotations

import os
import queue
import resource
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

import pytest

from failstop.board.burst import BURST
from failstop.board.finder import Finder
from failstop.procs.world import World
from failstop.shm.bell import EventBell
from failstop.supervisor.port_handover import LOOK_NS, Opener
from tests.support.children import scheduled
from tests.support.ptys import Pty, new_pty, open_fds
from tests.support.waiting import until


@pytest.fixture
def pty() -> Iterator[Pty]:
    with new_pty() as made:
        yield made


@pytest.fixture
def bell() -> Iterator[EventBell]:
    made = EventBell.create()
    yield made
    os.close(made.fd)


def test_a_port_that_is_not_there_is_not_opened(bell: EventBell, tmp_path: Path) -> None:
    opener = Opener(World(), Finder(str(tmp_path / "board")), bell)
    before = open_fds()
    assert not opener.attempt()
    assert opener.take() is None
    assert open_fds() == before
    os.close(opener._spare)


def test_the_burst_is_its_first_bytes_and_it_is_taken_once(bell: EventBell, pty: Pty) -> None:
    opener = Opener(World(), Finder(pty.link), bell)
    assert opener.attempt()
    assert pty.read() == BURST
    found = opener.take()
    assert found is not None
    assert os.ttyname(found[0]) == pty.link
    assert found[1] > 0
    assert opener.take() is None
    os.close(found[0])
    os.close(opener._spare)


def test_a_burst_that_was_not_written_is_not_said_to_be(bell: EventBell, pty: Pty) -> None:
    opener = Opener(World(), Finder(pty.link), bell)
    pty.fill()
    assert opener.attempt()
    found = opener.take()
    assert found is not None
    assert found[1] == 0
    os.close(found[0])
    os.close(opener._spare)


def test_the_number_that_it_keeps_is_there_when_no_other_is(bell: EventBell, pty: Pty) -> None:
    before = open_fds()
    opener = Opener(World(), Finder(pty.link), bell)
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    lowest = os.dup(bell.fd)
    os.close(lowest)
    resource.setrlimit(resource.RLIMIT_NOFILE, (lowest, limits[1]))
    try:
        with pytest.raises(OSError, match="Too many open files"):
            os.dup(bell.fd)
        assert opener.attempt()
        found = opener.take()
        assert found is not None
        os.close(found[0])
        assert opener.attempt(), "without a number to keep it goes on with what there is"
        found = opener.take()
        assert found is not None
        os.close(found[0])
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
        os.close(opener._spare) if opener._spare >= 0 else None
    assert open_fds() == before, "who has no number to give back closes no other's"


class Slow(Finder):
    """An open that takes until it is let go on; `times` of them fail first."""

    def __init__(self, path: str, times: int) -> None:
        super().__init__(path)
        self.times = times
        self.looked = 0
        self.opening = threading.Event()
        self.go_on = threading.Event()

    def open(self, now_ns: int) -> int:
        self.looked += 1
        if self.looked <= self.times:
            return -1
        self.opening.set()
        assert self.go_on.wait(20.0)
        self.go_on.clear()
        return super().open(now_ns)


def test_its_thread_opens_what_was_lost_again_and_again_and_an_open_that_takes_long_holds_nobody_up(
    bell: EventBell, pty: Pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    slept: list[float] = []
    finder = Slow(pty.link, times=3)
    opener = Opener(World(sleep=slept.append), finder, bell)
    opener.begin()
    for _ in range(2):
        assert opener.take() is None
        opener.look()
        assert finder.opening.wait(20.0)
        finder.opening.clear()
        assert opener.take() is None, "and this thread goes on"
        finder.go_on.set()
        found: list[Any] = []
        until(lambda found=found: found.append(opener.take()) or found[-1], "the port")  # type: ignore[misc]
        assert pty.read() == BURST
        os.close(found[-1][0])
    assert slept == [LOOK_NS / 1e9] * 3
    assert finder.looked == 5, "and it rests when it has opened one"


def test_its_thread_has_the_supervisor_s_rights_to_run(bell: EventBell, tmp_path: Path) -> None:
    """The kernel takes them from what a process starts; without them a busy machine would put the stop off."""
    found: queue.SimpleQueue[tuple[int, int]] = queue.SimpleQueue()

    def sleep(_seconds: float) -> NoReturn:
        """The thread has looked once; this was all."""
        found.put((os.sched_getscheduler(0), os.sched_getparam(0).sched_priority))
        sys.exit()

    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK  # as procs/rights.py has it
    opener = Opener(World(sleep=sleep), Finder(str(tmp_path / "board")), bell)
    try:
        with scheduled(policy, 3):
            opener.begin()
    except PermissionError:
        pytest.skip("needs the right to real-time scheduling")
    opener.look()
    assert found.get(timeout=20.0) == (policy, 3)
    os.close(opener._spare)
