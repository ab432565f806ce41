"""A futex that tells of a program's death, held by a thread of its own that never outlives its use."""

from __future__ import annotations

import contextlib
import errno
import os
import resource
import signal
import threading
from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from failstop.api.held import HeldByThread
from failstop.shm.futex import Futex
from failstop.shm.segment import Segment
from failstop.shm.words import LINE_BYTES
from tests.support.children import call
from tests.support.ptys import open_fds

from .dying import ends, threads


def test_a_thread_of_its_own_holds_and_lets_go(lines: Segment) -> None:
    word = lines.futex("held", 20)
    with ends() as before:
        one = HeldByThread(lines.futex("held", 20, write=True))
        assert word.held()
        assert not lines.futex("held", 21).held(), "one line alone"
        assert len(threads() - before) == 1
        one.let_go()
    assert word.held(), "the word is the caller's to clear: the end of the thread is no death"


def test_a_word_that_no_thread_can_hold_keeps_no_descriptor(lines: Segment, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> int:
        raise RuntimeError("can't start new thread")

    word, before = lines.futex("held", 22, write=True), open_fds()
    monkeypatch.setattr("_thread.start_new_thread", refuse)
    with pytest.raises(RuntimeError, match="can't start new thread"):
        HeldByThread(word)
    assert open_fds() == before


class Interrupted(Exception):
    """The exception that a program's signal handler raises."""


@contextlib.contextmanager
def raising_at_alarm() -> Iterator[threading.Event]:
    """The handler of SIGALRM raises, the first time that it comes; the event is then set."""
    raised = threading.Event()

    def handler(*_: object) -> None:
        if not raised.is_set():
            raised.set()
            raise Interrupted

    before = signal.signal(signal.SIGALRM, handler)
    try:
        yield raised
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def test_an_exception_of_a_signal_s_handler_leaves_no_thread(lines: Segment) -> None:
    """It comes while the thread has begun and does not hold the word yet; then the caller gives the file back."""
    descriptors, may_hold = len(os.listdir("/proc/self/fd")), threading.Event()
    with ends() as before:
        with raising_at_alarm() as raised:

            class Slow(Futex):
                """One that takes its time."""

                def hold(self, lines: int = 1) -> object:
                    while not raised.wait(0.001):  # a signal that comes just before a wait for a lock does not end that
                        os.kill(os.getpid(), signal.SIGALRM)
                    assert may_hold.wait(20.0)
                    return super().hold(lines)

            word = Slow(lines.fileno(), lines.spec.offsets["held"] + 40 * LINE_BYTES, write=True)
            with pytest.raises(Interrupted):
                HeldByThread(word)
        assert len(threads() - before) == 1, "its thread has begun"
        lines.close()
        other = os.open(os.devnull, os.O_RDONLY)  # the file that has the number now
        may_hold.set()
    os.close(other)
    assert len(os.listdir("/proc/self/fd")) == descriptors - 1, "the caller's"


def test_the_thread_of_what_nobody_refers_to_ends(lines: Segment) -> None:
    with ends() as before:
        one = HeldByThread(lines.futex("held", 41, write=True))
        assert len(threads() - before) == 1
        del one


def test_whatever_moment_the_exception_comes_at_no_thread_is_left(lines: Segment) -> None:
    interrupted = 0
    with ends():
        for number in range(200):
            word = lines.futex("held", 42, write=True)
            with raising_at_alarm():
                try:
                    signal.setitimer(signal.ITIMER_REAL, 5e-6 + number * 2e-6)
                    HeldByThread(word).let_go()
                    signal.setitimer(signal.ITIMER_REAL, 0.0)
                except Interrupted:
                    interrupted += 1
    assert interrupted


@pytest.mark.parametrize("may", [True, False])
def test_that_thread_dies_first_where_the_process_may_have_it_so(on: SimpleNamespace, may: bool) -> None:
    asked = []

    def seam(thread: object, call: str, about: tuple[object, ...]) -> None:
        if call == "sched_setscheduler":
            asked.append(about)
            if not may:
                raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))

    on.segments.create("run", "lifelines", 9)
    held = on.segments.attach("run", "lifelines", 9, write=True)
    on.machine.at_seam = seam
    one = on.load("failstop.api.held").HeldByThread(held.futex("held", 25, write=True))
    assert asked == [(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, 1)]
    assert held.futex("held", 25).held()
    one.let_go()
    assert on.machine.run(lambda: len(on.own.threads) == 1, 10**9)


@pytest.mark.timeout(20)
def test_a_word_that_can_t_be_written_keeps_nobody_waiting(lines: Segment) -> None:
    """Neither who joins, nor who starts: both have the late news."""

    def attempt() -> bool:
        word = lines.futex("held", 60, write=True)
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
        with ends():
            HeldByThread(word).let_go()
        return word.held()

    with ends():
        HeldByThread(lines.futex("held", 61, write=True)).let_go()
    assert call(attempt) is False
