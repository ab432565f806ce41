"""The simulated system calls answer as this machine's kernel does: one program, run on both, must tell the same
story."""

from __future__ import annotations

import _socket
import _thread
import fcntl
import os
import select
import struct
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from failstop_lab.machine.process import Process
from failstop_lab.machine.robot import Robot

LOCK = struct.Struct("hhqqi4x")
ONE = (1).to_bytes(8, "little")
System = Any
Story = list[Any]


def tried(call: Callable[..., Any], *arguments: Any, **words: Any) -> Any:
    """The result of a call, or the number of its error."""
    try:
        return call(*arguments, **words)
    except OSError as error:
        return f"errno {error.errno}"


def a_fifo_is_full_empty_and_without_readers(on: System, folder: str) -> Story:
    path = f"{folder}/pipe"
    on.os.mkfifo(path, 0o600)
    story = [tried(on.os.open, path, os.O_WRONLY | os.O_NONBLOCK)]
    both = on.os.open(path, os.O_RDWR | os.O_NONBLOCK)
    writer = on.os.open(path, os.O_WRONLY | os.O_NONBLOCK)
    story += [tried(on.os.read, both, 10), on.os.write(writer, b"abc"), on.os.read(both, 2), on.os.read(both, 9)]
    taken = 0
    while not isinstance(found := tried(on.os.write, writer, bytes(4096)), str):
        taken += found
    story += [taken, found, on.select.select([both], [writer], [], 0) == ([both], [], [])]
    on.os.close(both)
    return [*story, tried(on.os.write, writer, b"x")]


def an_open_of_a_fifo_waits_for_the_other_end(on: System, folder: str) -> Story:
    story: Story = []
    on.os.mkfifo(f"{folder}/pipe", 0o600)

    def read() -> None:
        fd = on.os.open(f"{folder}/pipe", os.O_RDONLY)
        story.append("both ends are open")
        on.os.close(fd)

    on.thread.start_new_thread(read, ())
    on.os.close(on.os.open(f"{folder}/pipe", os.O_WRONLY))
    while not story:
        on.time.sleep(0.001)
    return story


def an_eventfd_counts(on: System, folder: str) -> Story:
    fd = on.os.eventfd(0, os.EFD_NONBLOCK)
    story = [tried(on.os.read, fd, 8), on.os.write(fd, ONE), on.os.write(fd, ONE), on.os.read(fd, 8)]
    on.os.write(fd, (2**64 - 2).to_bytes(8, "little"))
    return [*story, tried(on.os.write, fd, ONE), on.select.select([fd], [fd], [], 0) == ([fd], [], [])]


def an_epoll_set_tells_of_levels_and_edges(on: System, folder: str) -> Story:
    level, edge = (on.os.eventfd(0, os.EFD_NONBLOCK) for _ in range(2))
    epoll = on.select.epoll()
    epoll.register(level, select.EPOLLIN)
    epoll.register(edge, select.EPOLLIN | select.EPOLLET)
    names = {level: "level", edge: "edge"}

    def ready() -> Any:
        return sorted((names[fd], mask) for fd, mask in epoll.poll(0))

    story: Story = [ready(), tried(epoll.register, level, select.EPOLLIN)]
    for fd in (level, edge):
        on.os.write(fd, ONE)
    story += [ready(), ready()]
    on.os.write(edge, ONE)
    story += [ready(), on.select.select([epoll.fileno()], [], [], 0) == ([epoll.fileno()], [], [])]
    on.os.read(level, 8)
    story += [ready(), on.select.select([epoll.fileno()], [], [], 0) == ([], [], [])]
    epoll.modify(edge, select.EPOLLIN)
    story += [ready()]
    on.os.close(edge)
    return [*story, ready(), tried(epoll.unregister, 999)]


def a_closed_pipe_hangs_up_in_an_epoll_set(on: System, folder: str) -> Story:
    on.os.mkfifo(f"{folder}/pipe")
    reader = on.os.open(f"{folder}/pipe", os.O_RDONLY | os.O_NONBLOCK)
    writer = on.os.open(f"{folder}/pipe", os.O_WRONLY | os.O_NONBLOCK)
    epoll = on.select.epoll()
    epoll.register(reader, 0)
    story: Story = [[mask for _, mask in epoll.poll(0)]]
    on.os.close(writer)
    return [*story, [mask for _, mask in epoll.poll(0)], on.os.read(reader, 1)]


