"""The simulated `os` and `os.path`."""

from __future__ import annotations

import errno
import os
import posixpath
from types import SimpleNamespace
from typing import Any

from failstop_lab.machine import users
from failstop_lab.machine.calls import NS, Calls, Module, constants
from failstop_lab.machine.files import Counter, Directory, Fifo, Node, Open, Pidfd, Regular
from failstop_lab.machine.kernel import Machine
from failstop_lab.machine.process import Process
from failstop_lab.machine.system_processes import Processes

PLAIN = (
    *("WNOHANG", "devnull", "pathsep", "sep", "linesep", "strerror", "fspath", "fsencode", "fsdecode", "name", "error"),
    *("major", "minor", "makedev", "stat_result", "sched_param", "terminal_size", "waitstatus_to_exitcode", "PathLike"),
)
"""Names of `os` that ask no machine."""
NOBODY_YET = 999
"""The descriptor of the listing itself, in /proc/self/fd."""


class Environ(dict):  # type: ignore[type-arg]
    """The environment of the process that asks."""

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


class StatResult:
    """The answer of stat()."""

    __slots__ = (
        "st_ctime_ns",
        "st_dev",
        "st_gid",
        "st_ino",
        "st_mode",
        "st_mtime",
        "st_mtime_ns",
        "st_nlink",
        "st_rdev",
        "st_size",
        "st_uid",
    )

    def __init__(self, node: Node) -> None:
        self.st_mode, self.st_ino, self.st_nlink = node.kind | node.mode, node.number, node.links
        self.st_uid, self.st_gid, self.st_size = node.uid, node.gid, node.size()
        self.st_dev = 1
        self.st_rdev, self.st_ctime_ns, self.st_mtime = node.device, node.changed_ns, node.changed_ns / NS
        self.st_mtime_ns = node.changed_ns


