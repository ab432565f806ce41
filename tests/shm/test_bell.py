"""Bells: that they wake, that they never block, and who may ring them."""

from __future__ import annotations

import errno
import os
import select
import stat
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from failstop.shm import bell
from failstop.shm.bell import EventBell
from tests.support.children import NOBODY, Child, call, group, needs_root, umask

Send = Callable[[object], None]
Wait = Callable[[], None]


def rings(fd: int, timeout_s: float = 0.0) -> bool:
    return bool(select.select([fd], [], [], timeout_s)[0])


@pytest.fixture
def event() -> Iterator[EventBell]:
    made = EventBell.create()
    yield made
    os.close(made.fd)


@pytest.fixture
def place() -> Iterator[str]:
    """A directory that other users can reach, as the runtime directory is."""
    path = f"/tmp/fsbell{os.getpid()}"
    os.mkdir(path, 0o755)
    os.chmod(path, 0o755)
    yield path
    for entry in os.listdir(path):
        os.unlink(os.path.join(path, entry))
    os.rmdir(path)


def test_a_new_event_bell_is_silent(event: EventBell) -> None:
    assert not rings(event.fd)
    event.clear()
    assert not rings(event.fd)


def test_many_rings_are_one_wake_up(event: EventBell) -> None:
    for _ in range(1000):
        event.ring()
    assert rings(event.fd)
    event.clear()
    assert not rings(event.fd)
    event.ring()
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


def test_an_event_bell_wakes_an_epoll_in_another_process(event: EventBell) -> None:
    def work(send: Send, wait: Wait) -> bool:
        poll = select.epoll()
        poll.register(event.fd, select.EPOLLIN)
        send("waiting")
        woken = bool(poll.poll(20))
        event.clear()
        return woken

    with Child(work) as child:
        assert child.receive() == "waiting"
        event.ring()
        assert child.result() is True
    assert not rings(event.fd)


def test_a_ring_between_clear_and_look_is_not_lost(event: EventBell) -> None:
    event.ring()
    event.clear()
    event.ring()  # while the waiter looks
    assert rings(event.fd)


def test_bells_do_not_cross_an_exec(event: EventBell, place: str, fds: list[int]) -> None:
    bell.make_pipe(f"{place}/bell", 0o660)
    fds += [reading := bell.open_pipe(f"{place}/bell"), writing := bell.open_pipe_to_write(f"{place}/bell")]
    for fd in (event.fd, reading, writing):
        assert not os.get_inheritable(fd)
        assert not os.get_blocking(fd)


@pytest.mark.parametrize("mask", [0o000, 0o022, 0o077, 0o777])
@pytest.mark.parametrize("mode", [0o666, 0o660, 0o622, 0o600])
def test_the_mode_is_exact_whatever_the_umask(place: str, mask: int, mode: int) -> None:
    with umask(mask):
        bell.make_pipe(f"{place}/stop", mode)
    found = os.lstat(f"{place}/stop")
    assert stat.S_ISFIFO(found.st_mode)
    assert stat.S_IMODE(found.st_mode) == mode


@needs_root
def test_the_group_is_given(place: str) -> None:
    for own, gid, wanted in ((0, NOBODY, NOBODY), (NOBODY, 0, 0), (NOBODY, -1, NOBODY)):
        with group(own):
            bell.make_pipe(f"{place}/bell", 0o660, gid)
        found = os.lstat(f"{place}/bell")
        assert (found.st_uid, found.st_gid, stat.S_IMODE(found.st_mode)) == (0, wanted, 0o660)