def what_a_poll_has_forgotten_it_tells_of_no_more(on: System, folder: str) -> Story:
    poll, fds = on.select.poll(), [on.os.eventfd(1, os.EFD_NONBLOCK) for _ in range(2)]
    for fd in fds:
        poll.register(fd, select.POLLIN)
    story: Story = [[mask for _, mask in poll.poll(0)]]
    poll.unregister(fds[0])
    return [*story, poll.poll(0) == [(fds[1], select.POLLIN)]]


def record_locks_belong_to_the_open_file(on: System, folder: str) -> Story:
    def lock(fd: int, command: int, kind: int, byte: int = 0) -> Any:
        return tried(on.fcntl.fcntl, fd, command, LOCK.pack(kind, os.SEEK_SET, byte, 1, 0))

    def held(fd: int, byte: int = 0) -> bool:
        return bool(LOCK.unpack(lock(fd, fcntl.F_OFD_GETLK, fcntl.F_WRLCK, byte))[0] != fcntl.F_UNLCK)

    first, second = (on.os.open(f"{folder}/file", os.O_RDWR | os.O_CREAT, 0o600) for _ in range(2))
    story: Story = [isinstance(lock(first, fcntl.F_OFD_SETLK, fcntl.F_WRLCK), str), held(first), held(second)]
    story += [lock(second, fcntl.F_OFD_SETLK, fcntl.F_WRLCK) in ("errno 11", "errno 13"), held(second, 1)]
    copy = on.os.dup(first)
    on.os.close(first)
    story += [held(second)]
    on.os.close(copy)
    return [*story, held(second)]


def a_whole_files_lock_is_shared_by_its_copies(on: System, folder: str) -> Story:
    first, second = (on.os.open(f"{folder}/file", os.O_RDWR | os.O_CREAT, 0o600) for _ in range(2))
    copy = on.os.dup(first)
    story: Story = [tried(on.fcntl.flock, first, fcntl.LOCK_EX | fcntl.LOCK_NB)]
    story += [tried(on.fcntl.flock, each, fcntl.LOCK_EX | fcntl.LOCK_NB) for each in (copy, second)]
    on.os.close(first)
    story += [tried(on.fcntl.flock, second, fcntl.LOCK_EX | fcntl.LOCK_NB)]
    on.os.close(copy)
    return [*story, tried(on.fcntl.flock, second, fcntl.LOCK_EX | fcntl.LOCK_NB)]


def a_descriptor_goes_through_a_socket(on: System, folder: str) -> Story:
    mine, theirs = on.socket.socketpair(_socket.AF_UNIX, _socket.SOCK_SEQPACKET)
    fd = on.os.eventfd(7, os.EFD_NONBLOCK)
    packed = struct.pack("i", fd)
    mine.sendmsg([b"head", b"tail"], [(_socket.SOL_SOCKET, _socket.SCM_RIGHTS, packed)])
    on.os.close(fd)
    data, ancillary, *_ = theirs.recvmsg(100, _socket.CMSG_LEN(4), _socket.MSG_DONTWAIT)
    (passed,) = struct.unpack("i", ancillary[0][2])
    story: Story = [data, int.from_bytes(on.os.read(passed, 8), "little")]
    story += [tried(theirs.recvmsg, 100, 0, _socket.MSG_DONTWAIT)]
    mine.close()
    story += [theirs.recvmsg(100, 0, _socket.MSG_DONTWAIT)[0]]
    theirs.close()
    return story


def files_have_names_and_bytes(on: System, folder: str) -> Story:
    path = f"{folder}/file"
    story: Story = [tried(on.os.open, path, os.O_RDONLY), tried(on.os.unlink, path)]
    fd = on.os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
    story += [tried(on.os.open, path, os.O_RDWR | os.O_CREAT | os.O_EXCL), on.os.write(fd, b"abcdef")]
    story += [on.os.pread(fd, 3, 2), on.os.pwrite(fd, b"XY", 7), on.os.fstat(fd).st_size, on.os.pread(fd, 20, 0)]
    on.os.posix_fallocate(fd, 0, 100)
    story.append(on.os.fstat(fd).st_size)
    on.os.ftruncate(fd, 3)
    more = on.os.open(path, os.O_WRONLY | os.O_APPEND)
    on.os.write(more, b"!")
    on.os.rename(path, f"{folder}/other")
    story += [on.os.pread(fd, 20, 0), tried(on.os.stat, path), on.os.fstat(fd).st_nlink]
    on.os.unlink(f"{folder}/other")
    return [*story, on.os.fstat(fd).st_nlink, tried(on.os.listdir, f"{folder}/other"), tried(on.os.read, 888, 1)]


