"""What the kernel says of those who open and close the pseudo-terminal."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.guard.openers import Watch, dying, is_ending, name_of
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


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (b"/usr/bin/python3.11\0-u\0/opt/driver.py\0--port\0/dev/x\0", "driver.py"),
        (b"python\0driver.py\0-c\0x\0", "driver.py"),
        (b"python\0-m\0pkg.driver\0", "pkg.driver"),
        (b"python3\0-c\0import os\0", "python3"),
        (b"python3\0-u\0-c\0import os\0", "python3"),
        (b"python3\0-uc\0import os\0", "python3"),
        (b"bash\0-lc\0cat /dev/x\0", "bash"),
        (b"bash\0-e\0drive.sh\0", "drive.sh"),
        (b"perl\0-e\0print 1\0", "perl"),
        (b"node\0--inspect\0drive.js\0", "drive.js"),
        pytest.param(b"./shuttle_node\0003\0", "shuttle_node", id="begins as an interpreter does"),
        (b"shuttle_node\0/tmp/x\0", "shuttle_node"),
        (b"python3\0", "python3"),
        (b"", "comm"),
        pytest.param(b"/opt/\xff\xfedrive\0", "\ufffd\ufffddrive", id="no UTF-8"),
        pytest.param(b"python3\0/opt/\x1b[31mdrive\n.py\0", "?[31mdrive?.py", id="characters that control a terminal"),
    ],
)
def test_a_program_s_name_can_be_shown(command: bytes, name: str) -> None:
    assert name_of(command, b"comm\n") == name
    assert name.encode().decode() == name


def test_a_program_without_any_name_is_a_program() -> None:
    assert name_of(b"", b"\n") == "a program"


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
