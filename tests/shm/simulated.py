"""A simulated machine on which the test is a process: other users, refused calls and the time that passes are its to
say."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

from failstop_lab.machine.kernel import Machine
from failstop_lab.machine.loading import Loader
from failstop_lab.machine.process import Process
from failstop_lab.machine.users import ProcessFolder

MODULES = (
    "instances",
    "messages.segments",
    *(f"files.{each}" for each in ("durable", "instance", "place")),
    *(f"shm.{each}" for each in ("bell", "claim", "lifeline")),
)
S = 1_000_000_000
USER, OTHER = 1000, 1001


def machine() -> SimpleNamespace:
    """Its modules by the last part of their names. The test runs as root."""
    made = Machine(step_ns=0, look_ns=0)
    own = made.join("test")
    loader = Loader(made)
    made.root.put("proc", ProcessFolder(made))
    for path, mode in (("/dev/shm", 0o1777), ("/run", 0o755), ("/tmp", 0o1777)):
        loader.system["os"].makedirs(path)
        loader.system["os"].chmod(path, mode)
    modules = {name.rpartition(".")[2]: loader.load(f"failstop.{name}") for name in MODULES}
    return SimpleNamespace(
        machine=made, own=own, load=loader.load, system=loader.system, os=loader.system["os"], **modules
    )


@contextlib.contextmanager
def user(on: Any, uid: int, gid: int = -1) -> Iterator[None]:
    before = on.own.uid, on.own.gid
    on.own.uid, on.own.gid = uid, uid if gid < 0 else gid
    try:
        yield
    finally:
        on.own.uid, on.own.gid = before


@contextlib.contextmanager
def refusing(on: Any, call: str, error: int | Exception, of: object = None) -> Iterator[list[Any]]:
    """A call of the system is refused, by a number or an exception; the list gets what each was about."""
    told: list[Any] = []

    def refuse(thread: object, name: str, about: tuple[Any, ...]) -> None:
        if name == call and of in (None, *about[:1]):
            told.append(about)
            raise error if isinstance(error, Exception) else OSError(error, os.strerror(error), *about[:1])

    on.machine.at_seam = refuse
    try:
        yield told
    finally:
        on.machine.at_seam = None


def living(on: Any, work: Callable[[], object]) -> Process:
    """A process of the test's user that does this, and then lives until it is killed."""
    done: list[bool] = []

    def body(process: Process) -> None:
        work()
        done.append(True)
        on.machine.block()

    made: Process = on.machine.process("living", body, parent=on.own)
    assert on.machine.run(lambda: bool(done), S)
    return made


def kill(on: Any, process: Process) -> None:
    on.machine.die(process, -9)
    on.machine.run(lambda: process.code is not None, S)
    process.reaped = True


def put(on: Any, path: str, data: bytes | str = b"", mode: int = 0o644) -> None:
    fd = on.os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, mode)
    on.os.write(fd, data.encode() if isinstance(data, str) else data)
    on.os.close(fd)


def content(on: Any, path: str) -> bytes:
    fd = on.os.open(path, os.O_RDONLY)
    found: bytes = on.os.read(fd, 1 << 20)
    on.os.close(fd)
    return found


def mode(on: Any, path: str) -> int:
    found: int = on.os.lstat(path).st_mode & 0o7777
    return found


def open_fds(on: Any) -> int:
    return len(on.own.files)


def give(on: Any, path: str) -> None:
    with user(on, 0):
        for each in (path, os.path.dirname(path)):
            on.os.chown(each, USER, USER)
