"""Instances on this machine: becoming the service of a name, and which names have a service that listens."""

from __future__ import annotations

import contextlib
import errno
import os
import time

from failstop.files import instance, place
from failstop.shm import bell, claim

LETTING_GO_S = 0.5
"""How long a lock whose owner has died is waited for."""
_NOT_FOR_US = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOENT, errno.ENOTDIR)
"""Why a place is another user's, or not there: the next one is tried."""


def unit_of(name: str) -> str:
    """The systemd unit of an instance."""
    return "failstop.service" if name == instance.DEFAULT_NAME else f"failstop@{name}.service"


def make_runtime_dir(name: str) -> str:
    """Make, or take over, the runtime directory of an instance and return its path. Raises InstanceError.

    It is the first that this user may make; one that can't be made for another reason is told, not passed over:
    clients would look there first.
    """
    instance.check_name(name)
    doubts = ""
    for base in instance.bases():
        try:
            if _made(base, name, 0o700 if base.startswith(instance.SHARED) else 0o755):
                return os.path.join(base, name)
        except place.Untrusted as error:
            doubts += f"; {error.strerror}"
            if not os.geteuid():
                break
        except OSError as error:
            if error.errno not in _NOT_FOR_US:
                doubts += f"; {os.path.join(base, name)}: {error.strerror}"
                break
    raise instance.InstanceError(
        f"no runtime directory for {name!r} in {', '.join(instance.bases())}"
        f"{doubts or '; none can be written: set XDG_RUNTIME_DIR to a directory that is yours alone'}"
    )


def _made(base: str, name: str, mode: int) -> bool:
    """Make both directories; False where another user keeps this one from it. Raises OSError."""
    before = os.umask(0)
    try:
        with contextlib.suppress(FileExistsError):
            os.mkdir(base, mode)
        above = place.base_directory(base)
        try:
            with contextlib.suppress(FileExistsError):
                os.mkdir(name, mode, dir_fd=above)
            found = place.inner_directory(above, name, os.path.join(base, name))
        finally:
            os.close(above)
    finally:
        os.umask(before)
    try:
        owner = os.fstat(found).st_uid
    finally:
        os.close(found)
    if owner != os.geteuid() and not os.geteuid():
        # The owner could neither use nor remove a thing that root made there.
        path, whose = os.path.join(base, name), place.user(owner)
        raise place.Untrusted(path, f"belongs to {whose}: start it as that user, or choose another --name")
    return owner == os.geteuid()


def lock(runtime_dir: str) -> int:
    """Become the service of this directory; returns the descriptor to keep open. Raises InstanceError when one runs, or
    the lock can't be written."""
    path = instance.lock_path(runtime_dir)
    try:
        # Private: a lock that others could open, they could hold.
        fd = claim.open_claims(path, create=True, mode=0o600)
    except OSError as error:
        raise instance.InstanceError(f"the lock {path} can't be made: {error.strerror}") from None
    try:
        until_s = time.monotonic() + LETTING_GO_S
        while not claim.acquire(fd, 0):
            pid = _pid(fd)
            # A process that a supervisor was just starting when it died has the lock too, until its exec.
            if time.monotonic() > until_s or os.path.exists(f"/proc/{pid}"):
                raise instance.already_running(os.path.basename(runtime_dir), pid)
            time.sleep(0.002)
        os.ftruncate(fd, 0)
        os.pwrite(fd, f"{os.getpid()}\n".encode(), 0)
    except OSError as error:
        os.close(fd)
        raise instance.InstanceError(f"the lock {path} can't be written: {error.strerror}") from None
    except BaseException:
        os.close(fd)
        raise
    return fd


def _pid(fd: int) -> str:
    """The pid of the lock's holder, which it wrote into the file; `unknown` if it has not."""
    return os.pread(fd, 32, 0).decode("ascii", "replace").strip() or "unknown"


def refuse_locked(name: str) -> None:
    """Raises InstanceError while a living process has the lock of a service of this name."""
    for path in instance.places(name):
        if pid := holder(path):
            raise instance.already_running(name, pid)


def refuse_listening(name: str, but: str = "") -> None:
    """Raises InstanceError while a service of this name listens, in another directory than `but`."""
    for path in instance.places(name):
        if path != but and running(path):
            raise instance.already_running(name, "unknown")


def holder(runtime_dir: str) -> str:
    """Pid of the living process that holds the lock; empty when there is none, or it is another user's."""
    try:
        fd = claim.open_claims(instance.lock_path(runtime_dir))
    except OSError:
        return ""
    try:
        return pid if claim.held(fd, 0) and os.path.exists(f"/proc/{(pid := _pid(fd))}") else ""
    finally:
        os.close(fd)


def running(runtime_dir: str) -> bool:
    """True while a service of this directory listens for stop requests; never in one of somebody else's."""
    try:
        os.close(bell.open_pipe_to_write(instance.stop_path(runtime_dir)))
    except OSError:
        return False
    return True


def listens(name: str) -> bool:
    """True while a service of this name takes stop requests; never of what can't be a name."""
    try:
        instance.find(name)
    except (instance.InstanceError, instance.NoService):
        return False
    return True


def listening() -> list[str]:
    """The names of all services that take stop requests, as far as this user sees them."""
    found: set[str] = set()
    for base in instance.bases():
        with contextlib.suppress(OSError):
            found.update(filter(listens, os.listdir(base)))
    return sorted(found)