class Paths(Module):
    """The calls that take a path."""

    def open(self, path: str, flags: int, mode: int = 0o777, *, dir_fd: int | None = None) -> int:
        process = self._calls.process("open", path, flags)
        above, name = self._calls.walk(process, path, dir_fd)
        node = self._found(process, above, name, flags, path)
        if node is None:
            users.check_rights(process, above, users.MAY_WRITE, path)
            above.put(name, node := users.made(process, Regular(mode & 0o777)))
        else:
            users.check_rights(process, node, users.wanted(flags), path)
        if flags & os.O_DIRECTORY and not isinstance(node, Directory):
            raise NotADirectoryError(errno.ENOTDIR, "Not a directory", path)
        if isinstance(node, Directory) and flags & 3:
            raise IsADirectoryError(errno.EISDIR, "Is a directory", path)
        if (
            isinstance(node, Fifo)
            and flags & 3 == os.O_WRONLY
            and flags & os.O_NONBLOCK
            and not node.ends(os.O_RDONLY, os.O_RDWR)
        ):
            raise OSError(errno.ENXIO, "nobody reads", path)
        if isinstance(node, Regular) and flags & os.O_TRUNC:
            node.resize(0)
        opened = Open(node, flags)
        if isinstance(node, Fifo) and not flags & (os.O_NONBLOCK | os.O_PATH):
            other = os.O_RDONLY if flags & 3 == os.O_WRONLY else os.O_WRONLY
            if not node.ends(os.O_RDWR, other):
                node.openers.append(self._machine.caller())
                self._machine.block()
        return process.descriptor(opened)

    def _found(self, process: Process, above: Directory, name: str, flags: int, path: str) -> Node | None:
        """The node to open; None: it is to be created."""
        if name in (".", ".."):
            return above if name == "." else above.above
        if name in above.found():
            if flags & os.O_CREAT and flags & os.O_EXCL:
                raise FileExistsError(errno.EEXIST, "File exists", path)
            found = self._calls.step(process, above, name, path, follow=not flags & os.O_NOFOLLOW)
            if isinstance(found, users.SymbolicLink) and not flags & os.O_PATH:
                raise OSError(errno.ELOOP, "Too many levels of symbolic links", path)
            return found
        if not flags & os.O_CREAT:
            raise FileNotFoundError(errno.ENOENT, "No such file or directory", path)
        return None

    def stat(self, path: Any, *, dir_fd: int | None = None, follow_symlinks: bool = True) -> StatResult:
        return StatResult(self._calls.node(self._calls.process("stat", path), path, dir_fd, follow=follow_symlinks))

    def lstat(self, path: Any, *, dir_fd: int | None = None) -> StatResult:
        return self.stat(path, dir_fd=dir_fd, follow_symlinks=False)

    def access(self, path: str, mode: int) -> bool:
        try:
            self._calls.node(self._calls.process("access", path), path)
        except OSError:
            return False
        return True

    def listdir(self, path: str = ".") -> list[str]:
        process = self._calls.process("listdir", path)
        if path == "/proc/self/fd":
            return [str(fd) for fd in (*sorted(process.files), NOBODY_YET)]
        node = self._calls.node(process, path)
        if not isinstance(node, Directory):
            raise NotADirectoryError(errno.ENOTDIR, "Not a directory", path)
        users.check_rights(process, node, users.MAY_READ, path)
        return list(node.found())

    def _put(self, call: str, path: str, node: Node, dir_fd: int | None) -> None:
        process = self._calls.process(call, path)
        above, name = self._calls.walk(process, path, dir_fd)
        if name in above.names:
            raise FileExistsError(errno.EEXIST, "File exists", path)
        users.check_rights(process, above, users.MAY_WRITE, path)
        above.put(name, users.made(process, node))
        if isinstance(node, Directory):
            node.above = above

    def mkdir(self, path: str, mode: int = 0o777, *, dir_fd: int | None = None) -> None:
        self._put("mkdir", path, Directory(mode & 0o777), dir_fd)

    def mkfifo(self, path: str, mode: int = 0o666, *, dir_fd: int | None = None) -> None:
        self._put("mkfifo", path, Fifo(mode & 0o777), dir_fd)

    def symlink(self, target: str, path: str) -> None:
        self._put("symlink", path, users.SymbolicLink(os.fspath(target)), None)

    def makedirs(self, path: str, mode: int = 0o777, exist_ok: bool = False) -> None:
        self._calls.process("mkdir", path)
        here = self._machine.root
        for part in filter(None, path.split("/")):
            if part not in here.names:
                here.put(part, Directory(0o755, here))
            child = here.names[part]
            if not isinstance(child, Directory):
                raise FileExistsError(errno.EEXIST, "File exists", path)
            here = child

    def rmdir(self, path: str, *, dir_fd: int | None = None) -> None:
        process = self._calls.process("rmdir", path)
        above, name = self._calls.walk(process, path, dir_fd)
        node = self._calls.step(process, above, name, path, follow=False)
        users.check_drop(process, above, node, path)
        if not isinstance(node, Directory):
            raise NotADirectoryError(errno.ENOTDIR, "Not a directory", path)
        if node.found():
            raise OSError(errno.ENOTEMPTY, "Directory not empty", path)
        above.drop(name)

    def unlink(self, path: str, *, dir_fd: int | None = None) -> None:
        process = self._calls.process("unlink", path)
        above, name = self._calls.walk(process, path, dir_fd)
        node = self._calls.step(process, above, name, path, follow=False)
        users.check_drop(process, above, node, path)
        if isinstance(node, Directory):
            raise IsADirectoryError(errno.EISDIR, "Is a directory", path)
        above.drop(name)

    remove = unlink

    def rename(self, old: str, new: str, *, src_dir_fd: int | None = None, dst_dir_fd: int | None = None) -> None:
        process = self._calls.process("rename", old)
        above, name = self._calls.walk(process, old, src_dir_fd)
        node = self._calls.step(process, above, name, old, follow=False)
        below, other = self._calls.walk(process, new, dst_dir_fd)
        users.check_drop(process, above, node, old)
        users.check_drop(process, below, below.names.get(other, node), new)
        del above.names[name]
        if other in below.names:
            below.drop(other)
        below.names[other] = node

    replace = rename

    def chmod(self, path: Any, mode: int, *, dir_fd: int | None = None) -> None:
        process = self._calls.process("chmod", path)
        node = self._calls.node(process, path, dir_fd)
        users.check_owner(process, node)
        node.mode = mode

    fchmod = chmod

    def chown(self, path: Any, uid: int, gid: int, *, dir_fd: int | None = None) -> None:
        process = self._calls.process("chown", path)
        node = self._calls.node(process, path, dir_fd)
        if min(uid, gid) < -1:
            raise OverflowError("a number below -1 is no user's and no group's")
        users.check_owner(process, node, gid, uid)
        node.uid, node.gid = uid if uid >= 0 else node.uid, gid if gid >= 0 else node.gid

    fchown = chown


