"""Calls: what the simulated modules share - finding files by their paths and descriptors, and waiting."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterable
from types import ModuleType
from typing import Any

from failstop_lab.machine import users
from failstop_lab.machine.files import Directory, Node, Open
from failstop_lab.machine.kernel import Machine
from failstop_lab.machine.process import Process

NS = 1_000_000_000


class Calls:
    """The system calls' own helpers, of one machine."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine

    def process(self, name: str, *about: Any) -> Process:
        """Begin a call; returns the process that makes it."""
        return self.machine.call(name, *about)

    def opened(self, process: Process, fd: Any) -> Open:
        """The open file of a descriptor, or of an object with one. Raises OSError."""
        number = fd if isinstance(fd, int) else fd.fileno()
        try:
            return process.files[number]
        except KeyError:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF)) from None

    def begin(self, name: str, fd: Any, *about: Any) -> Open:
        """Begin a call on a descriptor; returns what it is open on."""
        return self.opened(self.process(name, fd, *about), fd)

    def walk(
        self, process: Process, path: str, dir_fd: int | None = None, start: Node | None = None
    ) -> tuple[Directory, str]:
        """The directory that a path's last part is in, and that part. Raises OSError."""
        path = os.fspath(path)
        here: Node = self.machine.root
        if not path.startswith("/"):
            here = self.opened(process, dir_fd).node if dir_fd is not None else start or here
        parts = [part for part in path.split("/") if part not in ("", ".")]
        for part in parts[:-1]:
            here = self.step(process, here, part, path)
        if not isinstance(here, Directory):
            raise NotADirectoryError(errno.ENOTDIR, "Not a directory", path)
        users.check_rights(process, here, users.MAY_PASS, path)
        return here, parts[-1] if parts else "."

    def node(self, process: Process, path: Any, dir_fd: int | None = None, *, follow: bool = True) -> Node:
        """The node of a path, or of a descriptor. Raises OSError."""
        if isinstance(path, int):
            return self.opened(process, path).node
        above, name = self.walk(process, path, dir_fd)
        return self.step(process, above, name, path, follow=follow)

    def look(self, path: str) -> Node:
        """The node of a path, a link itself where it is one, without the rights of any process. Raises OSError."""
        here: Node = self.machine.root
        for part in filter(None, path.split("/")):
            found = here.found().get(part) if isinstance(here, Directory) else None
            if found is None:
                raise FileNotFoundError(errno.ENOENT, "No such file or directory", path)
            here = found
        return here

    def step(self, process: Process, here: Node, part: str, path: str, *, follow: bool = True) -> Node:
        """The node of this name in a directory, or, where it's a link, the node that it leads to. Raises OSError."""
        if not isinstance(here, Directory):
            raise NotADirectoryError(errno.ENOTDIR, "Not a directory", path)
        users.check_rights(process, here, users.MAY_PASS, path)
        if part in (".", ".."):
            return here if part == "." else here.above
        found = here.found().get(part)
        if found is None:
            raise FileNotFoundError(errno.ENOENT, "No such file or directory", path)
        if follow and isinstance(found, users.SymbolicLink):
            above, name = self.walk(process, found.target, start=here)
            return self.step(process, above, name, path)
        return found

    def wait_for(self, opened: Iterable[Open], ready: Callable[[], Any], timeout_s: float | None) -> Any:
        """Block until ready() is true or the time is over; returns what it said last. None, or below 0: for ever."""
        machine = self.machine
        found = ready()
        if found or timeout_s == 0:
            return found
        thread = machine.caller()
        until_ns = None if timeout_s is None or timeout_s < 0 else machine.now_ns + max(1, round(timeout_s * NS))
        waited = list(opened)
        while True:
            for each in waited:
                each.waiting.append(thread)
            woken = machine.block(until_ns)
            for each in waited:
                if thread in each.waiting:
                    each.waiting.remove(thread)
            found = ready()
            if found or not woken:
                return found


class Module(ModuleType):
    """A module of the simulated machine: its values and methods are what a program finds in it."""

    def __init__(self, name: str, calls: Calls, /, **values: Any) -> None:
        super().__init__(name)
        self._calls = calls
        self._machine = calls.machine
        self.__dict__.update({key: value for key, value in values.items() if not key.startswith("__")})


def constants(module: Any, *prefixes: str) -> dict[str, Any]:
    """The real module's names that begin so: numbers that both worlds share."""
    return {name: value for name, value in vars(module).items() if name.startswith(prefixes)}
