"""Instances: keeps several robots on one machine apart. Each instance has a name, a runtime directory and a lock."""

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
USB_FIELD = "usb "
"""In the file of the last run, the fields with the board's stop and with its USB device begin with these texts."""
LAST_BYTES = 65536
"""The most bytes that are read from the file of the last run. Even the longest possible paths, quoted for a shell, fit
into it."""


class Last(Data):
    """How the last service of a name was started. The stop tool uses it when no service is running."""

    device: str = ""
    """The path of the port that it had in the end; empty if this user can't see an earlier run."""
    command: str = ""
    """The command line that starts it again."""
    servos: tuple[int, ...] = ()
    board: str = ""
    """The kind of its board; empty if not known."""
    stop: str = ""
    """The stop frames and baud rate of its board (board/kept.py); empty if not known."""
    usb: str = ""
    """The USB device at its port (finder.Device.text); empty if it was none, or if it is not known."""
    owner: int = 0
    """The uid of the user who owns the file with these values. That user may have written anything into it."""


class InstanceError(Exception):
    """The name or the runtime directory can't be used. The message says why, and what to do."""


class NoService(Exception):
    """No service with this name is running."""


def check_name(name: str) -> str:
    """Return the name if it is valid: 1 to 32 of the characters a-z, 0-9, _ and -. Raises InstanceError for any other
    name."""
    if not 0 < len(name) <= 32 or not _ALLOWED.issuperset(name):
        raise InstanceError(f"name {name!r}: use 1 to 32 of a-z, 0-9, _ and -")
    return name


def option(name: str) -> str:
    """The text of the option that selects this instance, " --name NAME". Empty for the default instance."""
    return "" if name == DEFAULT_NAME else f" --name {name}"


def bases() -> list[str]:
    """The folders that can contain runtime directories, in the order in which they are tried."""
    user = os.getuid()
    session = os.environ.get("XDG_RUNTIME_DIR") or f"/run/user/{user}"
    found = [root.at("/run/failstop"), os.path.join(session, "failstop")]
    # Without a session, for example in a container, a user has no private folder, so the last one is in a shared
    # folder. There another user may have taken the name before. Root never uses that folder.
    return [*found, f"{SHARED}-{user}"] if user else found


def places(name: str) -> list[str]:
    """The paths where the runtime directory of an instance can be, in the order in which they are tried. Raises
    InstanceError for an invalid name."""
    return [os.path.join(base, check_name(name)) for base in bases()]


def _file(name: str) -> Callable[[str], str]:
    """A function that returns the path of the file `name` in a given runtime directory."""
    return lambda runtime_dir: os.path.join(runtime_dir, name)


lock_path = _file("lock")
"""Path of the lock file. The running service locks its first byte."""
claims_path = _file("claims")
"""Path of the claims file. Each client locks one of its bytes to hold a client slot."""
stop_path = _file("stop")
"""Path of the stop pipe, a FIFO that every local user may write to. Any bytes in it stop the robot."""
bell_path = _file("bell")
"""Path of the bell, a FIFO with which clients wake the gate."""
run_path = _file("run")
"""Path of the file that leads clients to the shared memory of the running service. It has the incarnation of this run,
a random number in the names of the shared memory, as RUN_DIGITS hexadecimal digits."""
last_path = _file("last")
"""Path of the file that says how the last service was started. It stays when the service ends."""


def _draft_of(path: str) -> str:
    """The path under which a file is written before it is renamed."""
    return f"{path}.new"


def publish_run(runtime_dir: str, incarnation: int) -> int:
    """Write the incarnation of this run into the runtime directory, so that clients find its shared memory. Returns a
    descriptor of the file. Raises OSError."""
    return _put(runtime_dir, run_path(runtime_dir), f"{incarnation:016x}\n".encode())


def remember(runtime_dir: str, last: Last) -> None:
    """Save how this service was started, for use after it has ended. Raises OSError."""
    fields = f"{STOP_FIELD}{last.stop}", f"{USB_FIELD}{last.usb}"
    words = last.device, last.command, last.board, *fields, *map(str, last.servos)
    os.close(_put(runtime_dir, last_path(runtime_dir), b"\0".join(map(os.fsencode, words))))


def last(name: str) -> Last:
    """How the last service of this name was started. All fields are empty if this user can't find out. Never raises."""
    found: list[tuple[int, int, list[str]]] = []
    # An impossible name, a missing file, or a file that can't be trusted.
    with contextlib.suppress(InstanceError):
        for path in map(last_path, places(name)):
            with contextlib.suppress(OSError):
                found.append(_read(path))
    try:
        _, owner, (device, command, board, *rest) = max(found)
        stop, usb = (
            rest.pop(0).removeprefix(field) if rest and rest[0].startswith(field) else ""
            for field in (STOP_FIELD, USB_FIELD)
        )
        return Last(device, command if command.isprintable() else "", tuple(map(int, rest)), board, stop, usb, owner)
    except ValueError:  # no file was found, or it is damaged
        return Last()


def _read(path: str) -> tuple[int, int, list[str]]:
    """Read the file of a last run. Returns (when it was written in Unix time, ns; the uid of its owner; its fields).
    Raises OSError."""
    fd = place.opened(path, os.O_RDONLY)
    try:
        info = os.fstat(fd)
        return info.st_mtime_ns, info.st_uid, os.fsdecode(os.read(fd, LAST_BYTES)).split("\0")
    finally:
        os.close(fd)


def _put(runtime_dir: str, path: str, data: bytes) -> int:
    """Write a file that everyone may read into a runtime directory, either completely or not at all. Returns a
    descriptor of the file. Raises OSError."""
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
    """Remove the files of a run when it ends. The `run` file goes first, so that no client finds a service that is
    ending. The lock and the file of the last run stay."""
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
    """Return (incarnation, uid of the owner) of the service in this runtime directory. Raises NoService,
    InstanceError."""
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
    """The error if a second service with the same name is started."""
    return InstanceError(f"{name!r} is already running (pid {pid}): stop it first, or choose another --name")


def find(name: str) -> str:
    """Return the runtime directory of the running service of this name. Raises NoService, InstanceError."""
    path, fd = open_stop(name)
    os.close(fd)
    return path


def open_stop(name: str) -> tuple[str, int]:
    """Open the stop pipe of the running service of this name for writing. Returns the runtime directory and the
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
    """Raise InstanceError if the file could not be opened because too many files are open. A service may still be
    running, so it must not be reported as missing."""
    if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
        raise InstanceError(f"{path} can't be opened: {error.strerror}") from error


def no_service(name: str, doubts: str = "") -> NoService:
    """The error for a client if no service of this name is running. `doubts`: what is wrong with files that were found
    but are not trusted."""
    return NoService(f"no service named {name!r} is running: start it with `{start_command(name)}`{doubts}")


def start_command(name: str) -> str:
    """The command line that starts this service as it was started last time."""
    return last(name).command or f"failstop run{option(name)}"
