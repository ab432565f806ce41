"""Instances: the names, the runtime directory and the service lock that keep several robots on one machine apart."""

from __future__ import annotations

import errno
import os
import stat
import time

from failstop.shm import claim, root

DEFAULT_NAME = "failstop"
_ALLOWED = frozenset("abcdefghijklmnopqrstuvwxyz0123456789_-")


LETTING_GO_S = 0.5
"""How long a lock whose owner has died is waited for."""


class InstanceError(Exception):
    """The name or runtime directory can't be used; the message says why and what to do."""


class NoService(Exception):
    """No service of this name runs."""


def check_name(name: str) -> str:
    """Return the name, or raise InstanceError: 1 to 32 of a-z, 0-9, _ and -."""
    if not 0 < len(name) <= 32 or not _ALLOWED.issuperset(name):
        raise InstanceError(f"name {name!r}: use 1 to 32 of a-z, 0-9, _ and -")
    return name


def option(name: str) -> str:
    """What a command of failstop needs to mean this instance: " --name NAME", and nothing for the default one."""
    return "" if name == DEFAULT_NAME else f" --name {name}"


def _candidates() -> list[str]:
    places = [root.at("/run/failstop")]
    if session := os.environ.get("XDG_RUNTIME_DIR"):
        places.append(os.path.join(session, "failstop"))
    places.append(f"/tmp/failstop-{os.getuid()}")
    return places


def places(name: str) -> list[str]:
    """Where the runtime directory of an instance may be, the best first. Raises InstanceError."""
    return [os.path.join(base, check_name(name)) for base in _candidates()]


def make_runtime_dir(name: str) -> str:
    """Make, or take over, the runtime directory of an instance and return its path. Raises InstanceError."""
    check_name(name)
    for base in _candidates():
        private = base.startswith("/tmp/")
        path = os.path.join(base, name)
        try:
            for part in (base, path):
                _make_dir(part, 0o700 if private else 0o755)
        except OSError:
            continue
        if os.access(path, os.W_OK | os.X_OK):
            return path
    raise InstanceError(f"no runtime directory for {name!r}: none of {', '.join(_candidates())} can be written")


def _make_dir(path: str, mode: int) -> None:
    """Make one directory with this mode, or accept one that is there and is no trap of another user."""
    try:
        os.mkdir(path, mode)
        os.chmod(path, mode)
    except FileExistsError:
        found = os.lstat(path)
        if not stat.S_ISDIR(found.st_mode) or (path.startswith("/tmp/") and found.st_uid != os.getuid()):
            raise NotADirectoryError(errno.ENOTDIR, "not a directory of this user", path) from None


def lock_path(runtime_dir: str) -> str:
    """The file whose first byte the running service holds."""
    return os.path.join(runtime_dir, "lock")


def claims_path(runtime_dir: str) -> str:
    """The file on whose bytes clients hold their slots."""
    return os.path.join(runtime_dir, "claims")


def stop_path(runtime_dir: str) -> str:
    """The FIFO that every local user may write: any bytes are a stop."""
    return os.path.join(runtime_dir, "stop")


def bell_path(runtime_dir: str) -> str:
    """The FIFO by which clients wake the gate."""
    return os.path.join(runtime_dir, "bell")


def lock(runtime_dir: str) -> int:
    """Become the service of this directory; returns the descriptor to keep open. Raises InstanceError when one runs."""
    # Private: a lock that others could open, they could hold.
    fd = claim.open_claims(lock_path(runtime_dir), create=True, mode=0o600)
    until_s = time.monotonic() + LETTING_GO_S
    while not claim.take(fd, 0):
        pid = os.pread(fd, 32, 0).decode("ascii", "replace").strip()
        # A process that a supervisor was just starting when it died has the lock too, until its exec.
        if time.monotonic() > until_s or os.path.exists(f"/proc/{pid or 'unknown'}"):
            os.close(fd)
            raise already_running(os.path.basename(runtime_dir), pid or "unknown")
        time.sleep(0.002)
    os.ftruncate(fd, 0)
    os.pwrite(fd, f"{os.getpid()}\n".encode(), 0)
    return fd


def already_running(name: str, pid: int | str) -> InstanceError:
    """The refusal of a second service of one name."""
    return InstanceError(f"{name!r} is already running (pid {pid}): stop it first, or choose another --name")


def running(runtime_dir: str) -> bool:
    """True while a service of this directory listens for stop requests."""
    try:
        os.close(os.open(stop_path(runtime_dir), os.O_WRONLY | os.O_NONBLOCK | os.O_CLOEXEC))
    except OSError:
        return False
    return True


def find(name: str) -> str:
    """Return the runtime directory of the running service of this name. Raises NoService, InstanceError."""
    for path in places(name):
        if running(path):
            return path
    raise NoService(f"no service named {name!r} is running: start it with `failstop run --name {name}`")
