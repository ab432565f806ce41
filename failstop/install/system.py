"""A system to install into: what it has of failstop already, and its programs, if it runs.

Paths are those of the installed system, absolute, whatever directory its root is in now.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import subprocess
import time
from collections.abc import Sequence
from functools import cached_property
from typing import Any

from failstop import discovery
from failstop.install import InstallError

PREFIX = "/opt/failstop"
MANIFEST_NAME = "install.json"
MANIFEST = f"{PREFIX}/{MANIFEST_NAME}"
STATE = "/var/lib/failstop"
RUNTIME = "/run/failstop"
PACKAGE_UNIT = "/usr/lib/systemd/system/failstop.service"
"""There when the Debian package is installed."""
UDEV_CONTROL = "/run/udev/control"
PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
RUN_S = 60.0
READY_S = 20.0
POLL_S = 0.05

Content = bytes | str | None
"""What is at a path: a file's bytes, a link's target, or neither of the two."""


@dataclasses.dataclass(frozen=True)
class Manifest:
    """The list of what is installed; the same content always has the same bytes."""

    version: str = ""
    command: str = ""
    """The command that the units call."""
    files: dict[str, str] = dataclasses.field(default_factory=dict)
    """SHA-256 by path. Configuration is not among them: it is the user's."""
    links: dict[str, str] = dataclasses.field(default_factory=dict)
    directories: tuple[str, ...] = ()
    """Made by an installation, the outermost first."""

    def dump(self) -> bytes:
        """As JSON."""
        return (json.dumps(dataclasses.asdict(self), indent=2, sort_keys=True) + "\n").encode()

    @classmethod
    def load(cls, data: bytes) -> Manifest:
        """The inverse. Raises InstallError."""
        try:
            found: dict[str, Any] = json.loads(data)
            names = [field.name for field in dataclasses.fields(cls)]
            return cls(**{name: found[name] for name in names} | {"directories": tuple(found["directories"])})
        except (ValueError, TypeError, KeyError) as error:
            raise InstallError(
                f"{MANIFEST} is damaged ({error}): remove it, and `failstop install` writes it again"
            ) from None


class System:
    """One that is looked at when it is asked, and changed by do.py alone."""

    def __init__(self, root: str | None = None, ready_s: float = READY_S) -> None:
        """`root`: where the root directory of a system is that does not run; None: this machine. `ready_s`: how long
        a unit has to become ready."""
        self.root = os.path.abspath(root or "/")
        self.live = root is None
        self._ready_s = ready_s

    def at(self, path: str) -> str:
        """Where a path of the system is now."""
        return os.path.join(self.root, path.lstrip("/"))

    def content(self, path: str) -> Content:
        """What is there. Raises OSError."""
        return content(self.at(path))

    def holds(self, path: str) -> bool:
        """A directory is there that holds something."""
        return os.path.isdir(self.at(path)) and bool(os.listdir(self.at(path)))

    def accounts(self, kind: str) -> dict[str, list[str]]:
        """The fields of each line of /etc/passwd or group, by the name in the first."""
        data = self.content(f"/etc/{kind}")
        lines = data.decode(errors="replace").splitlines() if isinstance(data, bytes) else []
        return {line.partition(":")[0]: line.split(":") for line in lines if line.count(":") >= 3}

    def members(self, group: str) -> list[str]:
        """The users that a group lists."""
        return self.accounts("group").get(group, [""])[-1].split(",")

    @property
    def root_option(self) -> tuple[str, ...]:
        """What systemd's programs are told of the root."""
        return () if self.live else (f"--root={self.root}",)

    @cached_property
    def manifest(self) -> Manifest | None:
        """What an installation has put there; None: there is none. Raises InstallError when its list is damaged."""
        data = self.content(MANIFEST)
        return Manifest.load(data) if isinstance(data, bytes) else None

    @property
    def package(self) -> bool:
        """The Debian package is installed."""
        return os.path.exists(self.at(PACKAGE_UNIT))

    @cached_property
    def udev(self) -> bool:
        """udev runs, and can be told to read its rules again."""
        return self.live and os.path.exists(UDEV_CONTROL)

    @cached_property
    def board(self) -> bool:
        """A board is plugged in that the rule gives a name."""
        return self.live and discovery.board_there()

    def active(self, patterns: Sequence[str]) -> tuple[str, ...]:
        """The units of these that run, or are about to."""
        if not self.live:
            return ()
        states = "--state=active,activating,reloading"
        lines = _said("systemctl", "list-units", states, "--plain", "--no-legend", *patterns).splitlines()
        return tuple(line.split()[0] for line in lines)

    def run(self, words: Sequence[str], accepted: Sequence[int] = (0,)) -> None:
        """Run a program to its end. Raises InstallError with what it said."""
        result = _call(words)
        if result.returncode not in accepted:
            said = " ".join((result.stderr or result.stdout).split()) or f"exit code {result.returncode}"
            raise InstallError(f"{' '.join(words)}: {said}")

    def start(self, unit: str) -> None:
        """Start a unit and wait until it says that it is ready. Raises InstallError with what it waits for."""
        since_s, until_s = time.time(), time.monotonic() + self._ready_s
        self.run(("systemctl", "reset-failed", unit), accepted=(0, 1))
        self.run(("systemctl", "start", "--no-block", unit))
        while (state := _said("systemctl", "is-active", unit)) != "active":
            if state == "failed" or time.monotonic() > until_s:
                why = "failed" if state == "failed" else f"is not ready after {self._ready_s:g} s"
                own = ("-u", unit, "-t", "failstop", f"--since=@{since_s:.3f}")
                words = _said("journalctl", "--quiet", "--no-pager", "--output=cat", *own)
                first = next(iter(words.splitlines()), "").removeprefix("failstop: ")
                says = _said("systemctl", "show", "--value", "-p", "StatusText", unit) or first or state
                raise InstallError(f"{unit} {why} and says: {says}; `journalctl -u {unit}` tells more")
            time.sleep(POLL_S)


def content(path: str) -> Content:
    """What is at a path of this machine. Raises OSError."""
    if os.path.islink(path):
        return os.readlink(path)
    if not os.path.isfile(path):
        return None
    with open(path, "rb") as file:
        return file.read()


def sha256(data: bytes) -> str:
    """As hex digits."""
    return hashlib.sha256(data).hexdigest()


def _said(*words: str) -> str:
    return _call(words).stdout.strip()


def _call(words: Sequence[str]) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PATH": PATH, "LC_ALL": "C.UTF-8"}
    try:
        return subprocess.run(
            words, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=RUN_S, check=False, env=environment
        )
    except FileNotFoundError:
        raise InstallError(f"{words[0]} is not on this machine: install the package that has it") from None
    except subprocess.TimeoutExpired:
        raise InstallError(f"{' '.join(words)} did not end within {RUN_S:g} s") from None
