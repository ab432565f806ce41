"""Openers: finds out which programs have the pseudo-terminal open, with inotify and /proc. In a container, for example,
/proc does not show every process.

The kernel merges equal inotify events that directly follow each other. So if two programs closed the terminal at the
same moment, the two closes would look like one. To prevent this, the terminal's directory is watched too. Each open and
each close then makes two events from two different watches, and two equal events never follow each other.

inotify reports openings. An opening begins with an open(), and it ends when its last descriptor is closed. A dup()
makes no new opening, and neither does a child that inherits a descriptor. So several descriptors, and even several
processes, may share one opening.

The owner of an opening is the process that called open(). Linux does not record the owner, so the guard must guess it
if several processes share an opening. An owner at the previous search stays the owner. Otherwise the oldest process is
the owner, because a parent is older than its children.

Only owners count as drivers. Their children may come and go. If an owner dies, a child may keep the opening, and then
inotify reports no close. So a pidfd also watches each owner.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import select
import struct
from collections import Counter
from itertools import takewhile

from failstop.data import Data
from failstop.guard.news import Opener
from failstop.messages.records import printable

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterator, Sequence

IN_CLOSE_WRITE, IN_CLOSE_NOWRITE, IN_OPEN = 0x8, 0x10, 0x20
_EXITING = 0x4
"""PF_EXITING, one of the flags in /proc/PID/stat."""
_KILLED = 1 << 9 - 1
"""The bit for SIGKILL in the field of /proc/PID/stat that shows the pending signals of the main thread."""
_MACHINE = 0xEFFFFFFC
"""The inode of the machine's first pid namespace (PROC_PID_INIT_INO in Linux). Every process of the machine has a pid
in this namespace."""
_EVENT = struct.Struct("iIII")
_KCMP = {"x86_64": 312, "aarch64": 272}.get(os.uname().machine, -1)
_KCMP_FILE = 0
_libc = ctypes.CDLL(None, use_errno=True)
_INTERPRETER = re.compile(r"(?:python|bash|sh|dash|(perl|ruby|node))[\d.]*")
_CODE = re.compile(r"-[A-Za-z]*c")
"""An option of Python or of a shell whose value is the program itself, for example -c or -lc."""
_EXPRESSION = re.compile(r"-[A-Za-z]*e")
"""The same for Perl, Ruby and Node."""


class Watch:
    """Reports when a path is opened or closed."""

    def __init__(self, path: str) -> None:
        """`path`: the file to watch. Raises OSError."""
        self.fd = _libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        if self.fd < 0:
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()), "inotify")
        wanted = IN_OPEN | IN_CLOSE_WRITE | IN_CLOSE_NOWRITE
        self._path = _libc.inotify_add_watch(self.fd, os.fsencode(path), wanted)
        if self._path < 0 or _libc.inotify_add_watch(self.fd, os.fsencode(os.path.dirname(path)), wanted) < 0:
            error = ctypes.get_errno()
            os.close(self.fd)
            raise OSError(error, os.strerror(error), path)

    def events(self) -> list[bool]:
        """The opens (True) and closes (False) of the path since the previous call, oldest first."""
        found: list[bool] = []
        with contextlib.suppress(BlockingIOError):
            while data := os.read(self.fd, 65536):
                at = 0
                while at < len(data):
                    watch, mask, _, length = _EVENT.unpack_from(data, at)
                    at += _EVENT.size + length
                    if watch == self._path and mask & (IN_OPEN | IN_CLOSE_WRITE | IN_CLOSE_NOWRITE):
                        found.append(bool(mask & IN_OPEN))
        return found

    def stirs(self) -> bool:
        """True if something has happened since the last call of events(). It may have happened to another file of the
        path's directory."""
        return bool(select.select((self.fd,), (), (), 0)[0])

    def close(self) -> None:
        os.close(self.fd)


class Held(Data):
    """One descriptor of the terminal, in one process."""

    pid: int
    fd: int
    began: int
    """When the process started, in the kernel's ticks."""


def openers(
    path: str, before: Container[int], opened: int, meanwhile: Callable[[], None]
) -> tuple[dict[int, Opener], bool]:
    """Find the programs that have opened the terminal and still have it open, except the guard itself. Returns (the
    programs by pid, True if /proc may hide more of them).

    `before` and `opened`: see owners(). `meanwhile`: called for each process, because a driver can't wait for an answer
    until the search ends.
    """
    wanted = identity(path)
    held: list[Held] = []
    pids = [int(name) for name in os.listdir("/proc") if name.isdigit()]
    hidden = not _all_listed(pids)
    for pid in pids:
        if pid == os.getpid():
            continue
        meanwhile()
        try:
            fds = holds(pid, wanted)
        except PermissionError:
            hidden = True
            continue
        with contextlib.suppress(OSError):
            held += [Held(pid, fd, _began(pid)) for fd in fds]
    found = owners(held, before, opened, same_opening)
    return {pid: Opener(pid, program(pid), times) for pid, times in found.items()}, hidden


def holds(pid: int, wanted: tuple[int, int, int]) -> list[int]:
    """The process's descriptors of the terminal. `wanted`: the terminal's identity(). Raises PermissionError if this
    user may not see the descriptors."""
    found = []
    try:
        names = os.listdir(f"/proc/{pid}/fd")
    except PermissionError:
        raise
    except OSError:
        return []
    for name in names:
        with contextlib.suppress(OSError):
            if _may_be(pid, name, wanted[1]) and identity(f"/proc/{pid}/fd/{name}") == wanted:
                found.append(int(name))
    return found


