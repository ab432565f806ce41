"""Instances: the names, runtime directories and locks that keep several robots on one machine apart."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Callable

from failstop.data import Data
from failstop.files import place, root

DEFAULT_NAME = "failstop"
_ALLOWED = frozenset("abcdefghijklmnopqrstuvwxyz0123456789_-")
RUN_DIGITS = 16
SHARED = "/dev/shm/failstop"
STOP_FIELD = "stop "
"""The begin of the word of a last run that holds a board's stop."""
LAST_BYTES = 65536
"""Longer than the longest paths of port and settings file, quoted for a shell."""


class Last(Data):
    """How the last run of a name was started."""

    device: str = ""
    """Its port; empty if this user can see no earlier run."""
    command: str = ""
    """The command line that starts it again."""
    servos: tuple[int, ...] = ()
    board: str = ""
    """The kind of its board; empty if not known."""
    stop: str = ""
    """The board's stop and baud rate (board/kept.py); empty if not known."""
    owner: int = 0
    """The user whose file says so, who may have written anything into it."""


class InstanceError(Exception):
    """The name or runtime directory can't be used; the message says why and what to do."""


class NoService(Exception):
    """No service with this name is running."""


def check_name(name: str) -> str:
    """Return the name, or raise InstanceError: 1 to 32 of a-z, 0-9, _ and -."""
    if not 0 < len(name) <= 32 or not _ALLOWED.issuperset(name):
        raise InstanceError(f"name {name!r}: use 1 to 32 of a-z, 0-9, _ and -")
    return name


def option(name: str) -> str:
    """The option that selects this instance: " --name NAME", or nothing for the default one."""
    return "" if name == DEFAULT_NAME else f" --name {name}"


def bases() -> list[str]:
    """The folders that hold the runtime directories of all instances, the best first."""
    user = os.getuid()
    session = os.environ.get("XDG_RUNTIME_DIR") or f"/run/user/{user}"
    found = [root.at("/run/failstop"), os.path.join(session, "failstop")]
    # A user without a session, for example in a container, has no private folder. In a shared folder other users may
    # have been first, and be in the way; never in root's.
    return [*found, f"{SHARED}-{user}"] if user else found


def places(name: str) -> list[str]:
    """Where the runtime directory of an instance may be, the best first. Raises InstanceError."""
    return [os.path.join(base, check_name(name)) for base in bases()]


def _file(name: str) -> Callable[[str], str]:
    """Where this file is in a runtime directory."""
    return lambda runtime_dir: os.path.join(runtime_dir, name)


lock_path = _file("lock")
"""The file whose first byte the running service locks."""
claims_path = _file("claims")
"""The file whose bytes clients lock to hold their slots."""
stop_path = _file("stop")
"""The FIFO that every local user may write to: any bytes are a stop."""
bell_path = _file("bell")
"""The FIFO by which clients wake the gate."""
run_path = _file("run")
"""The file that says which run's shared memory is the service's: its incarnation in RUN_DIGITS hexadecimal digits."""
last_path = _file("last")
"""The file that says how the last run was started; it stays when the run has ended."""


def _draft_of(path: str) -> str:
    """Where a file is written before it is renamed."""
    return f"{path}.new"


def publish_run(runtime_dir: str, incarnation: int) -> int:
    """Write which run serves this directory; returns the descriptor of that file. Raises OSError."""
    return _put(runtime_dir, run_path(runtime_dir), f"{incarnation:016x}\n".encode())


def remember(runtime_dir: str, last: Last) -> None:
    """Keep how this run was started, for after its end. Raises OSError."""
    words = last.device, last.command, last.board, f"{STOP_FIELD}{last.stop}", *map(str, last.servos)
    os.close(_put(runtime_dir, last_path(runtime_dir), b"\0".join(map(os.fsencode, words))))


def last(name: str) -> Last:
    """How the last run of this name was started, as far as this user may see it. Raises nothing."""
    found: list[tuple[int, int, list[str]]] = []
    # An impossible name; a file that is missing, or can't be trusted.
    with contextlib.suppress(InstanceError):
        for path in map(last_path, places(name)):
            with contextlib.suppress(OSError):
                found.append(_read(path))
    try:
        _, owner, (device, command, board, *rest) = max(found)
        stop = rest.pop(0).removeprefix(STOP_FIELD) if rest and rest[0].startswith(STOP_FIELD) else ""
        return Last(device, command if command.isprintable() else "", tuple(map(int, rest)), board, stop, owner)
    except ValueError:  # nothing was found, or nonsense
        return Last()


def _read(path: str) -> tuple[int, int, list[str]]:
    """When a file was written (Unix time, ns), whose it is, and the words in it. Raises OSError."""
    fd = place.opened(path, os.O_RDONLY)
    try:
        info = os.fstat(fd)
        return info.st_mtime_ns, info.st_uid, os.fsdecode(os.read(fd, LAST_BYTES)).split("\0")
    finally:
        os.close(fd)


def _put(runtime_dir: str, path: str, data: bytes) -> int:
    """Put a file that everyone may read into a runtime directory, whole or not at all; returns its descriptor. Raises
    OSError."""
    draft = _draft_of(path)
    above = place.directory(runtime_dir)
    fd = -1
    try:
        fd = place.opened(draft, os.O_RDWR | os.O_CREAT)
        os.ftruncate(fd, 0)
        if os.pwrite(fd, data, 0) < len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), path)
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
    """Remove everything a run has put into its directory, its name first, except the lock and how it was started."""
    try:
        where = place.directory(runtime_dir)
    except OSError:
        return
    each = [path(runtime_dir) for path in (run_path, stop_path, bell_path, claims_path)]
    for path in (*each, *(_draft_of(path(runtime_dir)) for path in (run_path, last_path))):
        with contextlib.suppress(OSError):
            os.unlink(os.path.basename(path), dir_fd=where)
    os.close(where)


def current_run(runtime_dir: str) -> tuple[int, int]:
    """(incarnation, uid of the owner) of the service in this directory. Raises NoService, InstanceError."""
    fd = -1
    try:
        fd = place.opened(run_path(runtime_dir), os.O_RDONLY)
        return int(os.pread(fd, RUN_DIGITS, 0), 16), os.fstat(fd).st_uid
    except place.Untrusted as error:
        raise InstanceError(str(error.strerror)) from None
    except (OSError, ValueError) as error:
        _unseen(error, run_path(runtime_dir))
        raise no_service(os.path.basename(runtime_dir)) from None
    finally:
        if fd >= 0:
            os.close(fd)


def already_running(name: str, pid: int | str) -> InstanceError:
    """The refusal to start a second service with one name."""
    return InstanceError(f"{name!r} is already running (pid {pid}): stop it first, or choose another --name")


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
            return path, place.opened(stop_path(path), os.O_WRONLY, pipe=True)
        except place.Untrusted as error:
            doubts.append(f"; {error.strerror}")
        except OSError as error:
            _unseen(error, stop_path(path))
    raise no_service(name, "".join(doubts))


def _unseen(error: Exception, path: str) -> None:
    """Raise InstanceError where this process has no descriptor left to look: a service may be running."""
    if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
        raise InstanceError(f"{path} can't be opened: {error.strerror}") from error


def no_service(name: str, doubts: str = "") -> NoService:
    """The error for a client if no service is running. `doubts`: files that were found but are not trusted."""
    return NoService(f"no service named {name!r} is running: start it with `{start_command(name)}`{doubts}")


def start_command(name: str) -> str:
    """The command line that starts a service of this name in the same way as its last run."""
    return last(name).command or f"failstop run{option(name)}"
