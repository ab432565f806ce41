"""Claims: one holder at a time, and none that outlives its holder."""

from __future__ import annotations

import fcntl
import itertools
import os
import stat
import struct
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from failstop.shm import claim
from tests.support.children import NOBODY, Child
from tests.support.waiting import until

from .simulated import user

Send = Callable[[object], None]
Wait = Callable[[], None]


@pytest.fixture
def path(tmp_path: Path) -> str:
    where = str(tmp_path / "claims")
    os.close(claim.open_claims(where, create=True))
    return where


def holder(path: str, *indexes: int) -> Child:
    """A process that holds these bytes until it is told to go, or killed."""

    def work(send: Send, wait: Wait) -> None:
        fd = claim.open_claims(path)
        send([claim.acquire(fd, index) for index in indexes])
        wait()

    child = Child(work)
    assert child.receive() == [True] * len(indexes)
    return child


def test_open_of_what_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        claim.open_claims(str(tmp_path / "absent"))


@pytest.mark.parametrize(("own", "gid", "wanted"), [(0, NOBODY, NOBODY), (NOBODY, 0, 0), (NOBODY, -1, NOBODY)])
def test_the_file_s_mode_and_group_are_exact(on: SimpleNamespace, own: int, gid: int, wanted: int) -> None:
    for mask, mode in itertools.product((0o000, 0o022, 0o077, 0o777), (0o660, 0o644, 0o600)):
        on.own.umask = mask
        words = {"mode": mode, "gid": gid} if gid >= 0 else {"mode": mode}
        with user(on, 0, own):
            fd = on.claim.open_claims("/run/new", create=True, **(words if mode != 0o660 else {"gid": gid}))
        found = on.os.fstat(fd)
        assert (found.st_uid, found.st_gid, stat.S_IMODE(found.st_mode)) == (0, wanted, mode)
        on.os.chmod("/run/new", 0o660)
        with user(on, NOBODY - 1), pytest.raises(PermissionError):
            on.claim.open_claims("/run/new")  # who may not write the file can't claim
        on.os.unlink("/run/new")


def test_held_and_dropped_between_processes(path: str, fds: list[int]) -> None:
    fds.append(fd := claim.open_claims(path))
    assert not claim.held(fd, 3)
    with holder(path, 3, 5) as child:
        assert [index for index in range(8) if claim.held(fd, index)] == [3, 5]
        assert not claim.acquire(fd, 3)
        assert claim.acquire(fd, 4)
        child.go()
        assert child.wait() == 0
        assert [index for index in range(8) if claim.held(fd, index)] == []
        assert claim.acquire(fd, 3)


def test_a_holder_does_not_see_its_own_claim_as_somebody_else_s(path: str, fds: list[int]) -> None:
    fds += [one := claim.open_claims(path), other := claim.open_claims(path)]
    assert claim.acquire(one, 0)
    assert claim.acquire(one, 0)
    assert not claim.held(one, 0)
    assert claim.held(other, 0)
    assert not claim.acquire(other, 0), "two descriptors of one process are two holders"


def test_drop(path: str, fds: list[int]) -> None:
    fds += [one := claim.open_claims(path), other := claim.open_claims(path)]
    assert claim.acquire(one, 1)
    assert claim.acquire(one, 2)
    claim.release(one, 1)
    assert claim.acquire(other, 1)
    assert not claim.acquire(other, 2)
    claim.release(one, 1)  # not its own any more: nothing happens
    assert claim.held(one, 1)


def test_a_closed_descriptor_holds_nothing(path: str, fds: list[int]) -> None:
    fds.append(watcher := claim.open_claims(path))
    fd = claim.open_claims(path)
    assert claim.acquire(fd, 0)
    os.close(fd)
    assert not claim.held(watcher, 0)


def test_the_claim_is_gone_at_the_latest_when_the_death_is_reported(path: str, fds: list[int]) -> None:
    """The gate looks at the claim when the holder's pidfd becomes readable: it must not find it held then."""
    fds.append(fd := claim.open_claims(path))
    for _ in range(15):
        with holder(path, 0, 7) as child:
            assert [claim.held(fd, index) for index in (0, 2, 7)] == [True, False, True]
            pidfd = os.pidfd_open(child.pid)
            try:
                os.kill(child.pid, 9)
                os.waitid(os.P_PIDFD, pidfd, os.WEXITED | os.WNOWAIT)
                assert not claim.held(fd, 0)
                assert not claim.held(fd, 7)
            finally:
                os.close(pidfd)


