"""Instances: starts a service under a name that no other service on this machine uses, and lists the running
services."""

from __future__ import annotations

import contextlib
import errno
import os
import time

from failstop.files import instance, place
from failstop.shm import bell, claim

LETTING_GO_S = 0.5
"""If the owner of a lock has died, wait this long, in seconds, until the kernel has released the lock."""
_NOT_FOR_US = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOENT, errno.ENOTDIR)
"""If a directory can't be made because of one of these errors, it belongs to another user, or its parent is missing or
read-only. Then the next directory is tried."""


def unit_of(name: str) -> str:
    """The systemd unit of the instance with this name, for example `failstop@left.service` for the name left."""
    return "failstop.service" if name == instance.DEFAULT_NAME else f"failstop@{name}.service"


def make_runtime_dir(name: str) -> str:
    """Make or take over the runtime directory of an instance, and return its path. Raises InstanceError.

    It tries the directories of instance.bases() in order, and skips those that this user may not use. Any other error,
    such as a full disk, ends the search. Clients look in that directory first, so they would not find a service in a
    later one.
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
    """Make the directory `name` in `base`, and `base` itself if needed. Returns False if another user owns the inner
    directory. For root this raises Untrusted instead. Raises OSError."""
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
        # The owner could neither use nor remove files that root makes in this directory.
        path, whose = os.path.join(base, name), place.user(owner)
        raise place.Untrusted(path, f"belongs to {whose}: start it as that user, or choose another --name")
    return owner == os.geteuid()


def lock(runtime_dir: str) -> int:
    """Lock a runtime directory for this process, so that no second service can use it. Returns a descriptor, which must
    stay open as long as the service runs. Raises InstanceError if a service is running there, or the lock can't be
    written."""
    path = instance.lock_path(runtime_dir)
    try:
        # Private, because any user who can open the lock file can also hold the lock.
        fd = claim.open_claims(path, create=True, mode=0o600)
    except OSError as error:
        raise instance.InstanceError(f"the lock {path} can't be made: {error.strerror}") from None
    try:
        until_s = time.monotonic() + LETTING_GO_S
        while not claim.acquire(fd, 0):
            pid = _pid(fd)
            # If a supervisor dies while it starts a process, that process holds the lock too, until it calls exec.
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
    """The pid that the holder of the lock wrote into the lock file, or `unknown`."""
    return os.pread(fd, 32, 0).decode("ascii", "replace").strip() or "unknown"


def refuse_locked(name: str) -> None:
    """Raise InstanceError if a living process holds the lock of a service of this name."""
    for path in instance.places(name):
        if pid := holder(path):
            raise instance.already_running(name, pid)


def refuse_listening(name: str, but: str = "") -> None:
    """Raise InstanceError if a service of this name accepts stop requests in any runtime directory other than `but`."""
    for path in instance.places(name):
        if path != but and running(path):
            raise instance.already_running(name, "unknown")


def holder(runtime_dir: str) -> str:
    """The pid of the living process that holds the lock of a runtime directory. Empty if no process holds the lock, or
    if this user can't open it."""
    try:
        fd = claim.open_claims(instance.lock_path(runtime_dir))
    except OSError:
        return ""
    try:
        return pid if claim.held(fd, 0) and os.path.exists(f"/proc/{(pid := _pid(fd))}") else ""
    finally:
        os.close(fd)


def running(runtime_dir: str) -> bool:
    """True if a service in this runtime directory accepts stop requests. False if the directory is not trusted, because
    another user could have made it."""
    try:
        os.close(bell.open_pipe_to_write(instance.stop_path(runtime_dir)))
    except OSError:
        return False
    return True


def listens(name: str) -> bool:
    """True if a service of this name accepts stop requests. False if the name is not a valid one."""
    try:
        instance.find(name)
    except (instance.InstanceError, instance.NoService):
        return False
    return True


def listening() -> list[str]:
    """The names of all services that accept stop requests and whose runtime directory this user can see."""
    found: set[str] = set()
    for base in instance.bases():
        with contextlib.suppress(OSError):
            found.update(filter(listens, os.listdir(base)))
    return sorted(found)
