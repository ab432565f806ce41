"""Processes that hold what tells of their death, those that wait for it, and threads as the kernel sees them."""

from __future__ import annotations

import contextlib
import os
import select
from collections.abc import Callable, Iterator
from pathlib import Path

from failstop.messages import segments
from failstop.shm.futex import PER_BLOCK
from failstop.shm.lifeline import EarlyNews, Lifeline
from failstop.shm.segment import Segment
from tests.support.children import Child
from tests.support.waiting import until

Send = Callable[[object], None]
Wait = Callable[[], None]
RUN = 9
FUTEX = {"x86_64": "202", "aarch64": "98"}.get(os.uname().machine, "")
"""The system call's number."""


def waiting(send: Send, wait: Wait) -> None:
    send("here")
    wait()


@contextlib.contextmanager
def alive() -> Iterator[tuple[Child, Lifeline]]:
    with Child(waiting) as child:
        assert child.receive() == "here"
        life = Lifeline(child.pid)
        yield child, life
        life.close()


def lifelines(instance: str) -> Segment:
    return segments.attach(instance, "lifelines", RUN, write=True)


def holding(instance: str, block: int) -> Child:
    """A process that holds its block for life, as every process of the service does."""

    def work(send: Send, wait: Wait) -> None:
        kept = lifelines(instance).futex("held", block * PER_BLOCK, write=True).hold(PER_BLOCK)
        send("held" if kept else "the kernel can't")
        wait()

    child = Child(work)
    assert child.receive() == "held"
    return child


def watching(instance: str, pid: int, block: int, watcher: int) -> Child:
    """A process that waits for a death by the futex alone; sends "armed", then what it learnt."""

    def work(send: Send, wait: Wait) -> tuple[bool, bool, bool]:
        life = Lifeline(pid)
        news = EarlyNews(lifelines(instance))
        news.watch_block(life, block, watcher)
        send("armed")
        return rung(news.bell.fd, 10), life.marked, life.died({})

    child = Child(work)
    assert child.receive() == "armed"
    return child


def rung(fd: int, timeout_s: float = 20.0) -> bool:
    return bool(select.select([fd], [], [], timeout_s)[0])


def threads() -> set[int]:
    return {int(thread) for thread in os.listdir("/proc/self/task")}


def asleep(thread: int) -> bool:
    """In the kernel, at a word that other processes have too: Python's own locks are private."""
    with contextlib.suppress(OSError):
        call = Path(f"/proc/self/task/{thread}/syscall").read_text().split()
        return call[0] == FUTEX and call[2] == "0x0"
    return False


@contextlib.contextmanager
def ends() -> Iterator[set[int]]:
    """Each thread that begins in it has ended afterwards; gives those of before."""
    before = threads()
    yield before
    until(lambda: not threads() - before, "its thread has ended")