def a_map_is_the_file(on: System, folder: str) -> Story:
    fd = on.os.open(f"{folder}/file", os.O_RDWR | os.O_CREAT, 0o600)
    on.os.posix_fallocate(fd, 0, 4096)
    first, second = (on.mmap.mmap(fd, 4096) for _ in range(2))
    memoryview(first).cast("Q")[2] = 77
    story: Story = [memoryview(second).cast("Q")[2], on.os.pread(fd, 8, 16), len(first)]
    on.os.pwrite(fd, b"abc", 100)
    return [*story, bytes(first[99:104])]


def a_session_is_killed_as_one(on: System, folder: str) -> Story:
    pid = on.os.posix_spawn("/bin/sh", ["/bin/sh", "-c", "exec sleep 120"], {}, setsid=True)
    story: Story = [tried(on.os.kill, -pid, 9), on.os.waitpid(pid, 0) == (pid, 9)]
    return [*story, tried(on.os.kill, -pid, 9), tried(on.os.kill, pid, 9)]


def links_are_followed_unless_told_otherwise(on: System, folder: str) -> Story:
    on.os.mkdir(f"{folder}/in", 0o755)
    on.os.close(on.os.open(f"{folder}/in/file", os.O_RDWR | os.O_CREAT, 0o600))
    for name, target in (("file", "in/file"), ("in", f"{folder}/in"), ("nothing", "absent")):
        on.os.symlink(target, f"{folder}/to_{name}")
    story: Story = [tried(on.os.symlink, "x", f"{folder}/in"), tried(on.os.mkfifo, f"{folder}/to_nothing")]
    for name in ("to_file", "to_in", "to_nothing", "in", "to_in/file"):
        for flags in (os.O_RDONLY, os.O_WRONLY, os.O_NOFOLLOW, os.O_PATH | os.O_DIRECTORY | os.O_NOFOLLOW):
            found = tried(on.os.open, f"{folder}/{name}", flags)
            story += [found if isinstance(found, str) else on.os.close(found)]
        story += [oct(on.os.lstat(f"{folder}/{name}").st_mode >> 12), on.os.path.exists(f"{folder}/{name}")]
    story += [
        tried(on.os.rmdir, f"{folder}/in"),
        tried(on.os.rmdir, f"{folder}/to_in"),
        tried(on.os.unlink, f"{folder}/in"),
    ]
    on.os.unlink(f"{folder}/to_file")
    return [*story, on.os.path.exists(f"{folder}/in/file"), on.os.path.lexists(f"{folder}/to_nothing")]


def what_is_made_has_the_mode_that_the_mask_leaves(on: System, folder: str) -> Story:
    story: Story = []
    for mask in (0o027, 0o777, 0o022):
        on.os.umask(mask)
        on.os.close(on.os.open(f"{folder}/file{mask}", os.O_RDWR | os.O_CREAT, 0o666))
        on.os.mkdir(f"{folder}/in{mask}", 0o777)
        on.os.mkfifo(f"{folder}/pipe{mask}", 0o666)
        story += [oct(on.os.lstat(f"{folder}/{name}{mask}").st_mode) for name in ("file", "in", "pipe")]
        on.os.chmod(f"{folder}/file{mask}", 0o1622)
        story += [oct(on.os.stat(f"{folder}/file{mask}").st_mode), on.os.umask(0o022)]
    return story


PROGRAMS = [each for each in tuple(globals().values()) if getattr(each, "__annotations__", {}).get("return") == "Story"]
"""The programs above: those that tell a story."""


@pytest.mark.starts
@pytest.mark.parametrize("program", PROGRAMS, ids=lambda program: program.__name__)
def test_both_tell_the_same_story(program: Callable[[System, str], Story], tmp_path: Path) -> None:
    import mmap

    real = SimpleNamespace(os=os, select=select, fcntl=fcntl, socket=_socket, mmap=mmap, time=time, thread=_thread)
    robot = Robot()
    robot.machine.programs["sh"] = lambda process, argv: robot.machine.block()
    modules = robot.loader.system
    simulated = SimpleNamespace(
        **{name: modules[name] for name in ("os", "select", "fcntl", "mmap", "time")},
        socket=modules["_socket"],
        thread=modules["_thread"],
    )
    told: list[Any] = []
    robot.machine.on_event = lambda kind, process, what: told.append(what) if kind == "failed" else None

    def run(process: Process) -> int:
        told.append(program(simulated, "/run"))
        return 0

    process = robot.machine.process("program", run)
    robot.machine.run(lambda: process.dead, 10**9)
    assert told == [program(real, str(tmp_path))]
