"""Openers: finds the programs that have the pseudo-terminal open, by inotify, and by /proc as far as it shows them.

The kernel merges equal events that follow each other, so two programs that close the terminal at the same moment would
count as one. Therefore the terminal's directory is watched too: each open and each close then makes two events of two
different watches, and two equal events never follow each other.

inotify reports openings: each open() makes one, and its close is reported when its last descriptor is closed. A child
that inherits a descriptor, and dup(), make no new opening, so several descriptors and processes may share one. The
owner of an opening is the process that made it, as far as that can be seen: of the processes that share it, the one
that was first seen with it, else the oldest, because a parent is older than its children. Owners are the drivers.
Children that share an opening may come and go. A child keeps the port open when the owner dies, so each owner is also
watched by a pidfd.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import struct
from collections import Counter

from failstop.data import Data
from failstop.guard.news import Opener

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterator, Sequence

IN_CLOSE_WRITE, IN_CLOSE_NOWRITE, IN_OPEN = 0x8, 0x10, 0x20
_EXITING = 0x4
"""PF_EXITING, one of the flags in /proc/PID/stat."""
_KILLED = 1 << 9 - 1
"""SIGKILL, among the signals in /proc/PID/stat that are pending for the main thread."""
_MACHINE = 0xEFFFFFFC
"""The machine's first pid namespace, in which every process has a number (PROC_PID_INIT_INO of Linux)."""
_EVENT = struct.Struct("iIII")
_KCMP = {"x86_64": 312, "aarch64": 272}.get(os.uname().machine, -1)
_KCMP_FILE = 0
_libc = ctypes.CDLL(None, use_errno=True)
INTERPRETERS = ("python", "perl", "ruby", "node", "bash", "sh", "dash")


class Watch:
    """Watches the opens and closes of one path."""

    def __init__(self, path: str) -> None:
        """Raises OSError."""
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
        """The events since the last call, in order: True for an open, False for a close."""
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

    def close(self) -> None:
        os.close(self.fd)


class Held(Data):
    """A descriptor with which a process has the terminal open."""

    pid: int
    fd: int
    began: int
    """When the process started, in the kernel's ticks."""


def openers(
    path: str, before: Container[int], opened: int, meanwhile: Callable[[], None]
) -> tuple[dict[int, Opener], bool]:
    """The programs other than this one that have opened the terminal and still have it open; and True if there may be
    others that /proc does not show. `before`, `opened`: as in owners(). If many programs run, this takes longer than a
    driver waits, so `meanwhile` is called after each of them."""
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
    """The descriptors with which a process has the terminal open. `wanted`: the terminal's identity(). Raises
    PermissionError."""
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
    """The owners of the openings to which these descriptors belong, by pid, with the number of openings of each.
    `before`: the owners at the last look. `same`: whether two descriptors share an opening; None: that can't be known,
    and then at most `opened` openings are believed."""
    first: list[Held] = []
    for each in sorted(held, key=lambda each: (each.pid not in before, each.began, each.pid)):
        answers = [same(each, other) for other in first]
        if True not in answers and not (None in answers and len(first) >= opened):
            first.append(each)
    return dict(Counter(each.pid for each in first))


def same_opening(one: Held, other: Held) -> bool | None:
    """True if two descriptors come from the same open(); None if the kernel does not tell."""
    found: int = _libc.syscall(_KCMP, one.pid, other.pid, _KCMP_FILE, ctypes.c_ulong(one.fd), ctypes.c_ulong(other.fd))
    return None if found < 0 else found == 0


def _began(pid: int) -> int:
    """When a process started, in the kernel's ticks. Raises OSError."""
    return int(_fields(_read(f"/proc/{pid}/stat"))[19])


def _all_listed(pids: list[int]) -> bool:
    """True if /proc lists every process. In a container, or with the mount option hidepid, it does not."""
    try:
        return os.stat("/proc/self/ns/pid").st_ino == _MACHINE and 1 in pids
    except OSError:
        return False


def _may_be(pid: int, name: str, inode: int) -> bool:
    """True if this descriptor of a process may be open on a terminal with this inode number. The file itself is not
    touched, because it may be on a server that does not answer. Raises OSError."""
    path = os.readlink(f"/proc/{pid}/fd/{name}")
    if path.startswith("/dev/") or not path.startswith("/"):
        return path.startswith("/dev/")
    # In a container or a unit of its own it may be mounted anywhere. Linux shows the inode since 5.14.
    with open(f"/proc/{pid}/fdinfo/{name}", "rb") as file:
        return b"\nino:\t%d\n" % inode in file.read(4096)


def identity(path: str) -> tuple[int, int, int]:
    """Numbers that identify a terminal among all files. Raises OSError."""
    found = os.stat(path)
    return found.st_dev, found.st_ino, found.st_rdev


def dying(pid: int) -> bool:
    """True if a process is on its way out. A pending kill counts, because on a busy machine the process may take tens
    of milliseconds to run again and to begin to end. After that the kernel frees its memory, which takes long for a
    large process, and then closes its files. If the main thread of several has ended long before the memory is freed,
    or while the others go on, the other threads decide."""
    try:
        stat = _read(f"/proc/{pid}/stat")
        return all(map(is_ending, _others(pid))) if _fields(stat)[0] == b"Z" else is_ending(stat)
    except OSError:
        return True


def _others(pid: int) -> Iterator[bytes]:
    """The stat in /proc of each thread except for the main one. Raises OSError."""
    for thread in os.listdir(f"/proc/{pid}/task"):
        if int(thread) != pid:
            with contextlib.suppress(OSError):
                yield _read(f"/proc/{pid}/task/{thread}/stat")


def is_ending(stat: bytes) -> bool:
    """True if a thread is on its way out, according to its stat in /proc. A signal that ends a process without a core
    dump becomes a SIGKILL of each thread as soon as it is sent, and a SIGKILL is never withdrawn."""
    numbers = _fields(stat)
    return bool(int(numbers[6]) & _EXITING or int(numbers[28]) & _KILLED)


def _fields(stat: bytes) -> list[bytes]:
    """The fields of a stat in /proc, beginning with the state."""
    return stat.rpartition(b") ")[2].split()


def _read(path: str) -> bytes:
    with open(path, "rb") as file:
        return file.read()


def program(pid: int) -> str:
    """The name of a process for people. For a script it is the name of its file."""
    try:
        with open(f"/proc/{pid}/cmdline", "rb") as file:
            words = os.fsdecode(file.read(4096)).split("\0")
        with open(f"/proc/{pid}/comm", encoding="utf-8", errors="replace") as file:
            comm = file.read().strip()
    except OSError:
        return "a program"
    first = os.path.basename(words[0])
    if first.startswith(INTERPRETERS):
        script = next((word for word in words[1:] if word and not word.startswith("-")), "")
        if "-c" not in words[1:2] and script:
            return os.path.basename(script)
    return first or comm or "a program"
