"""The computer as the doctor sees it: files, accounts, devices, processes and the kernel. Tests can use another root
folder.

If something does not exist or may not be read, the result is None, empty or -1, never an error.
"""

from __future__ import annotations

import contextlib
import dataclasses
import grp
import os
import pwd
import re
import shutil
import stat
import subprocess
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TypeVar

from failstop import instances
from failstop.api import host
from failstop.api.words import printable
from failstop.files import durable, way
from failstop.files import instance as files_instance
from failstop.policy.processes import PROCESS_BY_NAME
from failstop.procs import rights
from failstop.shm import futex
from failstop.supervisor import refused, status

SHM = "/dev/shm"
PSEUDO_MAJORS = range(136, 144)
"""The major device numbers of pseudo-terminals (from the kernel's list of devices)."""
GROUP_USES = stat.S_IRGRP | stat.S_IWGRP
ACCESS_LIST = "system.posix_acl_access"
"""The extended attribute of a file with an access list (acl(5))."""
LOGINS = ("agetty", "getty", "mgetty", "login")
T = TypeVar("T")
TICKS_S = 5.0
PERIOD_S = 0.005
"""The time between two wake-ups, s. There are four for each tick of the gate."""


@dataclasses.dataclass(frozen=True)
class Node:
    """A device file."""

    path: str
    resolved: str
    """The path after following all links."""
    pseudo: bool
    """True for a pseudo-terminal, for example of the simulated board."""
    group: str
    modem_ignored: bool = False
    """True if a udev rule tells ModemManager to leave the device alone."""
    accessible: bool = False
    """True if this process may read and write the device."""
    by_group: bool = True
    """True if the members of the group may read and write the device."""


@dataclasses.dataclass(frozen=True)
class Holder:
    """A process that has a device open."""

    pid: int
    name: str
    unit: str = ""
    """The systemd service that the process belongs to. Empty if there is none."""
    instance: str = ""
    """The name of the failstop service that the process belongs to. Empty if it is no process of failstop."""
    command: str = dataclasses.field(default="", compare=False)
    """The command line of the process."""
    by_user: bool = dataclasses.field(default=False, compare=False)
    """True if `unit` belongs to the user's own service manager."""
    supervisor: int = dataclasses.field(default=0, compare=False)
    """The pid of the supervisor, if the process belongs to a failstop service. To end the service, end its supervisor,
    because the supervisor restarts its other processes."""

    def __str__(self) -> str:
        name = f"the service {self.instance!r}" if self.instance else self.name
        return f"{name} (pid {self.supervisor or self.pid}{f', {self.unit}' if self.unit else ''})"

    @property
    def is_login(self) -> bool:
        """True if the process is a login program, which asks people for a name and a password."""
        return self.name in LOGINS

    @property
    def files(self) -> set[str]:
        """The names of the files and devices in the command line, without their folders."""
        return {os.path.basename(word) for word in self.command.split()}

    def end(self) -> str:
        """The command that ends this process. For a process of failstop, it ends the whole service."""
        if self.unit:
            return f"systemctl --user stop {self.unit}" if self.by_user else f"sudo systemctl stop {self.unit}"
        return f"sudo kill {self.supervisor or self.pid}"


def _tried(look: Callable[[], T]) -> T | None:
    """The result of `look`, or None if it raises OSError."""
    try:
        return look()
    except OSError:
        return None


