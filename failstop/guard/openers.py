"""Openers: the programs that have the pseudo-terminal open, by inotify and, where it shows them, by /proc.

The kernel merges events that are alike and follow each other, so that two programs which close it in one moment would
count as one. Its directory is therefore watched too: each open and close is then two events of two watches, and no two
that follow each other are alike.

What inotify reports are openings: each open() is one, and its close comes when the last descriptor of it is closed. A
child that inherits a descriptor, and dup(), make no further opening, so several descriptors and processes share one.
The process that opened it owns it, as far as can be seen: of those that share it, the one that was seen with it first,
else the oldest, because a parent is older than its children. Owners are the drivers. A child that shares the opening
may come and go; it keeps the port open when the owner dies, so each owner is watched by a pidfd too.
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
"""PF_EXITING, of the flags in /proc/PID/stat."""
_KILLED = 1 << 9 - 1
"""SIGKILL, of the signals in /proc/PID/stat that wait for the main thread."""
_MACHINE = 0xEFFFFFFC
"""The machine's own pid namespace, in which every process has a number (PROC_PID_INIT_INO of Linux)."""
_EVENT = struct.Struct("iIII")
_KCMP = {"x86_64": 312, "aarch64": 272}.get(os.uname().machine, -1)
_KCMP_FILE = 0
_libc = ctypes.CDLL(None, use_errno=True)
INTERPRETERS = ("python", "perl", "ruby", "node", "bash", "sh", "dash")


class Watch:
    """Opens and closes of one path."""

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
        """Since the last call, in order: True, somebody opened it; False, somebody closed it."""
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
    """A descriptor that a process has open on the terminal."""

    pid: int
    fd: int
    began: int
    """When the process began, in the kernel's ticks."""


def openers(
    path: str, before: Container[int], opened: int, meanwhile: Callable[[], None]
) -> tuple[dict[int, Opener], bool]:
    """The programs that have opened this terminal and still have it open, but for this process; and whether there may
    be others that /proc does not show. `before`, `opened`: as of owners(). Where many programs run it takes longer than
    a driver waits, so `meanwhile` is called after each of them."""
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
    """The descriptors that a process has open on the terminal with this identity(). Raises PermissionError."""
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
    """The owners of these descriptors' openings, by pid, with how many each owns. `before`: those that were owners when
    it was looked last. `same`: whether two descriptors share an opening; None: nobody can say, and then no more than
    `opened` openings are believed."""
    first: list[Held] = []
    for each in sorted(held, key=lambda each: (each.pid not in before, each.began, each.pid)):
        answers = [same(each, other) for other in first]
        if True not in answers and not (None in answers and len(first) >= opened):
            first.append(each)
    return dict(Counter(each.pid for each in first))


def same_opening(one: Held, other: Held) -> bool | None:
    """Whether two descriptors come from the same open(); None: the kernel does not say."""
    found: int = _libc.syscall(_KCMP, one.pid, other.pid, _KCMP_FILE, ctypes.c_ulong(one.fd), ctypes.c_ulong(other.fd))
    return None if found < 0 else found == 0


def _began(pid: int) -> int:
    """Raises OSError."""
    return int(_fields(_read(f"/proc/{pid}/stat"))[19])


def _all_listed(pids: list[int]) -> bool:
    """Whether /proc lists every process. In a container, or with the mount option hidepid, it leaves others out."""
    try:
        return os.stat("/proc/self/ns/pid").st_ino == _MACHINE and 1 in pids
    except OSError:
        return False


def _may_be(pid: int, name: str, inode: int) -> bool:
    """Whether a process's descriptor of that name may be open on a terminal with this inode number. What it is open on
    is not touched, because the server of a file may be away. Raises OSError."""
    path = os.readlink(f"/proc/{pid}/fd/{name}")
    if path.startswith("/dev/") or not path.startswith("/"):
        return path.startswith("/dev/")
    # In a container or a unit of its own it may be mounted anywhere. Linux shows the inode since 5.14.
    with open(f"/proc/{pid}/fdinfo/{name}", "rb") as file:
        return b"\nino:\t%d\n" % inode in file.read(4096)


def identity(path: str) -> tuple[int, int, int]:
    """What tells a terminal from every other file. Raises OSError."""
    found = os.stat(path)
    return found.st_dev, found.st_ino, found.st_rdev


def dying(pid: int) -> bool:
    """Whether a process is on its way out. A kill that waits for it is seen first, because a busy machine may let tens
    of milliseconds pass before the process runs again and begins to end. Then the kernel takes its memory down, which
    lasts long for a large one, and closes its files afterwards. Of a process with several threads the main one may end
    long before the memory is gone, or while the others go on: then the others tell."""
    try:
        stat = _read(f"/proc/{pid}/stat")
        return all(map(is_ending, _others(pid))) if _fields(stat)[0] == b"Z" else is_ending(stat)
    except OSError:
        return True


def _others(pid: int) -> Iterator[bytes]:
    """What /proc says of each thread but the main one. Raises OSError."""
    for thread in os.listdir(f"/proc/{pid}/task"):
        if int(thread) != pid:
            with contextlib.suppress(OSError):
                yield _read(f"/proc/{pid}/task/{thread}/stat")


def is_ending(stat: bytes) -> bool:
    """Whether a thread is on its way out, of what its stat in /proc says. A signal that ends a process without a core
    dump becomes a SIGKILL of each of its threads when it is sent, and no SIGKILL is ever taken back."""
    numbers = _fields(stat)
    return bool(int(numbers[6]) & _EXITING or int(numbers[28]) & _KILLED)


def _fields(stat: bytes) -> list[bytes]:
    """From the state on."""
    return stat.rpartition(b") ")[2].split()


def _read(path: str) -> bytes:
    with open(path, "rb") as file:
        return file.read()


def program(pid: int) -> str:
    """The name of a process for people: of a script its file's."""
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
