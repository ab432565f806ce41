"""What the kernel says of those who open and close the pseudo-terminal."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.guard.openers import Watch, dying, is_ending
from failstop_lab.trial import wait_for


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


STAT = (
    b"4711 (a (driver) Z) %s 1 4711 4711 34822 4711 %d 99 0 0 0 1 2 0 0 20 0 3 0 170 2359296 880 %d 1 2 3 0 0 %d 0 0 0"
)
LIMIT = (1 << 64) - 1


@pytest.mark.parametrize(
    ("state", "flags", "pending", "ends"),
    [
        (b"S", 0x400000, 0, False),
        (b"R", 0x400004, 0, True),
        (b"S", 0x400000, 1 << signal.SIGKILL - 1, True),
        (b"D", 0x400000, 1 << signal.SIGKILL - 1 | 1 << signal.SIGUSR1 - 1, True),
        (b"S", 0x400000, 1 << signal.SIGTERM - 1, False),
        (b"T", 0x400000, 1 << signal.SIGTERM - 1, False),
        (b"Z", 0x40000C, 0, True),
    ],
    ids=["lives", "exits", "is killed", "is killed in the kernel", "may catch it", "is suspended", "has ended"],
)
def test_a_thread_is_ending_from_the_kill_on(state: bytes, flags: int, pending: int, ends: bool) -> None:
    assert is_ending(STAT % (state, flags, LIMIT, pending)) is ends


SLEEPS = ("sleep", "1000")
THREADS = """
import ctypes, threading, time
threading.Thread(target=time.sleep, args=(1000,)).start()
ctypes.CDLL(None).pthread_exit(None)
"""


@pytest.mark.parametrize(
    ("program", "main"),
    [(SLEEPS, b"S"), ((sys.executable, "-c", THREADS), b"Z")],
    ids=["one thread", "the main thread has ended"],
)
def test_a_kill_is_seen_before_the_process_has_run_again(program: tuple[str, ...], main: bytes) -> None:
    """It has only what is left of a processor that another program never leaves. One that has ended all the same before
    its state was read says nothing. A killed program with many threads is without its main one while the kernel takes
    its memory down."""
    if not hasattr(os, "SCHED_IDLE"):
        pytest.skip("no SCHED_IDLE here")
    core = {min(os.sched_getaffinity(0))}
    spin = [sys.executable, "-c", "print(flush=True)\nwhile True: pass"]
    with subprocess.Popen(spin, stdout=subprocess.PIPE) as busy:
        try:
            os.sched_setaffinity(busy.pid, core)
            assert busy.stdout
            busy.stdout.readline()
            while not seen_dying(program, main, core):
                pass
        finally:
            busy.kill()


def seen_dying(program: tuple[str, ...], main: bytes, core: set[int]) -> bool:
    """Start a program, wait for this state of its main thread, and kill it; False if it had ended before it was looked
    at."""
    with subprocess.Popen(program) as driver:
        folder = Path(f"/proc/{driver.pid}")
        try:
            wait_for(f"state {main!r}", lambda: (folder / "stat").read_bytes().rpartition(b") ")[2].startswith(main))
            last = max(int(name) for name in os.listdir(folder / "task"))
            os.sched_setaffinity(last, core)
            os.sched_setscheduler(last, os.SCHED_IDLE, os.sched_param(0))
            assert not dying(driver.pid)
        finally:
            driver.kill()
        seen = dying(driver.pid)
        try:
            stat = (folder / "task" / str(last) / "stat").read_bytes()
        except OSError:
            return False
        if stat.rpartition(b") ")[2].startswith(b"Z"):
            return False
        assert seen
        return True
