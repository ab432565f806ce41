"""Places: opening what is in a runtime directory without taking anybody else's word for it.

A path is a claim. What is opened here was proved on the descriptor, and nothing on the way to it was a link: the
directory is root's, this user's, or of whom root alone can have put above it; nobody else may write it; and what is in
it is of the expected kind and of the directory's owner. So nobody can plant a directory, a link, or a file of another
kind for somebody else to write through, whoever that is, root first of all.
"""

from __future__ import annotations

import errno
import os
import stat

_DIRECTORY = os.O_PATH | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
_FILE = os.O_NONBLOCK | os.O_NOFOLLOW | os.O_NOCTTY | os.O_CLOEXEC
_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH


class Untrusted(OSError):
    """Somebody else may have put it there; `strerror` says who, and what helps."""

    def __init__(self, path: str, why: str) -> None:
        super().__init__(errno.EBADF, f"{path} {why}", path)


def user(uid: int) -> str:
    """A user as people know them: name and number."""
    import pwd  # only for what is refused

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
    """Open the directory that runtime directories are made in. Raises OSError, Untrusted among them."""
    return _checked(os.open(path, _DIRECTORY), path)


def inner_directory(base: int, name: str, path: str) -> int:
    """Open the directory `name` of one that base_directory() has opened; `path` is what people call it."""
    return _checked(os.open(name, _DIRECTORY, dir_fd=base), path, os.fstat(base))


def _checked(fd: int, path: str, base: os.stat_result | None = None) -> int:
    """The directory that is open as `fd`, if it is root's, this user's, its base's owner's, or of whom root alone can
    have given it to. In a base that is sticky nobody puts anything in the place of what is there."""
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
    """Open a file of a runtime directory, or a FIFO (`pipe`); one that is created is this user's alone (mode 0600).
    Raises OSError, Untrusted among them."""
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
    raise Untrusted(path, f"is no {'FIFO' if pipe else 'regular file'}: remove it")