def owners(
    held: Sequence[Held], before: Container[int], opened: int, same: Callable[[Held, Held], bool | None]
) -> dict[int, int]:
    """Find the owner of each opening. Returns {pid: number of openings}.

    `held`: all descriptors of the terminal. `before`: the owners at the previous search. `opened`: how many openings
    inotify has counted. `same`: returns True if two descriptors share an opening, False if they don't, and None if the
    kernel does not say. After None, a descriptor counts as a new opening only until `opened` openings are found.
    """
    first: list[Held] = []
    for each in sorted(held, key=lambda each: (each.pid not in before, each.began, each.pid)):
        answers = [same(each, other) for other in first]
        if True not in answers and not (None in answers and len(first) >= opened):
            first.append(each)
    return dict(Counter(each.pid for each in first))


def same_opening(one: Held, other: Held) -> bool | None:
    """True if the two descriptors come from the same open(), False if they don't. None if the kernel does not say."""
    found: int = _libc.syscall(_KCMP, one.pid, other.pid, _KCMP_FILE, ctypes.c_ulong(one.fd), ctypes.c_ulong(other.fd))
    return None if found < 0 else found == 0


def _began(pid: int) -> int:
    """When the process started, in the kernel's ticks. Raises OSError."""
    return int(_fields(_read(f"/proc/{pid}/stat"))[19])


def _all_listed(pids: list[int]) -> bool:
    """True if /proc lists every process of the machine. In a container, or with the mount option hidepid, /proc lists
    only some of them."""
    try:
        return os.stat("/proc/self/ns/pid").st_ino == _MACHINE and 1 in pids
    except OSError:
        return False


def _may_be(pid: int, name: str, inode: int) -> bool:
    """True if a process's descriptor `name` may be open on a terminal with this inode number. This does not touch the
    open file, because a file on a server that does not answer would block the guard. Raises OSError."""
    path = os.readlink(f"/proc/{pid}/fd/{name}")
    if path.startswith("/dev/") or not path.startswith("/"):
        return path.startswith("/dev/")
    # In a container or a unit with its own mounts, the terminal may have any path. Linux shows the inode since 5.14.
    with open(f"/proc/{pid}/fdinfo/{name}", "rb") as file:
        return b"\nino:\t%d\n" % inode in file.read(4096)


def identity(path: str) -> tuple[int, int, int]:
    """Numbers that identify a terminal among all files: device, inode and device type. Raises OSError."""
    found = os.stat(path)
    return found.st_dev, found.st_ino, found.st_rdev


def dying(pid: int) -> bool:
    """True if a process is ending, or is gone. A pending SIGKILL counts as ending. On a busy machine, tens of
    milliseconds may pass before the process begins to end. Then the kernel frees its memory, which takes long for a
    large process, and only then closes its files.

    After the main thread has ended, the process counts as ending only if all its other threads are ending.
    """
    try:
        stat = _read(f"/proc/{pid}/stat")
        return all(map(is_ending, _others(pid))) if _fields(stat)[0] == b"Z" else is_ending(stat)
    except OSError:
        return True


def _others(pid: int) -> Iterator[bytes]:
    """Yield /proc/PID/task/TID/stat for each thread of a process except its main thread. Raises OSError."""
    for thread in os.listdir(f"/proc/{pid}/task"):
        if int(thread) != pid:
            with contextlib.suppress(OSError):
                yield _read(f"/proc/{pid}/task/{thread}/stat")


def is_ending(stat: bytes) -> bool:
    """True if a thread is ending. `stat`: the content of the thread's stat file in /proc. A fatal signal without a core
    dump becomes a SIGKILL of each thread at once, and Linux never withdraws it."""
    numbers = _fields(stat)
    return bool(int(numbers[6]) & _EXITING or int(numbers[28]) & _KILLED)


def _fields(stat: bytes) -> list[bytes]:
    """The fields of a stat file in /proc, without the pid and the name."""
    return stat.rpartition(b") ")[2].split()


def _read(path: str) -> bytes:
    with open(path, "rb") as file:
        return file.read()


def program(pid: int) -> str:
    """The name of a process's program, for people. For a script, it is the name of the script's file."""
    try:
        with open(f"/proc/{pid}/cmdline", "rb") as file:
            command = file.read(4096)
        return name_of(command, _read(f"/proc/{pid}/comm"))
    except OSError:
        return "a program"


def name_of(command: bytes, comm: bytes) -> str:
    """The name of a program, in characters that can be shown and encoded. `command` and `comm`: what /proc/PID/cmdline
    and /proc/PID/comm hold. Any bytes may be in them."""
    words = [printable(word) for word in command.decode("utf-8", "replace").split("\0")]
    first = os.path.basename(words[0])
    if interpreter := _INTERPRETER.fullmatch(first):
        code = _EXPRESSION if interpreter[1] else _CODE
        options = list(takewhile(lambda word: word.startswith("-"), words[1:]))
        script = next((word for word in words[1 + len(options) :] if word), "")
        if script and not any(map(code.fullmatch, options)):
            return os.path.basename(script)
    return first or printable(comm.decode("utf-8", "replace").strip()) or "a program"
