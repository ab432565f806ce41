"""The early news of a death: through a futex and a bell, by a thread, before the kernel takes the memory down."""

from __future__ import annotations

import errno
import os
import select
import signal
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from failstop.shm.futex import BLOCKS, PER_BLOCK
from failstop.shm.lifeline import EarlyNews, Lifeline
from failstop.shm.segment import Segment
from tests.support.children import needs_root, scheduled
from tests.support.waiting import until

from .dying import alive, asleep, ends, holding, rung, threads, watching
from .simulated import living, refusing


@pytest.fixture
def news(lines: Segment) -> Iterator[EarlyNews]:
    made = EarlyNews(lines)
    yield made
    os.close(made.bell.fd)


@pytest.mark.parametrize("block", [0, 1, BLOCKS - 1])
def test_every_watcher_gets_the_early_news(name: str, lines: Segment, block: int) -> None:
    """Through the futex and the bell: the pidfd is not even polled. A block is used again, the last holder's mark in
    it."""
    for _ in range(2):
        with holding(name, block) as holder:
            watchers = [watching(name, holder.pid, block, index) for index in range(PER_BLOCK)]
            try:
                os.kill(holder.pid, signal.SIGKILL)
                assert [watcher.result() for watcher in watchers] == [(True, True, True)] * PER_BLOCK
            finally:
                for watcher in watchers:
                    watcher.close()


@pytest.mark.parametrize("index", range(PER_BLOCK))
def test_the_news_comes_by_one_thread_for_each_lifeline(name: str, news: EarlyNews, index: int) -> None:
    with holding(name, 2) as holder, ends() as before:
        life = Lifeline(holder.pid)
        for _ in range(3):
            news.watch_block(life, 2, index)
        assert len(threads() - before) == 1
        assert not life.died({})
        os.kill(holder.pid, signal.SIGKILL)
        assert rung(news.bell.fd)
        assert life.marked
        assert life.died({})
        assert life.dead()
        life.close()


def test_who_asks_knows_of_a_death_that_its_thread_has_not_told_yet(name: str, lines: Segment) -> None:
    with holding(name, 3) as holder:
        life = Lifeline()
        life.early = lines.futex("held", 3 * PER_BLOCK)
        assert not life.dead()
        holder.kill()
        assert not life.marked
        assert life.dead()
        life.early.close()
        life.close()


def attached(on: SimpleNamespace) -> Any:
    return on.segments.attach("run", "lifelines", 9, write=True)


def lines_of(on: SimpleNamespace) -> Any:
    on.segments.create("run", "lifelines", 9)
    return attached(on)


@pytest.mark.parametrize(("refused", "of_a_service"), [(False, True), (False, False), (True, True)])
@pytest.mark.parametrize(
    ("own", "dying", "found"), [(5, 6, 7), (6, 6, 7), (7, 6, 7), (8, 6, 8), (1, 6, 7), (0, 6, 0), (5, 0, 5), (1, 0, 1)]
)
def test_a_thread_that_stops_runs_above_the_dying(
    on: SimpleNamespace, own: int, dying: int, found: int, refused: bool, of_a_service: bool
) -> None:
    """It may not be let; then it runs as its process does. Nobody has to run above one that has no priority."""
    policy = os.SCHED_FIFO if own else os.SCHED_OTHER
    on.machine.inline.scheduling = policy, own
    held, seen = lines_of(on), []
    holder = living(on, lambda: attached(on).futex("held", 2 * PER_BLOCK, write=True).hold(PER_BLOCK))
    news, life = on.lifeline.EarlyNews(held), on.lifeline.Lifeline(holder.pid)
    on.machine.inline.scheduling = (os.SCHED_OTHER, 0)

    def stop() -> None:
        seen.append(on.machine.current.scheduling)

    if refused:
        refuse_above(on, own)
    words = (stop, dying) if dying else (stop,)
    news.watch_block(life, 2, 0, *words) if of_a_service else news.watch(life, held, 2 * PER_BLOCK, *words)
    on.machine.die(holder, -9)
    assert on.machine.run(lambda: life.marked and bool(seen), 10**9)
    assert seen == [(policy, own if refused else found)]


