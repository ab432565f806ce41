"""Instances: the names, the runtime directory and the service lock that keep several robots on one machine apart."""

from __future__ import annotations

import contextlib
import errno
import os
import time

from failstop.shm import bell, claim, place, root

DEFAULT_NAME = "failstop"
_ALLOWED = frozenset("abcdefghijklmnopqrstuvwxyz0123456789_-")


LETTING_GO_S = 0.5
"""How long a lock whose owner has died is waited for."""
RUN_DIGITS = 16
SHARED = "/dev/shm/failstop"
_NOT_FOR_US = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOENT, errno.ENOTDIR)
"""Why a place is another user's, or not there: the next one is tried."""


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
    user = os.getuid()
    session = os.environ.get("XDG_RUNTIME_DIR") or f"/run/user/{user}"
    found = [root.at("/run/failstop"), os.path.join(session, "failstop")]
    # Whoever has no session, in a container for one, has nothing that is private. Others may be there first, and be in
    # the way then; never root's.
    return [*found, f"{SHARED}-{user}"] if user else found


def places(name: str) -> list[str]:
    """Where the runtime directory of an instance may be, the best first. Raises InstanceError."""
    return [os.path.join(base, check_name(name)) for base in _candidates()]


def make_runtime_dir(name: str) -> str:
    """Make, or take over, the runtime directory of an instance and return its path. Raises InstanceError.

    It is the first that this user may make; one that can't be made for another reason is told, not passed over:
    clients would look there first.
    """
    check_name(name)
    doubts = ""
    for base in _candidates():
        try:
            if _made(base, name, 0o700 if base.startswith(SHARED) else 0o755):
                return os.path.join(base, name)
        except place.Untrusted as error:
            doubts += f"; {error.strerror}"
            if not os.geteuid():
                break
        except OSError as error:
            if error.errno not in _NOT_FOR_US:
                doubts += f"; {os.path.join(base, name)}: {error.strerror}"
                break
    raise InstanceError(
        f"no runtime directory for {name!r} in {', '.join(_candidates())}"
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
        # What root made there its owner could neither use nor remove.
        path, whose = os.path.join(base, name), place.user(owner)
        raise place.Untrusted(path, f"belongs to {whose}: start it as that user, or choose another --name")
    return owner == os.geteuid()


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


def run_path(runtime_dir: str) -> str:
    """The file that says which run's shared memory is the service's: its incarnation, RUN_DIGITS hexadecimal digits."""
    return os.path.join(runtime_dir, "run")


def _draft_path(runtime_dir: str) -> str:
    return f"{run_path(runtime_dir)}.new"


def publish(runtime_dir: str, incarnation: int) -> int:
    """Say which run serves this directory; returns the descriptor of the file that says so. Raises OSError."""
    draft, path = _draft_path(runtime_dir), run_path(runtime_dir)
    above = place.directory(runtime_dir)
    fd = -1
    try:
        fd = place.opened(draft, os.O_RDWR | os.O_CREAT)
        os.ftruncate(fd, 0)
        os.pwrite(fd, f"{incarnation:016x}\n".encode(), 0)
        os.fchmod(fd, 0o644)
        os.rename(os.path.basename(draft), os.path.basename(path), src_dir_fd=above, dst_dir_fd=above)
    except BaseException:
        if fd >= 0:
            os.close(fd)
        raise
    finally:
        os.close(above)
    return fd


def clear(runtime_dir: str) -> None:
    """Take away what a run has put into its directory, all but the lock; as far as it is there."""
    try:
        where = place.directory(runtime_dir)
    except OSError:
        return
    for path in (stop_path, bell_path, claims_path, run_path, _draft_path):
        with contextlib.suppress(OSError):
            os.unlink(os.path.basename(path(runtime_dir)), dir_fd=where)
    os.close(where)


def run(runtime_dir: str) -> tuple[int, int]:
    """Of the service of this directory: (incarnation, uid of its owner). Raises NoService, InstanceError."""
    try:
        fd = place.opened(run_path(runtime_dir), os.O_RDONLY)
    except place.Untrusted as error:
        raise InstanceError(str(error.strerror)) from None
    except OSError:
        raise no_service(os.path.basename(runtime_dir)) from None
    try:
        return int(os.pread(fd, RUN_DIGITS, 0), 16), os.fstat(fd).st_uid
    except ValueError:
        raise no_service(os.path.basename(runtime_dir)) from None
    finally:
        os.close(fd)


def lock(runtime_dir: str) -> int:
    """Become the service of this directory; returns the descriptor to keep open. Raises InstanceError when one runs, or
    the lock can't be written."""
    path = lock_path(runtime_dir)
    try:
        # Private: a lock that others could open, they could hold.
        fd = claim.open_claims(path, create=True, mode=0o600)
    except OSError as error:
        raise InstanceError(f"the lock {path} can't be made: {error.strerror}") from None
    try:
        until_s = time.monotonic() + LETTING_GO_S
        while not claim.take(fd, 0):
            pid = _pid(fd)
            # A process that a supervisor was just starting when it died has the lock too, until its exec.
            if time.monotonic() > until_s or os.path.exists(f"/proc/{pid}"):
                raise already_running(os.path.basename(runtime_dir), pid)
            time.sleep(0.002)
        os.ftruncate(fd, 0)
        os.pwrite(fd, f"{os.getpid()}\n".encode(), 0)
    except OSError as error:
        os.close(fd)
        raise InstanceError(f"the lock {path} can't be written: {error.strerror}") from None
    except BaseException:
        os.close(fd)
        raise
    return fd


def _pid(fd: int) -> str:
    """Of the lock's holder, as it has written it there."""
    return os.pread(fd, 32, 0).decode("ascii", "replace").strip() or "unknown"


def refuse_locked(name: str) -> None:
    """Raises InstanceError while a living process has the lock of a service of this name."""
    for path in places(name):
        if pid := holder(path):
            raise already_running(name, pid)


def refuse_listening(name: str, but: str = "") -> None:
    """Raises InstanceError while a service of this name listens, in another directory than `but`."""
    for path in places(name):
        if path != but and _listens(path):
            raise already_running(name, "unknown")


def holder(runtime_dir: str) -> str:
    """Pid of the living process that holds the lock; empty when there is none, or it is another user's."""
    try:
        fd = claim.open_claims(lock_path(runtime_dir))
    except OSError:
        return ""
    try:
        return pid if claim.held(fd, 0) and os.path.exists(f"/proc/{(pid := _pid(fd))}") else ""
    finally:
        os.close(fd)


def _listens(runtime_dir: str) -> bool:
    try:
        return running(runtime_dir)
    except place.Untrusted:
        return False


def already_running(name: str, pid: int | str) -> InstanceError:
    """The refusal of a second service of one name."""
    return InstanceError(f"{name!r} is already running (pid {pid}): stop it first, or choose another --name")


def running(runtime_dir: str) -> bool:
    """True while a service of this directory listens for stop requests. Raises place.Untrusted."""
    try:
        os.close(bell.open_pipe_to_write(stop_path(runtime_dir)))
    except place.Untrusted:
        raise
    except OSError:
        return False
    return True


def find(name: str) -> str:
    """Return the runtime directory of the running service of this name. Raises NoService, InstanceError."""
    path, fd = open_stop(name)
    os.close(fd)
    return path


def open_stop(name: str) -> tuple[str, int]:
    """Open the stop pipe of the running service of this name to write; returns the runtime directory and the
    descriptor. Raises NoService, InstanceError."""
    doubts = []
    for path in places(name):
        try:
            return path, bell.open_pipe_to_write(stop_path(path))
        except place.Untrusted as error:
            doubts.append(f"; {error.strerror}")
        except OSError:
            continue
    raise no_service(name, "".join(doubts))


def no_service(name: str, doubts: str = "") -> NoService:
    """The refusal to whoever asks for a service that does not run. `doubts`: what was found and is not believed."""
    return NoService(f"no service named {name!r} is running: start it with `failstop run --name {name}`{doubts}")


def listens(name: str) -> bool:
    """True while a service of this name takes stop requests; never of what can't be a name."""
    try:
        find(name)
    except (InstanceError, NoService):
        return False
    return True


def listening() -> list[str]:
    """The names of all services that take stop requests, as far as this user sees them."""
    found: set[str] = set()
    for base in _candidates():
        try:
            found.update(filter(listens, os.listdir(base)))
        except OSError:
            continue
    return sorted(found)
