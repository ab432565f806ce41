"""System: the calls of the simulated kernel by the names that Python's own modules give them.

`modules(machine)` is what a program on the simulated machine imports instead of `os`, `time`, `select` and the others. What is
not here does not exist there, so a program that asks for it fails at its first run, and asks no other machine.
"""

from __future__ import annotations

import errno
import os
import posixpath
import select
import signal
import stat
import termios
import time
import weakref
from collections.abc import Callable, Iterable
from types import ModuleType, SimpleNamespace
from typing import Any

from failstop.lab.machine import files, kernel
from failstop.lab.machine.files import Counter, Directory, Epoll, Fifo, Node, Open, Pidfd, Port, Regular, Socket
from failstop.lab.machine.kernel import Machine, Process, Thread

NS = 1_000_000_000
FOREVER_S = 1e9
USER = 0
CONSTANTS = ("O_", "EFD_", "SCHED_", "SEEK_", "R_OK", "W_OK", "X_OK", "F_OK")


class Calls:
    """What the modules share: paths, descriptors, waiting."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine

    def process(self, name: str, *about: Any) -> Process:
        return self.machine.call(name, *about)

    def opened(self, process: Process, fd: Any) -> Open:
        number = fd if isinstance(fd, int) else fd.fileno()
        try:
            return process.files[number]
        except KeyError:
            raise OSError(errno.EBADF, "no such descriptor") from None

    def walk(self, process: Process, path: str, dir_fd: int | None = None) -> tuple[Directory, str]:
        """The directory that a path's last part is in, and that part."""
        path = os.fspath(path)
        here: Node = self.machine.root
        if dir_fd is not None and not path.startswith("/"):
            here = self.opened(process, dir_fd).node
        parts = [part for part in path.split("/") if part not in ("", ".")]
        for part in parts[:-1]:
            here = self._step(here, part, path)
        if not isinstance(here, Directory):
            raise NotADirectoryError(errno.ENOTDIR, "not a directory", path)
        return here, parts[-1] if parts else "."

    def _step(self, here: Node, part: str, path: str) -> Node:
        if not isinstance(here, Directory):
            raise NotADirectoryError(errno.ENOTDIR, "not a directory", path)
        if part == "..":
            return here.above
        if part == ".":
            return here
        if part not in here.names:
            raise FileNotFoundError(errno.ENOENT, "no such file or directory", path)
        return here.names[part]

    def node(self, process: Process, path: Any, dir_fd: int | None = None) -> Node:
        if isinstance(path, int):
            return self.opened(process, path).node
        above, name = self.walk(process, path, dir_fd)
        return self._step(above, name, path)

    def wait_for(self, opened: Iterable[Open], ready: Callable[[], Any], timeout_s: float | None) -> Any:
        """Block until ready() is true or the time is over; returns what it said last."""
        machine = self.machine
        found = ready()
        if found or timeout_s == 0:
            return found
        thread = machine.current
        assert thread is not None
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
    """A module of the simulated machine."""

    def __init__(self, name: str, /, **values: Any) -> None:
        super().__init__(name)
        self.__dict__.update({key: value for key, value in values.items() if not key.startswith("__")})


class Environ(dict):  # type: ignore[type-arg]
    """The environment of whichever process asks."""

    def __init__(self, machine: Machine) -> None:
        super().__init__()
        self._machine = machine

    def _own(self) -> dict[str, str]:
        thread = self._machine.current
        return thread.process.environ if thread else {}

    def __getitem__(self, key: str) -> str:
        return self._own()[key]

    def get(self, key: str, default: Any = None) -> Any:
        return self._own().get(key, default)

    def pop(self, key: str, *default: Any) -> Any:
        return self._own().pop(key, *default)

    def __contains__(self, key: object) -> bool:
        return key in self._own()

    def __iter__(self) -> Any:
        return iter(self._own())

    def keys(self) -> Any:
        return self._own().keys()

    def items(self) -> Any:
        return self._own().items()

    def copy(self) -> dict[str, str]:
        return dict(self._own())


def status(node: Node) -> os.stat_result:
    """What stat() says."""
    at_s, at_ns = divmod(node.changed_ns, NS)
    numbers = (node.kind | node.mode, node.number, 1, node.links, node.uid, node.gid, node.size(), at_s, at_s, at_s)
    return os.stat_result((*numbers, float(at_s), float(at_s), float(at_s), at_ns, at_ns, node.changed_ns, 4096, 0, node.device))