def refuse_above(on: SimpleNamespace, own: int) -> None:

    def refuse(thread: object, call: str, about: tuple[int, ...]) -> None:
        if call == "sched_setscheduler" and about[2] > own:
            raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))

    on.machine.at_seam = refuse


@needs_root
def test_real_time_rights_are_remembered_for_the_threads(name: str, lines: Segment) -> None:
    with scheduled(os.SCHED_FIFO, 5):
        news = EarlyNews(lines)
    with holding(name, 2) as holder:
        life, before = Lifeline(holder.pid), threads()
        news.watch_block(life, 2, 0, lambda: None, 6)
        (thread,) = threads() - before
        until(lambda: os.sched_getparam(thread).sched_priority == 7, "its own priority")
        assert os.sched_getscheduler(thread) == os.SCHED_FIFO
        os.kill(holder.pid, signal.SIGKILL)
        assert rung(news.bell.fd)
        life.close()
    os.close(news.bell.fd)


def test_no_news_while_the_holder_lives(name: str, lines: Segment) -> None:
    with holding(name, 3) as holder, watching(name, holder.pid, 3, 0) as watcher:
        other = Lifeline(watcher.pid)
        os.kill(holder.pid, signal.SIGSTOP)
        os.waitid(os.P_PID, holder.pid, os.WSTOPPED)
        assert not rung(other.fd, 0.1), "a stopped holder is no dead one"
        os.kill(holder.pid, signal.SIGKILL)
        assert watcher.result() == (True, True, True)
        other.close()


def test_the_death_of_a_watcher_costs_the_next_one_nothing(name: str, lines: Segment) -> None:
    with holding(name, 6) as holder:
        for _ in range(3):
            with watching(name, holder.pid, 6, 0) as first:
                first.kill()
        with watching(name, holder.pid, 6, 0) as last:
            os.kill(holder.pid, signal.SIGKILL)
            assert last.result() == (True, True, True)


def test_the_pidfd_alone_is_enough(news: EarlyNews) -> None:
    """The early news never comes where the futex was not held: the late word is there all the same."""
    with alive() as (child, life):
        with ends():
            news.watch_block(life, 7, 0)
            os.kill(child.pid, signal.SIGKILL)
            assert rung(life.fd)
        assert life.died({life.fd: select.POLLIN})
        assert not life.marked
        assert life.dead()


@pytest.mark.parametrize(
    ("call", "error"),
    [("thread", RuntimeError("can't start new thread")), ("mmap", OSError(errno.ENOMEM, "no memory"))],
)
def test_a_machine_that_lacks_something_has_the_late_news(on: SimpleNamespace, call: str, error: Exception) -> None:
    news = on.lifeline.EarlyNews(lines_of(on))
    process = living(on, lambda: None)
    life = on.lifeline.Lifeline(process.pid)
    with refusing(on, call, error) as asked:
        news.watch_block(life, 7, 0)
    assert asked
    on.machine.die(process, -9)
    assert life.wait(1)
    assert life.died({life.fd: select.POLLIN})
    assert not life.marked


def test_a_lifeline_that_is_closed_keeps_no_thread(name: str, news: EarlyNews) -> None:
    with holding(name, 8) as holder, ends() as before:
        life = Lifeline(holder.pid)
        news.watch_block(life, 8, 0)
        (thread,) = threads() - before
        until(lambda: asleep(thread), "the thread waits")
        life.close()
    assert not life.marked


def test_a_watch_that_names_no_line_is_of_the_first(name: str, lines: Segment, news: EarlyNews) -> None:
    with holding(name, 0) as holder:
        life = Lifeline(os.getpid())
        news.watch(life, lines)
        holder.kill()
        assert rung(news.bell.fd)
        assert life.marked
        life.close()