class System:
    """The computer whose files are below `root`."""

    early_news = staticmethod(futex.proven)
    """True if the kernel reports a death before it frees the process's memory."""
    services = staticmethod(instances.listening)
    """The names of the services that accept stop requests."""
    contained = staticmethod(status.in_container)
    """True if this process runs in a container."""

    def __init__(self, root: str = "/") -> None:
        self.root = root

    def ports(self, own: Collection[str]) -> list[tuple[str, str]]:
        """(path, description) of each serial port: first the ports whose vendor:product is in `own`, then other USB
        devices, then the rest."""
        # Import it only here, because it is slow, and the stop tool imports this module too.
        from serial.tools import list_ports

        found = []
        for port in list_ports.comports():
            usb = "" if port.vid is None or port.pid is None else f"{port.vid:04x}:{port.pid:04x}"
            whose = ": the board's" if usb in own else ""
            what = f"{port.description}, USB {usb}{whose}" if usb else str(port.description)
            found.append((usb not in own, not usb, str(port.device), what))
        return [(path, what) for _, _, path, what in sorted(found)]

    def portless(self, chips: Collection[str]) -> list[str]:
        """The vendor:product of each device in `chips` that is plugged in but has no serial port."""
        folder = self.path("/sys/bus/usb/devices")
        ports = [os.path.realpath(self.path(f"/sys/class/tty/{name}/device")) for name in self.names("/sys/class/tty")]
        found = []
        for name in self.names("/sys/bus/usb/devices"):
            usb = ":".join(self.read(f"/sys/bus/usb/devices/{name}/{half}") or "" for half in ("idVendor", "idProduct"))
            below = f"{os.path.realpath(f'{folder}/{name}')}/"
            if usb in chips and not any(port.startswith(below) for port in ports):
                found.append(usb)
        return sorted(found)

    def path(self, path: str) -> str:
        """The path below `root` for an absolute path."""
        return os.path.join(self.root, path.lstrip("/"))

    def read(self, path: str) -> str | None:
        """A file's text, without white space around it."""
        return _tried(lambda: Path(self.path(path)).read_text("utf-8", "replace").strip())

    def names(self, path: str) -> list[str]:
        """The names in a directory, sorted."""
        return _tried(lambda: sorted(os.listdir(self.path(path)))) or []

    def uid(self, path: str) -> int:
        """The uid of the path's owner. -1 if the path does not exist, or if this user can't see it."""
        return found.st_uid if (found := _tried(lambda: os.stat(self.path(path)))) else -1

    def missing(self, path: str) -> bool:
        """True if nothing exists at a path. False also if this user can't see whether something does."""
        return durable.missing(self.path(path))

    def owner(self, path: str) -> str:
        """The name of the path's owner, or the owner's number if there is no account. Empty if the path does not
        exist."""
        try:
            return pwd.getpwuid(uid).pw_name if (uid := self.uid(path)) >= 0 else ""
        except KeyError:
            return str(uid)

    def room(self, path: str) -> int | None:
        """How many bytes are free in a directory. None if it does not exist, or if this process may not write to it."""
        there = os.access(self.path(path), os.W_OK | os.X_OK)
        return _tried(lambda: shutil.disk_usage(self.path(path)).free) if there else None

    def no_room(self, path: str) -> str:
        """Why no file fits on the disk of this path. Empty if there is room."""
        return durable.no_room(self.path(path))

    def writable(self, path: str, uid: int) -> bool:
        """True if a user may put files into a directory."""
        found = _tried(lambda: os.stat(self.path(path)))
        if not found or not stat.S_ISDIR(found.st_mode):
            return False
        if uid == os.geteuid():
            return os.access(self.path(path), os.W_OK | os.X_OK)
        return self._may(found, uid, 0o3)

    def barrier(self, path: str, uid: int, bits: int = 0o4, groups: Collection[str] = ()) -> str:
        """What keeps a user from using a file: the file itself, or a folder on the way to it. Empty if nothing does, if
        the file does not exist, or if this user can't see what is there. `bits`: 4 to read, 6 to read and write.
        `groups`: groups in which the user also is."""
        with contextlib.suppress(OSError):
            for here, found, on_the_way in way.steps(path, self.root):
                needed, real = 0o1 if on_the_way else bits, self.path(here)
                if stat.S_ISLNK(found.st_mode):
                    continue
                if not (
                    os.access(real, needed) if uid == os.geteuid() else self._may(found, uid, needed, groups, real)
                ):
                    return here
        return ""

    def through(self, path: str) -> list[str]:
        """The folders and links through which a path leads, and the file at its end, as far as this user can see."""
        found = []
        with contextlib.suppress(OSError):
            for here, *_ in way.steps(path, self.root):
                found.append(here)
        return found

    def exposed(self, path: str) -> str:
        """What lets others change a file: the file itself, or a folder on the way to it. Empty if nothing does."""
        return way.exposed(path, self.root)

    @staticmethod
    def _may(found: os.stat_result, uid: int, bits: int, groups: Collection[str] = (), path: str = "") -> bool:
        """True if the mode of a file lets a user do all of `bits` (4: read, 2: write, 1: search). Also True if the file
        at `path` has an access list, because that may give the user more."""
        gids: list[int] = []
        with contextlib.suppress(KeyError):
            account = pwd.getpwuid(uid)
            gids = os.getgrouplist(account.pw_name, account.pw_gid)
        for group in groups:
            with contextlib.suppress(KeyError):
                gids.append(grp.getgrnam(group).gr_gid)
        shift = 6 if uid == found.st_uid else 3 if found.st_gid in gids else 0
        if not uid or found.st_mode >> shift & bits == bits:
            return True
        return bool(path) and _tried(lambda: os.getxattr(path, ACCESS_LIST)) is not None

    def account(self, name: str) -> int:
        """The uid of the user with this name. -1 if there is none."""
        try:
            return pwd.getpwnam(name).pw_uid
        except KeyError:
            return -1

    def environ(self, pid: str) -> dict[str, str] | None:
        """The environment with which a process was started. None if this user may not see it."""
        data = _tried(lambda: Path(self.path(f"/proc/{pid}/environ")).read_bytes())
        words = None if data is None else os.fsdecode(data).split("\0")
        return None if words is None else dict(word.split("=", 1) for word in words if "=" in word)

    def node(self, path: str) -> Node | None:
        """The device file at this path. None if it is no character device."""
        found = _tried(lambda: os.stat(path))
        if not (found and stat.S_ISCHR(found.st_mode)):
            return None
        group = str(found.st_gid)
        with contextlib.suppress(KeyError):
            group = grp.getgrgid(found.st_gid).gr_name
        # failstop's udev rule sets this property, and ModemManager reads it.
        told = self.read(f"/run/udev/data/c{os.major(found.st_rdev)}:{os.minor(found.st_rdev)}") or ""
        return Node(
            path,
            os.path.realpath(path),
            os.major(found.st_rdev) in PSEUDO_MAJORS,
            group,
            "E:ID_MM_PORT_IGNORE=1" in told.splitlines(),
            os.access(path, os.R_OK | os.W_OK),
            found.st_mode & GROUP_USES == GROUP_USES,
        )

    def hides_processes(self) -> bool:
        """True if this user can't see the processes of other users, because /proc is mounted with hidepid."""
        return self.read("/proc/1/comm") is None

    def open_files(self) -> Iterator[tuple[int, set[str] | None]]:
        """(pid, paths of open files) for each other process. The paths are None if this user may not see them.
        Processes that /proc hides from this user are left out (hides_processes())."""
        for pid in (int(name) for name in self.names("/proc") if name.isdigit()):
            try:
                found = {path for _, path in self._files_of(pid)} if pid != os.getpid() else set()
            except PermissionError:
                yield pid, None
            except OSError:
                continue
            else:
                yield pid, found

    def _files_of(self, pid: int) -> Iterator[tuple[str, str]]:
        """(link in /proc, path) of each file that a process has open. Raises OSError if this user may not see them, or
        if the process has ended."""
        folder = self.path(f"/proc/{pid}/fd")
        for name in os.listdir(folder):
            with contextlib.suppress(OSError):
                link = f"{folder}/{name}"
                yield link, os.readlink(link)

    def holder(self, pid: int) -> Holder:
        """A process as a Holder, with its name, command line, unit and service."""
        groups = re.split(r"[/\n]", self.read(f"/proc/{pid}/cgroup") or "")
        units = [part for part in groups if part.endswith(".service")]
        # user@1000.service contains everything that this user has started. Stopping it would end the whole session.
        managers = [unit for unit in units if unit.startswith("user@")]
        unit = units[-1] if units and units[-1] not in managers else ""
        words = (self.read(f"/proc/{pid}/cmdline") or "").split("\0")
        ours = any(word.endswith("/supervisor/bootstrap.py") for word in words)
        named = dict(word.split("=", 1) for word in reversed(words) if "=" in word) if ours else {}
        parent = named.get("parent", "")
        supervisor = (int(parent) if parent.isdecimal() else pid) if ours else 0
        comm = printable(self.read(f"/proc/{pid}/comm") or "?")
        return Holder(
            pid, comm, unit, named.get("name", ""), " ".join(words), by_user=bool(managers), supervisor=supervisor
        )

    def every(self) -> Iterator[Holder]:
        """All processes that this user can see."""
        return (self.holder(int(pid)) for pid in self.names("/proc") if pid.isdigit())

    def service(self, name: str) -> Holder | None:
        """The supervisor of the service with this name. None if no such service is running, or if it is another
        user's."""
        pids = (instances.holder(path) for path in files_instance.places(name))
        return next((self.holder(int(pid)) for pid in pids if pid.isdecimal()), None)

    def holders(self, path: str) -> tuple[tuple[Holder, ...], int]:
        """The processes that have a device open, and how many processes could not be checked. Processes that /proc
        hides from this user are not counted (hides_processes())."""
        opened, resolved = list(self.open_files()), os.path.realpath(path)
        found = tuple(self.holder(pid) for pid, paths in opened if paths and resolved in paths)
        return found, sum(paths is None for _, paths in opened)

    def writes(self, pid: int, path: str) -> bool:
        """True if a process has a device open for writing."""
        resolved = os.path.realpath(path)
        for link in _tried(lambda: [each for each, opened in self._files_of(pid) if opened == resolved]) or ():
            with contextlib.suppress(OSError):
                # The permissions of this link are how the file was opened.
                if os.lstat(link).st_mode & stat.S_IWUSR:
                    return True
        return False

    def said(self, *words: str, timeout_s: float = 1.0) -> str | None:
        """The output of a command. None if the command failed or took too long."""
        try:
            done = subprocess.run(words, capture_output=True, text=True, timeout=timeout_s, check=False)
        except (OSError, subprocess.TimeoutExpired):
            return None
        return done.stdout if done.returncode == 0 else None

    def booted(self) -> bool:
        """True if this computer was booted with systemd."""
        return os.path.isdir(self.path(host.BOOTED))

    def realtime(self, priority: int = 1) -> AbstractContextManager[bool]:
        """A context that gives this process real-time priority. Yields False if the kernel refuses the priority."""
        return rights.realtime(priority)

    def refused(self, pid: str, unit: str) -> str:
        """Why the kernel refused a process real-time priority although its limits or capabilities allow it, and what
        helps. Empty if neither allows it."""
        return refused.advice_if_allowed(pid, unit=unit, container=self.contained())

    def ticks(self, seconds: float = TICKS_S) -> tuple[bool, list[int]]:
        """Measure how late this process is woken. Returns (True if it had the gate's priority, the delay of each
        wake-up in ns)."""
        with self.realtime(PROCESS_BY_NAME["gate"].priority) as granted:
            return granted, late_ns(seconds)


def late_ns(seconds: float) -> list[int]:
    """How late each wake-up was, ns. Wake-ups that were missed completely are left out, as in the gate."""
    period_ns = round(PERIOD_S * 1e9)
    due_ns = time.monotonic_ns() + period_ns
    end_ns = due_ns + round(seconds * 1e9)
    late = []
    while due_ns < end_ns:
        time.sleep(max(0, due_ns - time.monotonic_ns()) / 1e9)
        now_ns = time.monotonic_ns()
        late.append(max(0, now_ns - due_ns))
        due_ns = max(due_ns, now_ns - period_ns) + period_ns
    return late
