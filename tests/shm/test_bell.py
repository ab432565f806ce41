"""Bells: that they wake, that they never block, and who may ring them."""

from __future__ import annotations

import errno
import itertools
import os
import select
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from failstop.shm import bell
from failstop.shm.bell import EventBell
from tests.support.children import NOBODY

from .simulated import content, kill, living, put, user

Send = Callable[[object], None]
Wait = Callable[[], None]
STOP_PIPE = "/run/stop"


def rings(fd: int, system: Any = select) -> bool:
    return bool(system.select([fd], [], [], 0)[0])


@pytest.fixture
def event() -> Iterator[EventBell]:
    made = EventBell.create()
    yield made
    os.close(made.fd)


def test_an_event_bell_is_silent_until_it_is_rung_and_after_it_is_cleared(event: EventBell) -> None:
    for rung in (0, 1000, 1):
        for _ in range(rung):
            event.ring()
        assert rings(event.fd) is bool(rung)
        event.clear()
        assert not rings(event.fd)
    event.ring()  # while the waiter looks
    assert rings(event.fd)


def test_a_full_counter_rings_and_does_not_block(event: EventBell) -> None:
    os.write(event.fd, (2**64 - 2).to_bytes(8, "little"))
    with pytest.raises(BlockingIOError):
        os.write(event.fd, (1).to_bytes(8, "little"))
    for _ in range(3):
        event.ring()
    assert rings(event.fd)
    event.clear()
    assert not rings(event.fd)


def test_bells_block_nobody_and_do_not_cross_an_exec(event: EventBell, tmp_path: Path, fds: list[int]) -> None:
    bell.make_pipe(f"{tmp_path}/bell", 0o660)
    fds += [reading := bell.open_pipe(f"{tmp_path}/bell"), writing := bell.open_pipe_to_write(f"{tmp_path}/bell")]
    for fd in (event.fd, reading, writing):
        assert not os.get_inheritable(fd)
        assert not os.get_blocking(fd)


def test_the_mode_is_exact_whatever_the_umask_and_until_then_it_is_nobody_else_s(on: SimpleNamespace) -> None:
    before = []

    def look(thread: object, call: str, about: tuple[Any, ...]) -> None:
        if call == "chmod":
            before.append(on.machine.root.names["run"].names["stop"].mode)

    on.machine.at_seam = look
    for mask, mode in itertools.product((0o000, 0o022, 0o077, 0o777), (0o666, 0o660, 0o622, 0o600)):
        on.own.umask = mask
        on.bell.make_pipe(STOP_PIPE, mode)
        assert before == [0o600 & ~mask]
        found = on.os.lstat(STOP_PIPE)
        assert (stat.S_ISFIFO(found.st_mode), stat.S_IMODE(found.st_mode)) == (True, mode)
        assert list(on.own.files) == []
        on.os.unlink(STOP_PIPE)
        before.clear()


@pytest.mark.parametrize(("own", "gid", "wanted"), [(0, NOBODY, NOBODY), (NOBODY, 0, 0), (NOBODY, -1, NOBODY)])
def test_the_group_is_given(on: SimpleNamespace, own: int, gid: int, wanted: int) -> None:
    with user(on, 0, own):
        on.bell.make_pipe(STOP_PIPE, 0o660, *([gid] if gid >= 0 else []))
    found = on.os.lstat(STOP_PIPE)
    assert (found.st_uid, found.st_gid, stat.S_IMODE(found.st_mode)) == (0, wanted, 0o660)


@pytest.mark.parametrize("old", ["pipe", "file", "link", "dangling link"])
def test_what_a_dead_run_left_is_replaced(on: SimpleNamespace, old: str) -> None:
    if old == "link":
        put(on, "/tmp/victim", "precious", 0o600)
    if old in ("pipe", "file"):
        on.os.mkfifo(STOP_PIPE) if old == "pipe" else put(on, STOP_PIPE, "old")
    else:
        on.os.symlink("/tmp/victim", STOP_PIPE)
    on.bell.make_pipe(STOP_PIPE, 0o666)
    assert stat.S_ISFIFO(on.os.lstat(STOP_PIPE).st_mode)
    if old == "link":
        assert content(on, "/tmp/victim") == b"precious"
        assert on.os.stat("/tmp/victim").st_mode == stat.S_IFREG | 0o600


@pytest.fixture
def ends(on: SimpleNamespace) -> tuple[int, int]:
    on.bell.make_pipe(STOP_PIPE, 0o666)
    return on.bell.open_pipe(STOP_PIPE), on.bell.open_pipe_to_write(STOP_PIPE)


