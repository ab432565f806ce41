"""The files of the system that facts are read from, under a root of one's choice."""

from __future__ import annotations

import os
from collections.abc import Iterator


class System:
    """Reads below `root`; what is not there or not allowed is None or empty, never an error."""

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

    def pids(self) -> Iterator[int]:
        """Every process."""
        return (int(name) for name in self.names("/proc") if name.isdigit())

    def comm(self, pid: int) -> str:
        """A process's name."""
        return self.read(f"/proc/{pid}/comm") or "?"

    def unit(self, pid: int) -> str:
        """The systemd service that a process belongs to; empty when there is none."""
        for line in (self.read(f"/proc/{pid}/cgroup") or "").splitlines():
            for part in reversed(line.rpartition(":")[2].split("/")):
                if part.endswith(".service"):
                    return part
        return ""


def user_name(uid: int) -> str:
    """The account's name, or its number."""
    import pwd

    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return str(uid)
