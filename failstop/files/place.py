"""Places: opening files in a runtime directory without trusting anyone else.

A path is only a claim. Every file opened here is checked on its descriptor, and nothing on the way to it was a link.
The directory belongs to root, to this user, or to a user to whom only root can have given it; nobody else may write to
it; and the file has the expected kind and the directory's owner. So nobody can plant a directory, a link or a file of
another kind for somebody else, least of all root, to write through.
"""

from __future__ import annotations

import errno
import os
import stat

_DIRECTORY = os.O_PATH | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
_FILE = os.O_NONBLOCK | os.O_NOFOLLOW | os.O_NOCTTY | os.O_CLOEXEC
_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH


class Untrusted(OSError):
    """Another user may have put it there; `strerror` says who, and what helps."""

    def __init__(self, path: str, why: str) -> None:
        super().__init__(errno.EBADF, f"{path} {why}", path)


def user(uid: int) -> str:
    """A user as people know them: name and number."""
    import pwd  # imported only for a refusal

    try:
        return f"{pwd.getpwuid(uid).pw_name} (uid {uid})"
    except KeyError:
        return f"uid {uid}"


def directory(path: str) -> int:
    """Open a runtime directory (O_PATH): its parent is checked too. Raises OSError, Untrusted among them."""
    above, name = os.path.split(path)
    base = base_directory(above)
    try:
        return inner_directory(base, name, path)
    finally:
        os.close(base)


def base_directory(path: str) -> int:
    """Open the directory in which runtime directories are made. Raises OSError, Untrusted among them."""
    return _checked(os.open(path, _DIRECTORY), path)


def inner_directory(base: int, name: str, path: str) -> int:
    """Open the directory `name` inside one that base_directory() has opened; `path` is its path for messages."""
    return _checked(os.open(name, _DIRECTORY, dir_fd=base), path, os.fstat(base))


def _checked(fd: int, path: str, base: os.stat_result | None = None) -> int:
    """The directory that is open as `fd`, if it belongs to root, to this user, to the base's owner, or to a user to
    whom only root can have given it. In a sticky base nobody can replace what exists."""
    try:
        found = os.fstat(fd)
        above = base or os.stat("..", dir_fd=fd)
        by_root = not above.st_uid and not above.st_mode & _BY_OTHERS
        owners = {0, os.geteuid(), found.st_uid if by_root else 0, base.st_uid if base else 0}
        if found.st_uid not in owners:
            raise Untrusted(path, f"belongs to {user(found.st_uid)}: not trusted; remove it, or run as that user")
        if found.st_mode & _BY_OTHERS and (base or not found.st_mode & stat.S_ISVTX):
            mode = stat.S_IMODE(found.st_mode)
            raise Untrusted(path, f"may be written by others (mode {mode:04o}): chmod go-w {path}")
    except BaseException:
        os.close(fd)
        raise
    return fd


def opened(path: str, flags: int, *, pipe: bool = False) -> int:
    """Open a file in a runtime directory, or a FIFO (`pipe`); a file that this creates belongs to this user alone (mode
    0600). Raises OSError, Untrusted among them."""
    above, name = os.path.split(path)
    where = directory(above)
    try:
        owner = os.fstat(where).st_uid
        fd = os.open(name, flags | _FILE, 0o600, dir_fd=where)
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise Untrusted(path, "is a link: remove it") from None
        raise
    finally:
        os.close(where)
    found = os.fstat(fd)
    if found.st_uid == owner and (stat.S_ISFIFO if pipe else stat.S_ISREG)(found.st_mode):
        return fd
    os.close(fd)
    if found.st_uid != owner:
        raise Untrusted(path, f"belongs to {user(found.st_uid)}, its directory to {user(owner)}: remove it")
    raise Untrusted(path, f"is not a {'FIFO' if pipe else 'regular file'}: remove it")