def make_os(calls: Calls) -> Module:
    machine, process_of, opened = calls.machine, calls.process, calls.opened
    found = {name: getattr(os, name) for name in dir(os) if name.startswith(CONSTANTS)}
    found |= {name: getattr(os, name) for name in ("WNOHANG", "devnull", "pathsep", "sep", "linesep", "strerror", "fspath")}
    found |= {name: getattr(os, name) for name in ("major", "minor", "makedev", "stat_result", "sched_param", "error", "PathLike")}
    found |= {name: getattr(os, name) for name in ("waitstatus_to_exitcode", "fsencode", "fsdecode", "name")}
    module = Module("os", **found)

    def call(function: Callable[..., Any]) -> Callable[..., Any]:
        setattr(module, function.__name__.strip("_"), function)
        return function

    @call
    def open_(path: str, flags: int, mode: int = 0o777, *, dir_fd: int | None = None) -> int:
        process = process_of("open", path, flags)
        above, name = calls.walk(process, path, dir_fd)
        if name == "." or name == "..":
            node: Node = above if name == "." else above.above
        elif name in above.names:
            if flags & os.O_CREAT and flags & os.O_EXCL:
                raise FileExistsError(errno.EEXIST, "file exists", path)
            node = above.names[name]
        elif flags & os.O_CREAT:
            node = Regular(mode & 0o777)
            above.put(name, node)
        else:
            raise FileNotFoundError(errno.ENOENT, "no such file or directory", path)
        if flags & os.O_DIRECTORY and not isinstance(node, Directory):
            raise NotADirectoryError(errno.ENOTDIR, "not a directory", path)
        if isinstance(node, Fifo) and flags & 3 == os.O_WRONLY and not node._ends(os.O_RDONLY, os.O_RDWR):
            raise OSError(errno.ENXIO, "nobody reads", path)
        if isinstance(node, Port) and node.exclusive and process.environ.get("UNPRIVILEGED"):
            raise OSError(errno.EBUSY, "held exclusively", path)
        if isinstance(node, Regular) and flags & os.O_TRUNC:
            node.resize(0)
        return process.descriptor(Open(node, flags, path))

    @call
    def close(fd: int) -> None:
        process = process_of("close", fd)
        opened(process, fd)
        process.close(fd)

    @call
    def read(fd: int, most: int) -> bytes:
        process = process_of("read", fd)
        return opened(process, fd).node.read(opened(process, fd), most)

    @call
    def readv(fd: int, buffers: tuple[bytearray, ...]) -> int:
        data = read(fd, len(buffers[0]))
        buffers[0][: len(data)] = data
        return len(data)

    @call
    def write(fd: int, data: bytes) -> int:
        process = process_of("write", fd, data)
        shorter = getattr(machine, "shorter", 0)
        if shorter:
            machine.shorter = 0  # type: ignore[attr-defined]
            data = data[: max(1, len(data) // 2)]
        return opened(process, fd).node.write(opened(process, fd), bytes(data))

    @call
    def pread(fd: int, most: int, at: int) -> bytes:
        process = process_of("pread", fd)
        node = opened(process, fd).node
        return bytes(node.data[at : at + most]) if isinstance(node, Regular) else b""

    @call
    def pwrite(fd: int, data: bytes, at: int) -> int:
        process = process_of("pwrite", fd)
        node = opened(process, fd).node
        if not isinstance(node, Regular):
            raise OSError(errno.ESPIPE, "not a file")
        node.put(bytes(data), at)
        return len(data)

    @call
    def ftruncate(fd: int, size: int) -> None:
        node = opened(process_of("ftruncate", fd), fd).node
        assert isinstance(node, Regular)
        node.resize(size)

    @call
    def posix_fallocate(fd: int, at: int, size: int) -> None:
        node = opened(process_of("fallocate", fd), fd).node
        assert isinstance(node, Regular)
        node.resize(max(node.size(), at + size))
        node.mapped()

    @call
    def fsync(fd: int) -> None:
        opened(process_of("fsync", fd), fd)

    @call
    def fstat(fd: int) -> os.stat_result:
        return status(opened(process_of("fstat", fd), fd).node)

    @call
    def stat_(path: Any, *, dir_fd: int | None = None, follow_symlinks: bool = True) -> os.stat_result:
        return status(calls.node(process_of("stat", path), path, dir_fd))

    module.lstat = stat_

    @call
    def access(path: str, mode: int) -> bool:
        try:
            calls.node(process_of("access", path), path)
        except OSError:
            return False
        return True

    @call
    def listdir(path: str = ".") -> list[str]:
        process = process_of("listdir", path)
        if path == "/proc/self/fd":
            return [str(fd) for fd in (*sorted(process.files), 999)]
        node = calls.node(process, path)
        if not isinstance(node, Directory):
            raise NotADirectoryError(errno.ENOTDIR, "not a directory", path)
        return list(node.names)

    @call
    def mkdir(path: str, mode: int = 0o777, *, dir_fd: int | None = None) -> None:
        above, name = calls.walk(process_of("mkdir", path), path, dir_fd)
        if name in above.names:
            raise FileExistsError(errno.EEXIST, "file exists", path)
        above.put(name, Directory(mode & 0o777, above))

    @call
    def makedirs(path: str, mode: int = 0o777, exist_ok: bool = False) -> None:
        process_of("mkdir", path)
        here = machine.root
        for part in filter(None, path.split("/")):
            if part not in here.names:
                here.put(part, Directory(0o755, here))
            child = here.names[part]
            if not isinstance(child, Directory):
                raise FileExistsError(errno.EEXIST, "file exists", path)
            here = child

    @call
    def mkfifo(path: str, mode: int = 0o666, *, dir_fd: int | None = None) -> None:
        above, name = calls.walk(process_of("mkfifo", path), path, dir_fd)
        if name in above.names:
            raise FileExistsError(errno.EEXIST, "file exists", path)
        above.put(name, Fifo(mode & 0o777))

    @call
    def unlink(path: str, *, dir_fd: int | None = None) -> None:
        above, name = calls.walk(process_of("unlink", path), path, dir_fd)
        if name not in above.names:
            raise FileNotFoundError(errno.ENOENT, "no such file or directory", path)
        above.drop(name)

    module.remove = unlink

    @call
    def rename(old: str, new: str, *, src_dir_fd: int | None = None, dst_dir_fd: int | None = None) -> None:
        process = process_of("rename", old)
        above, name = calls.walk(process, old, src_dir_fd)
        if name not in above.names:
            raise FileNotFoundError(errno.ENOENT, "no such file or directory", old)
        below, other = calls.walk(process, new, dst_dir_fd)
        node = above.names.pop(name)
        if other in below.names:
            below.drop(other)
        below.names[other] = node

    module.replace = rename

    def attribute(name: str, set_it: Callable[..., None]) -> None:
        def change(path: Any, *values: Any, dir_fd: int | None = None) -> None:
            set_it(calls.node(process_of(name, path), path, dir_fd), *values)

        setattr(module, name, change)
        setattr(module, f"f{name}", change)

    attribute("chmod", lambda node, mode: setattr(node, "mode", mode))
    attribute("chown", lambda node, uid, gid: None)

    @call
    def dup(fd: int) -> int:
        process = process_of("dup", fd)
        return process.descriptor(opened(process, fd))

    @call
    def set_inheritable(fd: int, inheritable: bool) -> None:
        process = process_of("set_inheritable", fd)
        opened(process, fd)
        (process.inheritable.add if inheritable else process.inheritable.discard)(fd)

    @call
    def eventfd(value: int = 0, flags: int = 0) -> int:
        return process_of("eventfd").descriptor(Open(Counter(), os.O_RDWR))

    @call
    def pidfd_open(pid: int, flags: int = 0) -> int:
        process = process_of("pidfd_open", pid)
        target = machine.processes.get(pid)
        if target is None or target.reaped:
            raise ProcessLookupError(errno.ESRCH, "no such process")
        made = Open(Pidfd(target))
        target.watchers.append(made)
        return process.descriptor(made)

    @call
    def kill(pid: int, number: int) -> None:
        process_of("kill", pid)
        target = machine.processes.get(pid)
        if target is None or target.reaped:
            raise ProcessLookupError(errno.ESRCH, "no such process")
        machine.kill(target, int(number))

    @call
    def waitpid(pid: int, options: int) -> tuple[int, int]:
        process = process_of("waitpid", pid)
        child = machine.processes.get(pid)
        if child is None or child.reaped or child.parent is not process:
            raise ChildProcessError(errno.ECHILD, "no such child")
        while child.code is None:
            if options & os.WNOHANG:
                return 0, 0
            machine.block(machine.now_ns + 1_000_000)
        child.reaped = True
        return pid, (child.code << 8) if child.code >= 0 else -child.code

    @call
    def posix_spawn(path: str, argv: list[str], environ: Any, *, setsid: bool = False) -> int:
        process = process_of("spawn", argv)
        made = machine.process(_script(argv), lambda child: start(child, argv), dict(environ), process)
        inherit(process, made, process.inheritable)
        return made.pid

    def inherit(process: Process, made: Process, fds: Iterable[int]) -> None:
        for fd in sorted({*fds, 0, 1, 2} & set(process.files)):
            each = process.files[fd]
            made.files[fd] = each
            each.references += 1
        made.inheritable = set(made.files)

    def _script(argv: list[str]) -> str:
        script = next((each for each in argv if each.endswith(".py")), argv[0])
        return argv[argv.index(script) + 1] if script.endswith("child.py") else posixpath.basename(script)

    def start(child: Process, argv: list[str]) -> int:
        script = next((each for each in argv if each.endswith(".py")), argv[0])
        program = machine.names.get(posixpath.basename(script))
        return program(child, argv[argv.index(script) :]) if program else 0

    @call
    def _exit(code: int) -> None:
        process = process_of("exit")
        machine.die(process, code)

    module._exit = _exit

    @call
    def urandom(most: int) -> bytes:
        process = process_of("urandom")
        process.random = (process.random * 6364136223846793005 + machine.seed + 1442695040888963407) % (1 << 64)
        return (process.random.to_bytes(8, "little") * (most // 8 + 1))[:most]

    for name, value in {"getuid": USER, "geteuid": USER, "getgid": 0, "getegid": 0, "getpgrp": 1, "umask": 0o22}.items():
        setattr(module, name, lambda *_, value=value: value)
    module.getgroups = lambda: [0]
    module.getpid = lambda: machine.current.process.pid if machine.current else 0
    module.getppid = lambda: parent.pid if machine.current and (parent := machine.current.process.parent) else 1
    module.uname = lambda: SimpleNamespace(machine="x86_64", sysname="Linux", release="6.1", nodename="simulated")
    module.sched_getscheduler = lambda pid: 1
    module.sched_getparam = lambda pid: os.sched_param(10)
    module.sched_setscheduler = lambda pid, policy, param: None
    module.cpu_count = lambda: 2
    module.get_terminal_size = lambda fd=0: os.terminal_size((80, 24))
    module.isatty = lambda fd: False
    module.get_blocking = lambda fd: False
    module.environ = Environ(machine)
    module.register_at_fork = lambda **_: None

    path = Module("posixpath", **{name: value for name, value in vars(posixpath).items() if not name.startswith("__")})

    def exists(where: Any) -> bool:
        try:
            calls.node(process_of("stat", where), where)
        except OSError:
            return False
        return True

    def is_kind(kind: type[Node]) -> Callable[[Any], bool]:
        def look(where: Any) -> bool:
            try:
                return isinstance(calls.node(process_of("stat", where), where), kind)
            except OSError:
                return False

        return look

    path.exists = path.lexists = exists
    path.isdir, path.isfile = is_kind(Directory), is_kind(Regular)
    path.islink = lambda where: False
    path.abspath = path.realpath = posixpath.normpath
    path.expanduser = lambda where: where.replace("~", "/root", 1)
    module.path = path
    return module


class SimulatedEpoll:
    """select.epoll."""

    def __init__(self, calls: Calls) -> None:
        self._calls = calls
        process = calls.process("epoll_create")
        self._opened = Open(Epoll())
        self._fd = process.descriptor(self._opened)
        node = self._opened.node
        assert isinstance(node, Epoll)
        self._node = node

    def fileno(self) -> int:
        return self._fd

    def register(self, fd: Any, events: int = 0) -> None:
        number = fd if isinstance(fd, int) else fd.fileno()
        process = self._calls.process("epoll_ctl", number)
        opened = self._calls.opened(process, number)
        if number in self._node.wanted:
            raise FileExistsError(errno.EEXIST, "registered already")
        self._node.add(number, opened, events)

    def modify(self, fd: Any, events: int) -> None:
        number = fd if isinstance(fd, int) else fd.fileno()
        process = self._calls.process("epoll_ctl", number)
        self._node.add(number, self._calls.opened(process, number), events)

    def unregister(self, fd: Any) -> None:
        number = fd if isinstance(fd, int) else fd.fileno()
        self._calls.process("epoll_ctl", number)
        if number not in self._node.wanted:
            raise FileNotFoundError(errno.ENOENT, "not registered")
        self._node.drop(number)

    def poll(self, timeout: float | None = None, maxevents: int = -1) -> list[tuple[int, int]]:
        self._calls.process("epoll_wait")
        if timeout is not None and timeout > 0:
            timeout = -(-timeout * 1000 // 1) / 1000
        found: list[tuple[int, int]] = self._calls.wait_for((self._opened,), self._node.take, timeout)
        return found

    def close(self) -> None:
        self._calls.process("close").close(self._fd)


class SimulatedPoll:
    """select.poll."""

    def __init__(self, calls: Calls) -> None:
        self._calls = calls
        self._wanted: dict[int, int] = {}

    def register(self, fd: Any, events: int = files.IN | files.OUT) -> None:
        self._wanted[fd if isinstance(fd, int) else fd.fileno()] = events

    def poll(self, timeout: float | None = None) -> list[tuple[int, int]]:
        process = self._calls.process("poll")
        held = {fd: self._calls.opened(process, fd) for fd in self._wanted}

        def ready() -> list[tuple[int, int]]:
            masks = ((fd, each.mask() & (self._wanted[fd] | files.ERR | files.HUP)) for fd, each in held.items())
            return [(fd, mask) for fd, mask in masks if mask]

        seconds = None if timeout is None or timeout < 0 else timeout / 1000
        found: list[tuple[int, int]] = self._calls.wait_for(held.values(), ready, seconds)
        return found


def make_select(calls: Calls) -> Module:
    module = Module("select", **{name: getattr(select, name) for name in dir(select) if name.startswith(("EPOLL", "POLL", "PIPE"))})

    def select_(
        reading: Iterable[Any], writing: Iterable[Any], other: Iterable[Any], timeout: float | None = None
    ) -> tuple[list[Any], list[Any], list[Any]]:
        process = calls.process("select")
        wanted = [(each, calls.opened(process, each), files.IN | files.HUP | files.ERR, 0) for each in reading]
        wanted += [(each, calls.opened(process, each), files.OUT | files.ERR, 1) for each in writing]

        def ready() -> list[tuple[Any, int]]:
            return [(each, which) for each, held, mask, which in wanted if held.mask() & mask]

        found = calls.wait_for([held for _, held, _, _ in wanted], ready, timeout)
        return [each for each, which in found if which == 0], [each for each, which in found if which == 1], []

    module.select = select_
    module.epoll = lambda *_: SimulatedEpoll(calls)
    module.poll = lambda: SimulatedPoll(calls)
    return module


def make_time(calls: Calls) -> Module:
    machine = calls.machine
    module = Module("time", **{name: getattr(time, name) for name in ("gmtime", "localtime", "strftime", "mktime", "CLOCK_BOOTTIME", "CLOCK_MONOTONIC", "struct_time", "timezone")})

    def now_ns() -> int:
        machine.now_ns += 50
        return machine.now_ns

    def clock_gettime_ns(clock: int) -> int:
        if clock == time.CLOCK_BOOTTIME:
            return now_ns() + machine.slept_ns
        if clock == time.CLOCK_MONOTONIC:
            return now_ns()
        raise OSError(errno.EINVAL, "no such clock here")

    def sleep(seconds: float) -> None:
        calls.process("sleep")
        until_ns = machine.now_ns + round(seconds * NS)
        while machine.now_ns < until_ns:
            machine.block(until_ns)
        if seconds <= 0:
            machine.give_way()

    module.monotonic_ns = module.perf_counter_ns = now_ns
    module.monotonic = module.perf_counter = lambda: now_ns() / NS
    module.time = lambda: machine.unix_offset_s + now_ns() / NS
    module.time_ns = lambda: round(machine.unix_offset_s * NS) + now_ns()
    module.process_time_ns = lambda: machine.now_ns // 100
    module.clock_gettime_ns = clock_gettime_ns
    module.clock_gettime = lambda clock: clock_gettime_ns(clock) / NS
    module.sleep = sleep
    return module


def make_fcntl(calls: Calls) -> Module:
    import fcntl
    import struct

    module = Module("fcntl", **{name: getattr(fcntl, name) for name in dir(fcntl) if name.startswith(("F_", "LOCK_", "FD_"))})
    lock = struct.Struct("hhqqi4x")

    def fcntl_(fd: int, command: int, argument: Any = 0) -> Any:
        process = calls.process("fcntl", fd)
        opened = calls.opened(process, fd)
        kind, _, begin, _, _ = lock.unpack(argument)
        locks = opened.node.locks
        holder = locks.get(begin)
        if command == fcntl.F_OFD_GETLK:
            taken = holder is not None and holder is not opened
            return lock.pack(fcntl.F_WRLCK if taken else fcntl.F_UNLCK, 0, begin, 1, -1)
        if kind == fcntl.F_UNLCK:
            if holder is opened:
                del locks[begin]
            return 0
        if holder is not None and holder is not opened:
            raise BlockingIOError(errno.EAGAIN, "held")
        locks[begin] = opened
        return 0

    def flock(fd: int, operation: int) -> None:
        process = calls.process("flock", fd)
        opened = calls.opened(process, fd)
        holder = opened.node.locks.get(-1)
        if operation & fcntl.LOCK_UN:
            if holder is opened:
                del opened.node.locks[-1]
        elif holder is not None and holder is not opened:
            raise BlockingIOError(errno.EAGAIN, "held")
        else:
            opened.node.locks[-1] = opened

    def ioctl(fd: int, request: int, argument: Any = b"") -> Any:
        process = calls.process("ioctl", fd)
        node = calls.opened(process, fd).node
        if isinstance(node, Port):
            if node.gone:
                raise OSError(errno.EIO, "the device is gone")
            if request == termios.TIOCOUTQ:
                return len(node.held).to_bytes(4, "little")
            if request == termios.TIOCEXCL:
                node.exclusive = True
            return argument
        if isinstance(node, Fifo) and request == termios.FIONREAD:
            return len(node.data).to_bytes(4, "little")
        raise OSError(errno.ENOTTY, "not a terminal")

    module.fcntl, module.flock, module.ioctl = fcntl_, flock, ioctl
    return module


def make_termios(calls: Calls) -> Module:
    module = Module("termios", **{name: value for name, value in vars(termios).items() if name.isupper() or name == "error"})

    def port(fd: int) -> Port:
        node = calls.opened(calls.process("tcattr", fd), fd).node
        if not isinstance(node, Port):
            raise termios.error(errno.ENOTTY, "not a terminal")
        if node.gone:
            raise termios.error(errno.EIO, "the device is gone")
        return node

    def tcsetattr(fd: int, when: int, settings: list[Any]) -> None:
        port(fd).settings = [*settings[:6], list(settings[6])]

    module.tcgetattr = lambda fd: [*port(fd).settings[:6], list(port(fd).settings[6])]
    module.tcsetattr = tcsetattr
    module.tcflow = lambda fd, action: None
    return module


def make_mmap(calls: Calls) -> Module:
    import mmap

    module = Module("mmap", **{name: value for name, value in vars(mmap).items() if name.isupper()})

    def map_(fd: int, size: int, flags: int = 0, prot: int = 0) -> mmap.mmap:
        node = calls.opened(calls.process("mmap", fd), fd).node
        assert isinstance(node, Regular)
        return node.mapped()

    module.mmap = map_
    return module


class Lock:
    """A lock of `_thread`."""

    __slots__ = ("_calls", "_held", "_waiting")

    def __init__(self, calls: Calls) -> None:
        self._calls = calls
        self._held = False
        self._waiting: list[Thread] = []

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        if not self._held:
            self._held = True
            return True
        if not blocking:
            return False
        machine = self._calls.machine
        thread = machine.current
        assert thread is not None
        until_ns = None if timeout < 0 else machine.now_ns + round(timeout * NS)
        while self._held:
            if until_ns is not None and machine.now_ns >= until_ns:
                return False
            self._waiting.append(thread)
            machine.block(until_ns)
        self._held = True
        return True

    def release(self) -> None:
        if not self._held:
            raise RuntimeError("release unlocked lock")
        self._held = False
        if self._waiting:
            self._calls.machine.wake(self._waiting.pop(0))

    def locked(self) -> bool:
        return self._held

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *_: object) -> None:
        self.release()


class ReentrantLock:
    """threading.RLock."""

    def __init__(self, calls: Calls) -> None:
        self._lock = Lock(calls)
        self._calls = calls
        self._owner: Thread | None = None
        self._depth = 0

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        if self._owner is not self._calls.machine.current or not self._depth:
            if not self._lock.acquire(blocking, timeout):
                return False
            self._owner = self._calls.machine.current
        self._depth += 1
        return True

    def release(self) -> None:
        self._depth -= 1
        if not self._depth:
            self._owner = None
            self._lock.release()

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *_: object) -> None:
        self.release()


class Queue:
    """_queue.SimpleQueue."""

    def __init__(self, calls: Calls) -> None:
        self._calls = calls
        self._items: list[Any] = []
        self._waiting: list[Thread] = []

    def put(self, item: Any) -> None:
        self._items.append(item)
        if self._waiting:
            self._calls.machine.wake(self._waiting.pop(0))

    def get(self) -> Any:
        machine = self._calls.machine
        while not self._items:
            assert machine.current is not None
            self._waiting.append(machine.current)
            machine.block()
        return self._items.pop(0)

    def get_nowait(self) -> Any:
        import _queue

        if not self._items:
            raise _queue.Empty
        return self._items.pop(0)

    def qsize(self) -> int:
        return len(self._items)

    def empty(self) -> bool:
        return not self._items


def make_threads(calls: Calls) -> dict[str, Module]:
    machine = calls.machine

    def start(body: Callable[..., object], arguments: tuple[Any, ...] = (), _named: Any = None) -> int:
        process = calls.process("thread")
        return machine.thread(process, lambda: body(*arguments)).number

    def ident() -> int:
        return machine.current.number if machine.current else 0

    import _queue

    thread = Module("_thread", start_new_thread=start, allocate_lock=lambda: Lock(calls), get_ident=ident)
    thread.get_native_id = ident
    thread.LockType = Lock
    thread.stack_size = lambda size=0: 0
    threading = Module("threading", Lock=lambda: Lock(calls), RLock=lambda: ReentrantLock(calls), get_ident=ident)
    queue = Module("_queue", SimpleQueue=lambda: Queue(calls), Empty=_queue.Empty)
    return {"_thread": thread, "threading": threading, "_queue": queue}


def make_signals(calls: Calls) -> dict[str, Module]:
    machine = calls.machine
    names = {name: getattr(signal, name) for name in dir(signal) if name.startswith(("SIG", "ITIMER"))}
    module = Module("signal", **names, Signals=signal.Signals, valid_signals=signal.valid_signals)

    def handle(number: int, handler: Any) -> Any:
        process = calls.process("sigaction", number)
        if machine.current is not process.threads[0]:
            raise ValueError("signal only works in main thread")
        before = process.handlers.get(number, signal.SIG_DFL)
        if handler in (signal.SIG_DFL, None):
            process.handlers.pop(number, None)
        else:
            process.handlers[number] = handler
        return before

    def pidfd_send_signal(fd: int, number: int) -> None:
        node = calls.opened(calls.process("kill", fd), fd).node
        assert isinstance(node, Pidfd)
        if node.process.reaped:
            raise ProcessLookupError(errno.ESRCH, "no such process")
        machine.kill(node.process, int(number))

    module.signal = handle
    module.getsignal = lambda number: machine.current.process.handlers.get(number, signal.SIG_DFL) if machine.current else None
    module.setitimer = lambda which, seconds, interval=0.0: (0.0, 0.0)
    module.pthread_sigmask = lambda how, mask: set()
    module.pidfd_send_signal = pidfd_send_signal
    return {"signal": module, "_signal": module}


class SimulatedSocket:
    """_socket.socket of an AF_UNIX pair."""

    def __init__(self, calls: Calls, fd: int) -> None:
        self._calls = calls
        self._fd = fd

    def fileno(self) -> int:
        return self._fd

    def setblocking(self, blocking: bool) -> None:
        return None

    def _own(self, name: str) -> tuple[Process, Open, Socket]:
        process = self._calls.process(name, self._fd)
        opened = self._calls.opened(process, self._fd)
        assert isinstance(opened.node, Socket)
        return process, opened, opened.node

    def sendmsg(self, buffers: list[bytes], ancillary: Any = (), flags: int = 0) -> int:
        process, opened, node = self._own("sendmsg")
        passed = [
            self._calls.opened(process, int.from_bytes(data[:4], "little", signed=True)) for _, _, data in ancillary
        ]
        return node.write(opened, b"".join(buffers), tuple(passed))

    def recvmsg(self, most: int, room: int = 0, flags: int = 0) -> tuple[bytes, list[Any], int, None]:
        process, _, node = self._own("recvmsg")
        data, passed = node.take(most)
        import _socket

        fds = []
        for each in passed:
            each.references -= 1
            fds.append(process.descriptor(each))
        packed = b"".join(fd.to_bytes(4, "little", signed=True) for fd in fds)
        return data, [(_socket.SOL_SOCKET, _socket.SCM_RIGHTS, packed)] if fds else [], 0, None

    def send(self, data: bytes) -> int:
        _, opened, node = self._own("write")
        return node.write(opened, data)

    def recv(self, most: int) -> bytes:
        _, _, node = self._own("read")
        return node.take(most)[0]

    def shutdown(self, how: int) -> None:
        _, _, node = self._own("shutdown")
        if node.peer:
            node.peer.ended = True
            node.peer.notify()

    def detach(self) -> int:
        fd, self._fd = self._fd, -1
        return fd

    def close(self) -> None:
        if self._fd >= 0:
            self._calls.process("close").close(self.detach())


def make_socket(calls: Calls) -> Module:
    import _socket

    kinds = ("AF_", "SOCK_", "SOL_", "SCM_", "MSG_", "SHUT_")
    module = Module("_socket", **{name: getattr(_socket, name) for name in dir(_socket) if name.startswith(kinds)})
    module.CMSG_LEN = _socket.CMSG_LEN

    def pair(family: int = _socket.AF_UNIX, kind: int = _socket.SOCK_STREAM) -> tuple[SimulatedSocket, SimulatedSocket]:
        process = calls.process("socketpair")
        packets = bool(kind & 0xF == _socket.SOCK_SEQPACKET)
        ends = Socket(packets=packets), Socket(packets=packets)
        ends[0].peer, ends[1].peer = ends[1], ends[0]
        first, second = (SimulatedSocket(calls, process.descriptor(Open(end))) for end in ends)
        return first, second

    def socket(family: int = 0, kind: int = 0, protocol: int = 0, fileno: int | None = None) -> SimulatedSocket:
        if fileno is None:
            raise OSError(errno.EAFNOSUPPORT, "no network here")
        return SimulatedSocket(calls, fileno)

    module.socketpair, module.socket = pair, socket
    module.close = lambda fd: calls.process("close").close(fd)
    return module


def make_rest(calls: Calls) -> dict[str, Module]:
    machine = calls.machine

    class Error(Exception):
        pass

    class Existential(Error):
        pass

    def folder() -> Directory:
        found = machine.root.names["dev"]
        assert isinstance(found, Directory)
        shm = found.names["shm"]
        assert isinstance(shm, Directory)
        return shm

    class SharedMemory:
        def __init__(self, name: str, flags: int = 0, mode: int = 0o600) -> None:
            process = calls.process("shm_open", name)
            if name.lstrip("/") in folder().names:
                raise Existential("there is one of this name")
            made = Regular(mode)
            folder().put(name.lstrip("/"), made)
            self.fd = process.descriptor(Open(made))

    def unlink(name: str) -> None:
        calls.process("unlink", name)
        if name.lstrip("/") not in folder().names:
            raise Existential("no such name")
        folder().drop(name.lstrip("/"))

    posix_ipc = Module(
        "posix_ipc", Error=Error, ExistentialError=Existential, SharedMemory=SharedMemory, unlink_shared_memory=unlink, O_CREX=1
    )

    def getgrnam(name: str) -> Any:
        raise KeyError(name)

    grp = Module("grp", getgrnam=getgrnam, getgrgid=getgrnam)
    pwd = Module("pwd", getpwuid=lambda uid: SimpleNamespace(pw_name=f"user{uid}"))
    def finalize(*arguments: Any) -> Any:
        made = weakref.finalize(*arguments)
        made.atexit = False
        return made

    weak = Module("weakref", **{**vars(weakref), "finalize": finalize})
    gc = Module("gc", collect=lambda: 0, freeze=lambda: None, disable=lambda: None)
    return {"posix_ipc": posix_ipc, "grp": grp, "pwd": pwd, "gc": gc, "weakref": weak}


def make_sys(calls: Calls) -> Module:
    import sys

    machine = calls.machine

    class Sys(Module):
        @property
        def path(self) -> list[str]:
            return machine.current.process.sys_path if machine.current else []

        @property
        def argv(self) -> list[str]:
            return machine.current.process.argv if machine.current else ["simulation"]

    def exit_(code: object = 0) -> None:
        raise SystemExit(code)

    return Sys("sys", executable="/usr/bin/python3", exit=exit_, version_info=sys.version_info, platform="linux", flags=sys.flags, byteorder=sys.byteorder)


def modules(machine: Machine) -> dict[str, Any]:
    """What is imported on the simulated machine, by name."""
    calls = Calls(machine)
    found: dict[str, Any] = {
        "os": make_os(calls),
        "select": make_select(calls),
        "time": make_time(calls),
        "fcntl": make_fcntl(calls),
        "termios": make_termios(calls),
        "mmap": make_mmap(calls),
        "_socket": make_socket(calls),
        "sys": make_sys(calls),
        "stat": stat,
        **make_threads(calls),
        **make_signals(calls),
        **make_rest(calls),
    }
    found["os.path"] = found["os"].path
    found["calls"] = calls
    return found


__all__ = ["Calls", "kernel", "modules"]