def test_messages_arrive_whole_and_in_order(on: SimpleNamespace, ends: tuple[int, int]) -> None:
    (reading, writing), system = ends, on.system["select"]
    assert on.bell.receive(reading) == b""
    assert not rings(reading, system)
    assert on.bell.send(writing, b"one\n")
    assert on.bell.send(writing, b"two\n")
    assert rings(reading, system)
    taken = on.bell.receive(reading)
    assert on.bell.send(writing, b"three\n")
    assert on.bell.receive(reading) == b"three\n"
    assert taken == b"one\ntwo\n", "what was taken is the taker's"
    assert on.bell.receive(reading) == b""
    assert not rings(reading, system)


def test_a_full_pipe_says_so_and_rings(on: SimpleNamespace, ends: tuple[int, int]) -> None:
    reading, writing = ends
    for size in (4096, 1):
        while on.bell.send(writing, b"x" * size):
            pass
    assert on.bell.send(writing, b"stop\n") is False
    assert rings(reading, on.system["select"])
    while on.bell.receive(reading):
        pass
    assert on.bell.send(writing, b"stop\n") is True
    assert on.bell.receive(reading) == b"stop\n"


def test_no_reader_is_enxio_and_one_that_goes_a_broken_pipe(on: SimpleNamespace, ends: tuple[int, int]) -> None:
    reading, writing = ends
    on.os.close(reading)
    with pytest.raises(BrokenPipeError, match="the service has gone") as refused:
        on.bell.send(writing, b"x")
    assert refused.value.errno == errno.EPIPE
    on.os.close(writing)
    with pytest.raises(OSError, match="nobody reads") as absent:
        on.bell.open_pipe_to_write(STOP_PIPE)
    assert absent.value.errno == errno.ENXIO
    with pytest.raises(FileNotFoundError):
        on.bell.open_pipe_to_write("/run/absent")


@pytest.mark.parametrize("number", [errno.EPIPE, errno.ENXIO, errno.EIO])
def test_what_a_pipe_is_refused_with_is_told_as_it_is(on: SimpleNamespace, ends: tuple[int, int], number: int) -> None:
    def refuse(*_: object) -> None:
        raise OSError(number, "refused")

    on.machine.at_seam = refuse
    with pytest.raises(OSError, match="refused" if number == errno.EIO else "the service has gone") as told:
        on.bell.send(ends[1], b"x")
    assert told.value.errno == number


def test_the_reader_sees_no_end_of_file_as_clients_come_and_go(on: SimpleNamespace, ends: tuple[int, int]) -> None:
    reading, writing = ends
    on.os.close(writing)
    poll = on.system["select"].epoll()
    poll.register(reading, select.EPOLLIN)
    for number in range(4):

        def client(number: int = number) -> None:
            fd = on.bell.open_pipe_to_write(STOP_PIPE)
            if number % 2:
                on.bell.send(fd, b"x")

        kill(on, living(on, client))
        assert poll.poll(0) == ([(reading, select.EPOLLIN)] if number % 2 else [])
        assert on.bell.receive(reading) == (b"x" if number % 2 else b"")
    assert poll.poll(0) == []


def access(on: Any, path: str) -> list[str]:
    """The answers that the calling user gets when it opens a pipe in each way."""
    found = []
    for flags in (os.O_WRONLY, os.O_RDONLY, os.O_RDWR):
        try:
            on.os.close(on.os.open(path, flags | os.O_NONBLOCK))
            found.append("yes")
        except PermissionError:
            found.append("no")
    return found


@pytest.mark.parametrize(("mode", "rights"), [(0o666, ["yes"] * 3), (0o622, ["yes", "no", "no"]), (0o660, ["no"] * 3)])
def test_what_nobody_may_do(on: SimpleNamespace, mode: int, rights: list[str]) -> None:
    """0o622 lets everyone ring and nobody else listen: with 0o666 any user can take stop requests out of the pipe."""
    on.bell.make_pipe(STOP_PIPE, mode)
    reading = on.bell.open_pipe(STOP_PIPE)
    with user(on, NOBODY):
        assert access(on, STOP_PIPE) == rights
        if rights[0] == "yes":
            assert on.bell.send(on.bell.open_pipe_to_write(STOP_PIPE), b"stop\n") is True
        for change in (
            lambda: on.os.unlink(STOP_PIPE),
            lambda: on.os.rename(STOP_PIPE, "/run/gone"),
            lambda: on.os.chmod(STOP_PIPE, 0),
            lambda: on.bell.make_pipe(STOP_PIPE, 0o600),
        ):
            with pytest.raises(PermissionError):
                change()
    assert on.bell.receive(reading) == (b"stop\n" if rights[0] == "yes" else b"")
