"""The machine that doctor looks at: its files under a root of one's choice, processes, accounts, commands, and kernel.

What is not there or not allowed is None or empty, never an error. A test has one of its own.
"""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import os
import resource
import struct
import subprocess
import time
from collections.abc import Iterator

from failstop.shm import futex
from failstop.supervisor import grant

SHM = "/dev/shm"
READINGS = 20_000
STA_UNSYNC, STA_NANO = 0x0040, 0x2000
_TIMEX = struct.Struct("=i4xqqqqi")
"""The first fields of struct timex on 64-bit Linux (adjtimex(2)): modes, offset, freq, maxerror, esterror, status."""
_TIMEX_BYTES = 512


@dataclasses.dataclass(frozen=True)
class User:
    """An account, or a number without one."""

    name: str
    uid: int
    gids: frozenset[int] = frozenset()


class System:
    """Reads below `root`."""

    in_container = staticmethod(grant.in_container)
    early_news = staticmethod(futex.proven)
    """The kernel tells of a death before it takes the memory down."""

    def __init__(self, root: str = "/") -> None:
        self.root = root

    def path(self, path: str) -> str:
        """Where an absolute path of the system is."""
        return os.path.join(self.root, path.lstrip("/"))

    def read(self, path: str) -> str | None:
        """A file's text without the white space around it."""
        try:
            with open(self.path(path), encoding="utf-8", errors="replace") as file:
                return file.read().strip()
        except OSError:
            return None

    def number(self, path: str) -> int | None:
        """A file that holds one whole number."""
        try:
            return int(self.read(path) or "")
        except ValueError:
            return None

    def names(self, path: str) -> list[str]:
        """What is in a directory, sorted."""
        try:
            return sorted(os.listdir(self.path(path)))
        except OSError:
            return []

    def owner(self, path: str) -> str:
        """The name of whom a path belongs to; empty when it is not there."""
        try:
            return user(os.stat(self.path(path)).st_uid).name
        except OSError:
            return ""

    def free(self, path: str) -> int | None:
        """How many bytes the file system of a path has free."""
        try:
            found = os.statvfs(self.path(path))
        except OSError:
            return None
        return found.f_bavail * found.f_frsize

    def writable(self, path: str) -> bool:
        """This process may put files into a directory."""
        return os.access(self.path(path), os.W_OK | os.X_OK)

    def pids(self) -> Iterator[int]:
        """Every process."""
        return (int(name) for name in self.names("/proc") if name.isdigit())

    def comm(self, pid: int) -> str:
        """A process's name."""
        return self.read(f"/proc/{pid}/comm") or "?"

    def unit(self, pid: int) -> str:
        """The systemd service that a process belongs to; empty when there is none."""
        groups = (self.read(f"/proc/{pid}/cgroup") or "").splitlines()
        parts = [part for line in groups for part in reversed(line.rpartition(":")[2].split("/"))]
        return next((part for part in parts if part.endswith(".service")), "")

    def open_files(self) -> Iterator[tuple[int, set[str] | None]]:
        """The paths of what each other process has open; None where that is hidden from this user."""
        for pid in self.pids():
            folder = self.path(f"/proc/{pid}/fd")
            try:
                names = [] if pid == os.getpid() else os.listdir(folder)
            except PermissionError:
                yield pid, None
                continue
            except OSError:
                continue
            yield pid, {_target(os.path.join(folder, name)) for name in names}

    def said(self, *words: str, timeout_s: float = 1.0) -> str | None:
        """What a command printed; None when it failed or did not answer."""
        try:
            done = subprocess.run(words, capture_output=True, text=True, timeout=timeout_s, check=False)
        except (OSError, subprocess.TimeoutExpired):
            return None
        return done.stdout if done.returncode == 0 else None

    def limit(self, which: int) -> int:
        """A limit of this process (resource.RLIMIT_...); -1: there is none."""
        return resource.getrlimit(which)[0]

    def capable(self, capability: int) -> bool:
        """This process has a capability."""
        for line in (self.read("/proc/self/status") or "").splitlines():
            if line.startswith("CapEff:"):
                return bool(int(line.split()[1], 16) >> capability & 1)
        return False

    def realtime(self) -> bool:
        """The kernel gives this process real-time priority when it asks: whatever limits and capabilities say, a
        container or a control group may refuse."""
        policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        except OSError:
            return False
        os.sched_setscheduler(0, policy, parameters)
        return True

    def backward_ns(self) -> int:
        """The furthest that CLOCK_MONOTONIC went back between two readings; 0: never."""
        last, back = time.monotonic_ns(), 0
        for _ in range(READINGS):
            now = time.monotonic_ns()
            back = max(back, last - now)
            last = now
        return back

    def resolution_ns(self) -> int:
        """Of CLOCK_MONOTONIC."""
        return round(time.clock_getres(time.CLOCK_MONOTONIC) * 1e9)

    def wall_clock(self) -> tuple[bool, float] | None:
        """Whether the kernel holds the wall clock for synchronized, and what it still has to correct, s."""
        buffer = ctypes.create_string_buffer(_TIMEX_BYTES)
        with contextlib.suppress(AttributeError, OSError):
            if ctypes.CDLL(None).adjtimex(buffer) >= 0:
                _, offset, _, _, _, status = _TIMEX.unpack_from(buffer.raw)
                return not status & STA_UNSYNC, offset / (1e9 if status & STA_NANO else 1e6)
        return None


def _target(link: str) -> str:
    try:
        return os.readlink(link)
    except OSError:
        return ""


def user(uid: int) -> User:
    """Somebody by number, with all groups."""
    import grp
    import pwd

    try:
        found = pwd.getpwuid(uid)
    except KeyError:
        return User(str(uid), uid)
    gids = {found.pw_gid, *(group.gr_gid for group in grp.getgrall() if found.pw_name in group.gr_mem)}
    if uid == os.geteuid():
        gids |= {os.getegid(), *os.getgroups()}
    return User(found.pw_name, uid, frozenset(gids))


def account(name: str) -> User | None:
    """Somebody by name; None when there is no such account."""
    import pwd

    try:
        return user(pwd.getpwnam(name).pw_uid)
    except KeyError:
        return None