def test_other_descriptors_of_the_file_do_not_lose_the_claim(path: str, fds: list[int]) -> None:
    """As they would with classic POSIX locks, where any close of the file drops them all."""

    def work(send: Send, wait: Wait) -> None:
        fd = claim.open_claims(path)
        assert claim.acquire(fd, 1)
        for _ in range(5):
            with open(path, "rb"):
                pass
            os.close(claim.open_claims(path))
            os.close(claim.open_claims(path, create=True))
        again = os.dup(fd)
        os.close(again)
        send("still")
        wait()

    fds.append(fd := claim.open_claims(path))
    with Child(work) as child:
        assert child.receive() == "still"
        assert claim.held(fd, 1)


def test_a_read_only_descriptor_can_look_but_not_take(path: str, fds: list[int]) -> None:
    fds.append(fd := os.open(path, os.O_RDONLY))
    assert not claim.held(fd, 0)
    with holder(path, 0):
        assert claim.held(fd, 0)
    with pytest.raises(OSError, match="Bad file descriptor"):
        claim.acquire(fd, 0)


def test_who_only_reads_holds_nothing_that_a_writer_would_hold(path: str, fds: list[int]) -> None:
    fds += [fd := claim.open_claims(path), reading := os.open(path, os.O_RDONLY)]
    fcntl.fcntl(reading, fcntl.F_OFD_SETLK, struct.pack("hhqqi4x", fcntl.F_RDLCK, os.SEEK_SET, 0, 1, 0))
    assert claim.held(fd, 0)
    assert not claim.held(fd, 0, by_writer=True)
    assert not claim.acquire(fd, 0)


def test_of_many_that_race_each_gets_a_slot_as_long_as_there_is_one(path: str) -> None:
    """As clients do: take the first byte that is free."""
    slots, rounds = 2, 100

    def work(send: Send, wait: Wait) -> None:
        for _ in range(rounds):
            wait()
            fd = claim.open_claims(path)
            send(next((index for index in range(slots) if claim.acquire(fd, index)), -1))
            wait()
            os.close(fd)
            send("closed")

    with Child(work) as one, Child(work) as two, Child(work) as three:
        racers = [one, two, three]
        for number in range(rounds):
            for racer in racers if number % 2 else reversed(racers):
                racer.go()
            assert sorted(racer.receive() for racer in racers) == [-1, 0, 1]
            for racer in racers:
                racer.go()
                assert racer.receive() == "closed"


def exec_sleeper() -> tuple[int, int]:
    """Fork a child that becomes `cat`, which waits until the returned descriptor closes; returns (pid, descriptor)."""
    reading, writing = os.pipe()
    started_r, started_w = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            os.dup2(reading, 0)
            os.execv("/bin/cat", ["cat"])
        finally:
            os._exit(1)
    os.close(reading)
    os.close(started_w)
    os.read(started_r, 1)  # end of file: the exec has closed it
    os.close(started_r)
    return pid, writing


def test_a_program_started_by_the_holder_does_not_keep_the_claim(path: str, fds: list[int]) -> None:
    fds.append(watcher := claim.open_claims(path))
    fd = claim.open_claims(path)
    assert claim.acquire(fd, 0)
    pid, leash = exec_sleeper()
    try:
        assert claim.held(watcher, 0)
        os.close(fd)
        assert os.waitpid(pid, os.WNOHANG) == (0, 0)
        assert not claim.held(watcher, 0)
    finally:
        os.close(leash)
        os.waitpid(pid, 0)


def test_a_forked_child_that_execs_nothing_keeps_the_claim(path: str, fds: list[int]) -> None:
    """The limit of claims, for whoever builds on them: a copy of the process holds what the process held."""

    def work(send: Send, wait: Wait) -> None:
        fd = claim.open_claims(path)
        assert claim.acquire(fd, 0)
        pid = os.fork()
        if pid:
            send(pid)
        wait()
        os._exit(0)

    fds.append(watcher := claim.open_claims(path))
    with Child(work) as child:
        grandchild = child.receive()
        child.kill()
        assert claim.held(watcher, 0)
        os.kill(grandchild, 9)
        until(lambda: not claim.held(watcher, 0), "the last copy is gone")


def test_claims_do_not_depend_on_the_file_s_content(path: str, fds: list[int]) -> None:
    fds += [fd := claim.open_claims(path), other := claim.open_claims(path)]
    assert claim.acquire(fd, 5)
    os.pwrite(fd, b"anything at all", 0)
    assert not claim.acquire(other, 5)
    os.ftruncate(fd, 0)
    assert not claim.acquire(other, 5)