def test_it_is_nobody_else_s_until_it_has_its_group_and_mode(place: str, monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    chmod = os.chmod

    def look(name: str, mode: int, *, dir_fd: int) -> None:
        found.append(stat.S_IMODE(os.stat(name, dir_fd=dir_fd).st_mode))
        chmod(name, mode, dir_fd=dir_fd)

    monkeypatch.setattr(os, "chmod", look)
    with umask(0):
        bell.make_pipe(f"{place}/bell", 0o660)
    assert found == [0o600]


@pytest.mark.parametrize("old", ["pipe", "file", "link", "dangling link"])
def test_what_a_dead_run_left_is_replaced(place: str, old: str, tmp_path: Path) -> None:
    path = f"{place}/stop"
    victim = tmp_path / "victim"
    if old == "pipe":
        os.mkfifo(path)
    elif old == "file":
        Path(path).write_text("old")
    else:
        if old == "link":
            victim.write_text("precious")
            victim.chmod(0o600)
        os.symlink(victim, path)
    bell.make_pipe(path, 0o666)
    assert stat.S_ISFIFO(os.lstat(path).st_mode)
    if old == "link":
        assert victim.read_text() == "precious"
        assert stat.S_IMODE(victim.stat().st_mode) == 0o600


def test_messages_arrive_whole_and_in_order(place: str, fds: list[int]) -> None:
    bell.make_pipe(f"{place}/stop", 0o666)
    fds += [reading := bell.open_pipe(f"{place}/stop"), writing := bell.open_pipe_to_write(f"{place}/stop")]
    assert bell.take(reading) == b""
    assert not rings(reading)
    assert bell.send(writing, b"one\n")
    assert bell.send(writing, b"two\n")
    assert rings(reading)
    taken = bell.take(reading)
    assert taken == b"one\ntwo\n"
    assert bell.send(writing, b"three\n")
    assert bell.take(reading) == b"three\n"
    assert taken == b"one\ntwo\n", "what was taken is the taker's"
    assert bell.take(reading) == b""
    assert not rings(reading)


def test_messages_of_many_writers_do_not_mix(place: str, fds: list[int]) -> None:
    bell.make_pipe(f"{place}/stop", 0o666)
    fds.append(reading := bell.open_pipe(f"{place}/stop"))
    count, size = 60, 400

    def writer(letter: bytes) -> Callable[[Send, Wait], int]:
        def work(send: Send, wait: Wait) -> int:
            fd = bell.open_pipe_to_write(f"{place}/stop")
            wait()
            return sum(bell.send(fd, letter * size + b"\n") for _ in range(count))

        return work

    children = [Child(writer(letter)) for letter in (b"a", b"b", b"c")]
    try:
        for child in children:
            child.go()
        sent = sum(child.result() for child in children)
    finally:
        for child in children:
            child.close()
    data = b""
    while part := bell.take(reading):
        data += part
    lines = data.split(b"\n")[:-1]
    assert len(lines) == sent > 100
    assert all(len(line) == size and len(set(line)) == 1 for line in lines)


def test_a_full_pipe_says_so_and_rings(place: str, fds: list[int]) -> None:
    bell.make_pipe(f"{place}/stop", 0o666)
    fds += [reading := bell.open_pipe(f"{place}/stop"), writing := bell.open_pipe_to_write(f"{place}/stop")]
    while bell.send(writing, b"x" * 4096):
        pass
    while bell.send(writing, b"x"):
        pass
    assert bell.send(writing, b"stop\n") is False
    poll = select.epoll()
    poll.register(reading, select.EPOLLIN)
    try:
        assert poll.poll(0)
    finally:
        poll.close()
    while bell.take(reading):
        pass
    assert bell.send(writing, b"stop\n") is True
    assert bell.take(reading) == b"stop\n"


def test_no_reader_is_enxio(place: str) -> None:
    bell.make_pipe(f"{place}/stop", 0o666)
    with pytest.raises(OSError, match="No such device or address") as refused:
        bell.open_pipe_to_write(f"{place}/stop")
    assert refused.value.errno == errno.ENXIO
    with pytest.raises(FileNotFoundError):
        bell.open_pipe_to_write(f"{place}/absent")


def test_a_service_that_goes_is_a_broken_pipe(place: str, fds: list[int]) -> None:
    bell.make_pipe(f"{place}/stop", 0o666)
    reading = bell.open_pipe(f"{place}/stop")
    fds.append(writing := bell.open_pipe_to_write(f"{place}/stop"))
    os.close(reading)
    with pytest.raises(BrokenPipeError, match="the service has gone") as refused:
        bell.send(writing, b"x")
    assert refused.value.errno == errno.EPIPE


def test_the_reader_never_sees_an_end_of_file_as_clients_come_and_go(place: str, fds: list[int]) -> None:
    bell.make_pipe(f"{place}/stop", 0o666)
    fds.append(reading := bell.open_pipe(f"{place}/stop"))
    poll = select.epoll()
    poll.register(reading, select.EPOLLIN)
    try:
        for number in range(20):

            def client(send: Send, wait: Wait, number: int = number) -> None:
                fd = bell.open_pipe_to_write(f"{place}/stop")
                if number % 2:
                    bell.send(fd, b"x")
                os._exit(0) if number % 3 else os.kill(os.getpid(), 9)

            with Child(client) as child:
                child.wait()
            events = poll.poll(0)
            assert events == ([(reading, select.EPOLLIN)] if number % 2 else [])
            assert bell.take(reading) == (b"x" if number % 2 else b"")
        assert poll.poll(0) == []
    finally:
        poll.close()


def test_a_pipe_that_is_kept_open_outlives_a_restarted_reader(place: str, fds: list[int]) -> None:
    """The supervisor keeps the stop pipe open across a restart of the process that reads it: no stop is lost."""
    bell.make_pipe(f"{place}/stop", 0o666)
    fds.append(bell.open_pipe(f"{place}/stop"))
    first = bell.open_pipe(f"{place}/stop")
    fds.append(writing := bell.open_pipe_to_write(f"{place}/stop"))
    os.close(first)
    assert bell.send(writing, b"stop while nobody reads\n")
    fds.append(second := bell.open_pipe(f"{place}/stop"))
    assert bell.take(second) == b"stop while nobody reads\n"


def access(path: str) -> list[str]:
    """What the calling user may do with a pipe."""
    found = []
    for flags in (os.O_WRONLY, os.O_RDONLY, os.O_RDWR):
        try:
            os.close(os.open(path, flags | os.O_NONBLOCK))
            found.append("yes")
        except PermissionError:
            found.append("no")
    return found


@needs_root
@pytest.mark.parametrize(("mode", "rights"), [(0o666, ["yes"] * 3), (0o622, ["yes", "no", "no"]), (0o660, ["no"] * 3)])
def test_what_nobody_may_do(place: str, fds: list[int], mode: int, rights: list[str]) -> None:
    """0o622 lets everyone ring and nobody else listen: with 0o666 any user can take stop requests out of the pipe."""
    bell.make_pipe(f"{place}/stop", mode)
    fds.append(reading := bell.open_pipe(f"{place}/stop"))
    assert call(lambda: access(f"{place}/stop"), NOBODY) == rights
    if rights[0] == "yes":
        assert call(lambda: bell.send(bell.open_pipe_to_write(f"{place}/stop"), b"stop\n"), NOBODY) is True
        assert bell.take(reading) == b"stop\n"


def test_of_several_bells_those_that_have_rung_are_cleared(fds: list[int]) -> None:
    bells = [EventBell.create() for _ in range(3)]
    fds += [each.fd for each in bells]
    for each in bells:
        each.ring()
    bell.clear_rung(tuple(bells), {bells[0].fd: select.EPOLLIN, bells[2].fd: select.EPOLLIN})
    assert select.select([each.fd for each in bells], [], [], 0)[0] == [bells[1].fd]


@needs_root
def test_nobody_can_not_replace_the_pipe(place: str, fds: list[int]) -> None:
    bell.make_pipe(f"{place}/stop", 0o666)

    def attempt() -> list[str]:
        found = []
        changes: list[Callable[[], object]] = [
            lambda: os.unlink(f"{place}/stop"),
            lambda: os.rename(f"{place}/stop", f"{place}/gone"),
            lambda: os.chmod(f"{place}/stop", 0),
            lambda: bell.make_pipe(f"{place}/stop", 0o600),
        ]
        for change in changes:
            try:
                change()
                found.append("done")
            except PermissionError:
                found.append("refused")
        return found

    assert call(attempt, NOBODY) == ["refused"] * 4
