"""Leftovers: the files that a killed predecessor's Fast DDS has left in /dev/shm, 0.6 MB each time, removed.

Nobody else's: the bridge writes down which files its own DDS has made, and what a later one finds in that list it
removes only when its writer is dead, and no living process has the file mapped. The files of ports stay: others may
know that port, and send into a file that is gone for ever (the new bridge then hears nobody, in one of ten kills). The
next process that takes the port mends and reuses them.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import time

SHM = "/dev/shm"
PATTERN = re.compile(r"fastrtps_(?!port)[0-9A-Za-z_]+")


def present(folder: str = SHM) -> set[str]:
    """The names of Fast DDS's files that are there."""
    try:
        return {name for name in os.listdir(folder) if PATTERN.fullmatch(name)}
    except OSError:
        return set()


def mapped(pid: int | str, folder: str = SHM) -> set[str]:
    """Those that a process has mapped or open."""
    found = set()
    with contextlib.suppress(OSError), open(f"/proc/{pid}/maps", encoding="utf-8", errors="replace") as file:
        found |= {line.rstrip("\n").rpartition("/")[2] for line in file if f" {folder}/" in line}
    with contextlib.suppress(OSError):
        for fd in os.listdir(f"/proc/{pid}/fd"):
            with contextlib.suppress(OSError):
                path = os.readlink(f"/proc/{pid}/fd/{fd}")
                if os.path.dirname(path) == folder:
                    found.add(os.path.basename(path))
    return {name for name in found if PATTERN.fullmatch(name)}


def born(pid: int) -> str:
    """When a process was started, as the kernel counts; with its number, that is one process for ever. Empty: none."""
    try:
        with open(f"/proc/{pid}/stat", encoding="utf-8", errors="replace") as file:
            return file.read().rpartition(")")[2].split()[19]
    except (OSError, IndexError):
        return ""


def age_s() -> float:
    """How long ago this process was started."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) - int(born(os.getpid()) or 0) / os.sysconf("SC_CLK_TCK")


def note_path(name: str, folder: str = SHM) -> str:
    """Where the bridge of a service keeps its list."""
    return os.path.join(folder, f"failstop.{name}.ros2.{os.getuid()}")


def remember(path: str, files: set[str]) -> None:
    """Write down what is this process's. Raises OSError."""
    text = json.dumps({"pid": os.getpid(), "born": born(os.getpid()), "files": sorted(files)})
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC
    with open(os.open(path, flags, 0o600), "w", encoding="utf-8") as file:
        file.write(text)


def forget(path: str) -> None:
    """This process ends in order: DDS takes its files away itself."""
    with contextlib.suppress(OSError):
        os.unlink(path)


def clear(path: str, folder: str = SHM) -> tuple[list[str], set[str]]:
    """Remove what a dead predecessor left; returns the names, and those that others have mapped still: DDS keeps a dead
    one's memory for up to 20 s. Whoever comes next is to remove them."""
    pid, since, files = _read(path)
    if not files or born(pid) == since:
        return [], set()
    return remove(files, folder)


def remove(files: set[str], folder: str = SHM) -> tuple[list[str], set[str]]:
    """Remove those of these files that nobody has mapped; returns the names, and the rest."""
    used = set().union(*(mapped(pid, folder) for pid in os.listdir("/proc") if pid.isdigit()))
    removed = []
    for name in files & present(folder) - used:
        file = os.path.join(folder, name)
        with contextlib.suppress(OSError):
            if os.lstat(file).st_uid == os.getuid():
                os.unlink(file)
                removed.append(name)
    return sorted(removed), files & used


def _read(path: str) -> tuple[int, str, set[str]]:
    try:
        fd = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
        with open(fd, encoding="utf-8") as file:
            if os.fstat(fd).st_uid != os.getuid():
                return 0, "", set()
            found = json.load(file)
        names = found["files"]
        if isinstance(found["pid"], int) and isinstance(found["born"], str) and isinstance(names, list):
            return found["pid"], found["born"], {name for name in names if isinstance(name, str)}
    except (OSError, ValueError, KeyError, TypeError):
        pass
    return 0, "", set()
