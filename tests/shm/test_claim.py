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

from .simulated import user

Send = Callable[[object], None]
Wait = Callable[[], None]


@pytest.fixture
def path(tmp_path: Path) -> str:
    where = str(tmp_path / "claims")
    os.close(claim.open_claims(where, create=True))
    return where


@pytest.fixture
def pair(path: str, fds: list[int]) -> list[int]:
    fds += [claim.open_claims(path), claim.open_claims(path)]
    return fds


def holder(path: str, *indexes: int) -> Child:
    """A process that holds these bytes until it is told to go, or killed."""

    def work(send: Send, wait: Wait) -> None:
        fd = claim.open_claims(path)
        send([claim.acquire(fd, index) for index in indexes])
        wait()

    child = Child(work)
    assert child.receive() == [True] * len(indexes)
    return child


def test_a_client_makes_no_claim_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        claim.open_claims(str(tmp_path / "claims"))
    assert not list(tmp_path.iterdir())


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


def test_a_claim_is_held_and_dropped_between_processes(path: str, pair: list[int]) -> None:
    fd, _ = pair
    with holder(path, 3, 5) as child:
        assert [index for index in range(8) if claim.held(fd, index)] == [3, 5]
        assert not claim.acquire(fd, 3)
        assert claim.acquire(fd, 4)
        child.go()
        assert child.wait() == 0
        assert [index for index in range(8) if claim.held(fd, index)] == []
        assert claim.acquire(fd, 3)


def test_two_descriptors_of_one_process_are_two_holders(path: str, pair: list[int]) -> None:
    one, other = pair
    assert not os.get_inheritable(one)
    for index in (1, 2, 1):
        assert claim.acquire(one, index)
    assert not claim.held(one, 1), "its own is nobody else's"
    assert claim.held(other, 1)
    assert not claim.acquire(other, 1)
    claim.release(one, 1)
    assert claim.acquire(other, 1)
    assert not claim.acquire(other, 2)
    claim.release(one, 1)  # not its own any more: nothing happens
    assert claim.held(one, 1)
    os.close(os.dup(one))
    with open(path, "rb"):
        pass
    assert claim.held(other, 2), "classic POSIX locks go with any close of the file"
    os.close(pair.pop(0))
    assert not claim.held(other, 2)


def test_the_claim_is_gone_at_the_latest_when_the_death_is_reported(path: str, pair: list[int]) -> None:
    """The gate looks at the claim when the holder's pidfd becomes readable: it must not find it held then."""
    for _ in range(15):
        with holder(path, 0, 7) as child:
            assert [claim.held(pair[0], index) for index in (0, 2, 7)] == [True, False, True]
            os.kill(child.pid, 9)
            os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOWAIT)
            assert [claim.held(pair[0], index) for index in (0, 7)] == [False, False]


def test_a_read_only_descriptor_can_look_but_not_take(path: str, pair: list[int]) -> None:
    pair.append(reading := os.open(path, os.O_RDONLY))
    assert not claim.held(reading, 0)
    assert claim.acquire(pair[0], 0)
    assert claim.held(reading, 0)
    with pytest.raises(OSError, match="Bad file descriptor"):
        claim.acquire(reading, 0)
    fcntl.fcntl(reading, fcntl.F_OFD_SETLK, struct.pack("hhqqi4x", fcntl.F_RDLCK, os.SEEK_SET, 1, 1, 0))
    assert claim.held(pair[1], 1)
    assert not claim.held(pair[1], 1, by_writer=True), "who only reads holds nothing that a writer would hold"


def test_of_many_that_race_each_gets_a_slot_as_long_as_there_is_one(path: str) -> None:

    def work(send: Send, wait: Wait) -> None:
        while True:
            wait()
            fd = claim.open_claims(path)
            send(next((index for index in range(2) if claim.acquire(fd, index)), -1))
            wait()
            os.close(fd)
            send("closed")

    with Child(work) as one, Child(work) as two, Child(work) as three:
        racers = [one, two, three]
        for number in range(100):
            for racer in racers if number % 2 else reversed(racers):
                racer.go()
            assert sorted(racer.receive() for racer in racers) == [-1, 0, 1]
            for racer in racers:
                racer.go()
                assert racer.receive() == "closed"
