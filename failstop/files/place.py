"""Places: opens files in a runtime directory without trusting other users.

Another user could put a directory, a link or another kind of file at the expected path, and this process would write
into it. That is worst if this process runs as root. So every directory and file is checked after it was opened, and no
link is followed. A directory must belong to root, to this user or to another trusted user (see _checked()), and nobody
else may write to it. A file must have the expected kind and the same owner as its directory.
"""

from __future__ import annotations

import errno
import os
import stat

_DIRECTORY = os.O_PATH | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
_FILE = os.O_NONBLOCK | os.O_NOFOLLOW | os.O_NOCTTY | os.O_CLOEXEC
_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH


def by_others(found: os.stat_result, *, on_the_way: bool) -> bool:
    """True if the mode of a file or folder lets anyone but its owner change it. A folder with the sticky bit, such as
    /tmp, may be on the way to a file (`on_the_way`), because only the owner of an entry can remove or rename that
    entry."""
    folder = stat.S_ISDIR(found.st_mode)
    sticky = on_the_way and folder and found.st_mode & stat.S_ISVTX
    return bool((folder or stat.S_ISREG(found.st_mode)) and found.st_mode & _BY_OTHERS and not sticky)


class Untrusted(OSError):
    """Another user may have made this file or directory. `strerror` gives the reason and the remedy."""

    def __init__(self, path: str, why: str) -> None:
        super().__init__(errno.EBADF, f"{path} {why}", path)


def user(uid: int) -> str:
    """A user's name and number, for example `robot (uid 1000)`."""
    import pwd  # imported only if a file is refused

    try:
        return f"{pwd.getpwuid(uid).pw_name} (uid {uid})"
    except KeyError:
        return f"uid {uid}"


def directory(path: str) -> int:
    """Open a runtime directory (O_PATH), after checking it and its parent. Raises OSError, or Untrusted."""
    above, name = os.path.split(path)
    base = base_directory(above)
    try:
        return inner_directory(base, name, path)
    finally:
        os.close(base)


def base_directory(path: str) -> int:
    """Open the folder that contains runtime directories, after checking it. Raises OSError, or Untrusted."""
    return _checked(os.open(path, _DIRECTORY), path)


def inner_directory(base: int, name: str, path: str) -> int:
    """Open the directory `name` inside a directory that base_directory() has opened. `path`: its path, for error
    messages. Raises OSError, or Untrusted."""
    return _checked(os.open(name, _DIRECTORY, dir_fd=base), path, os.fstat(base))


def _checked(fd: int, path: str, base: os.stat_result | None = None) -> int:
    """Return `fd` if its directory can be trusted, else close it and raise Untrusted.

    The directory must belong to root, to this user or to the owner of `base`. Any owner is trusted if the parent
    directory belongs to root and only root may write to the parent. Nobody but the owner may write to the directory.

    `base` is None for a folder that contains runtime directories. Others may write to such a folder if it has the
    sticky bit, because then nobody can replace another user's files.
    """
    try:
        found = os.fstat(fd)
        above = base or os.stat("..", dir_fd=fd)
        by_root = not above.st_uid and not above.st_mode & _BY_OTHERS
        owners = {0, os.geteuid(), found.st_uid if by_root else 0, base.st_uid if base else 0}
        if found.st_uid not in owners:
            raise Untrusted(path, f"belongs to {user(found.st_uid)}: not trusted; remove it, or run as that user")
        if by_others(found, on_the_way=base is None):
            mode = stat.S_IMODE(found.st_mode)
            raise Untrusted(path, f"may be written by others (mode {mode:04o}): chmod go-w {path}")
    except BaseException:
        os.close(fd)
        raise
    return fd


def opened(path: str, flags: int, *, pipe: bool = False) -> int:
    """Open a file in a runtime directory, after checking the directory and the file. `pipe`: True for a FIFO, False for
    a regular file. A file that `flags` create gets the mode 0600. Raises OSError, or Untrusted."""
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