class Descriptors(Module):
    """The calls that take a descriptor, or make one."""

    def close(self, fd: int) -> None:
        process = self._calls.process("close", fd)
        self._calls.opened(process, fd)
        process.close(fd)

    def read(self, fd: int, most: int) -> bytes:
        opened = self._calls.begin("read", fd)
        return opened.node.read(opened, most)

    def readv(self, fd: int, buffers: tuple[bytearray, ...]) -> int:
        data = self.read(fd, len(buffers[0]))
        buffers[0][: len(data)] = data
        return len(data)

    def write(self, fd: int, data: bytes) -> int:
        opened = self._calls.begin("write", fd, data)
        return opened.node.write(opened, self._cut_short(data))

    def _cut_short(self, data: bytes) -> bytes:
        """The part of its data that a write takes."""
        short, self._machine.shortened = self._machine.shortened, False
        return bytes(data[: max(1, len(data) // 2)] if short else data)

    def pread(self, fd: int, most: int, at: int) -> bytes:
        node = self._calls.begin("pread", fd).node
        return node.get(at, most) if isinstance(node, Regular) else b""

    def pwrite(self, fd: int, data: bytes, at: int) -> int:
        node = self._calls.begin("pwrite", fd).node
        if not isinstance(node, Regular):
            raise OSError(errno.ESPIPE, "not a file")
        taken = self._cut_short(data)
        node.put(taken, at)
        return len(taken)

    def _regular(self, call: str, fd: int) -> Regular:
        node = self._calls.begin(call, fd).node
        if not isinstance(node, Regular):
            raise OSError(errno.EINVAL, "not a file")
        return node

    def ftruncate(self, fd: int, size: int) -> None:
        self._regular("ftruncate", fd).resize(size)

    def posix_fallocate(self, fd: int, at: int, size: int) -> None:
        node = self._regular("fallocate", fd)
        node.resize(max(node.size(), at + size))

    def fsync(self, fd: int) -> None:
        self._calls.begin("fsync", fd)

    def fstat(self, fd: int) -> StatResult:
        return StatResult(self._calls.begin("fstat", fd).node)

    def dup(self, fd: int) -> int:
        process = self._calls.process("dup", fd)
        return process.descriptor(self._calls.opened(process, fd))

    def set_inheritable(self, fd: int, inheritable: bool) -> None:
        process = self._calls.process("set_inheritable", fd)
        self._calls.opened(process, fd)
        (process.inheritable.add if inheritable else process.inheritable.discard)(fd)

    def eventfd(self, value: int = 0, flags: int = 0) -> int:
        return self._calls.process("eventfd").descriptor(Open(Counter(value)))

    def pidfd_open(self, pid: int, flags: int = 0) -> int:
        process = self._calls.process("pidfd_open", pid)
        target = self._machine.living(pid)
        made = Open(Pidfd(target))
        target.watchers.append(made)
        return process.descriptor(made)


class Os(Paths, Descriptors, Processes):
    """The module. Every scheduling is granted."""

    def __init__(self, calls: Calls) -> None:
        fixed = constants(os, "O_", "EFD_", "SCHED_", "SEEK_") | {
            name: getattr(os, name) for name in (*PLAIN, *os.__all__) if name.endswith("_OK") or name in PLAIN
        }
        super().__init__("os", calls, **fixed)
        self.environ = Environ(calls.machine)
        self.path = make_path(calls)
        for name in ("getuid", "geteuid"):
            setattr(self, name, lambda: self._machine.current.process.uid if self._machine.current else 0)
        for name in ("getgid", "getegid"):
            setattr(self, name, lambda: self._machine.current.process.gid if self._machine.current else 0)
        self.getgroups = lambda: [self.getgid()]
        self.uname = lambda: SimpleNamespace(machine="x86_64", sysname="Linux", release="6.1", nodename="simulated")
        self.isatty = lambda fd: False
        self.register_at_fork = lambda **_: None


def make_path(calls: Calls) -> Module:
    """os.path: what asks no machine is Python's own."""
    plain = {name: value for name, value in vars(posixpath).items() if not name.startswith("_")}

    def looked_at(where: Any, kind: type[Node] = Node, *, follow: bool = True) -> bool:
        try:
            return isinstance(calls.node(calls.process("stat", where), where, follow=follow), kind)
        except OSError:
            return False

    def realpath(where: str) -> str:
        """With every link of the way followed."""
        done, left = "", posixpath.normpath(where).split("/")
        while left:
            done = posixpath.join(done or "/", left.pop(0))
            try:
                node = calls.machine.root if done == "/" else calls.look(done)
            except OSError:
                continue
            if isinstance(node, users.SymbolicLink):
                left = posixpath.normpath(posixpath.join(posixpath.dirname(done), node.target)).split("/") + left
                done = ""
        return done

    asking = {
        "exists": looked_at,
        "lexists": lambda where: looked_at(where, follow=False),
        "isdir": lambda where: looked_at(where, Directory),
        "isfile": lambda where: looked_at(where, Regular),
        "islink": lambda where: looked_at(where, users.SymbolicLink, follow=False),
        "abspath": posixpath.normpath,
        "realpath": realpath,
        "expanduser": lambda where: where.replace("~", "/root", 1),
    }
    return Module("posixpath", calls, **{**plain, **asking})
