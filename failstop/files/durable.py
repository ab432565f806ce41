"""Durable: writes files so that a power cut never leaves half a file, and opens only files that are safe to open.

A file is first written and synced under a draft name, then renamed. Only regular files are opened, because opening a
pipe could wait forever for its other end.
"""

from __future__ import annotations

import contextlib
import os
import stat
from errno import EINVAL, EPERM
from itertools import count

LEAST_ROOM = 1_000_000
"""The least free space on a disk, in bytes, with which failstop still writes files. An incident takes about half of
this, and it is the largest file that is kept after a run."""
FILE_TYPES = {
    stat.S_IFLNK: "a link",
    stat.S_IFIFO: "a FIFO",
    stat.S_IFDIR: "a directory",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


def open_regular(path: str, flags: int = os.O_RDONLY) -> int:
    """Open a regular file, also through links. Pipes and devices are refused, so opening never waits. Raises
    OSError."""
    # Check before opening, because opening a device can have effects, such as raising a port's modem lines.
    with contextlib.suppress(FileNotFoundError):
        _check_regular(os.lstat(path) if flags & os.O_NOFOLLOW else os.stat(path), path)
    fd = os.open(path, flags | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC, 0o644)
    try:
        _check_regular(os.fstat(fd), path)
    except OSError:
        os.close(fd)
        raise
    return fd


def open_own(path: str, flags: int = os.O_RDONLY) -> int:
    """Open a file that the service made. Raises OSError, also if the file is a link, is not regular, or has several
    names (hard links). The file must belong to this user or to the owner of its folder."""
    fd = open_regular(path, flags | os.O_NOFOLLOW)
    try:
        found = os.fstat(fd)
        owners = (os.geteuid(), os.stat(os.path.dirname(path) or ".").st_uid)
        # The folder's owner could have linked any file here, and this process may have more rights than that owner.
        if found.st_nlink > 1 or found.st_uid not in owners:
            raise OSError(EPERM, "a file of somebody else's, or with another name: move it away", path)
    except OSError:
        os.close(fd)
        raise
    return fd


def check_replaceable(path: str) -> None:
    """Raise OSError if something at this path is not a regular file, for example a device or a link. A rename would
    replace it by a file."""
    with contextlib.suppress(FileNotFoundError):
        _check_regular(os.lstat(path), path)


def _check_regular(found: os.stat_result, path: str) -> None:
    if not stat.S_ISREG(found.st_mode):
        what = FILE_TYPES.get(stat.S_IFMT(found.st_mode), "something else")
        raise OSError(EINVAL, f"{what}, not a regular file", path)


def write_draft(draft: str, data: bytes, like: str = "") -> None:
    """Write a new draft in place of an old one, and sync it to the disk. If that fails, the draft is removed. Raises
    OSError.

    With `like`, the umask has no effect: the draft gets the owner, the group and the mode of that file, or the mode
    0644 if the file does not exist. If this process may not give files away, the draft stays its own."""
    with contextlib.suppress(FileNotFoundError):
        os.unlink(draft)
    write_new(draft, data, like)


def write_new(path: str, data: bytes, like: str = "") -> None:
    """Write a file that does not exist yet, and sync it to the disk. If that fails, the file is removed. `like`: as for
    write_draft(). Raises OSError, and FileExistsError if something with this name exists."""
    # Never write through a link, because this process may have more rights than the folder's owner.
    fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644)
    try:
        with open(fd, "wb") as file:
            if like:
                _resemble(fd, like)
            file.write(data)
            file.flush()
            os.fsync(fd)
    except OSError:
        _drop(path)
        raise


def replace(path: str, data: bytes) -> None:
    """Write a file to a path that a person has chosen, completely or not at all. An existing file is replaced, but not
    a device or a link. Raises OSError."""
    check_replaceable(path)
    for number in count():
        draft = f"{path}.part{number or ''}"
        with contextlib.suppress(FileExistsError):  # somebody else's file
            write_new(draft, data)
            break
    publish(draft, path)


def _resemble(fd: int, path: str) -> None:
    mode = 0o644
    with contextlib.suppress(FileNotFoundError):
        found = os.stat(path)
        mode = found.st_mode & 0o777
        with contextlib.suppress(PermissionError):
            os.fchown(fd, found.st_uid, found.st_gid)
    os.fchmod(fd, mode)


def write_all(fd: int, data: bytes) -> None:
    """Write all of the data to a descriptor, and wait until it is on the disk. Raises OSError."""
    while data:
        data = data[os.write(fd, data) :]
    os.fsync(fd)


def publish(draft: str, path: str) -> None:
    """Rename a draft to its final name, in place of the old file. If the rename fails, the draft is removed and the old
    file stays. Raises OSError."""
    try:
        os.rename(draft, path)
    except OSError:
        _drop(draft)
        raise
    # Sync the folder, because otherwise a power cut can still undo the rename.
    fd = os.open(os.path.dirname(path) or ".", os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


def missing(path: str) -> bool:
    """True if nothing exists at a path. False if a closed folder keeps this user from looking: opening the path then
    raises PermissionError, which says what is wrong."""
    try:
        os.stat(path)
    except (FileNotFoundError, NotADirectoryError, ValueError):
        return True
    except OSError:
        return False
    return False


def no_room(path: str) -> str:
    """Why no new file fits on the disk of this path. Empty if there is room, or if the disk does not report its free
    space. If the path does not exist, the nearest existing folder above it counts."""
    while not os.path.exists(path) and path != os.path.dirname(path):
        path = os.path.dirname(path)
    try:
        found = os.statvfs(path)
    except OSError:
        return ""
    free = found.f_bavail * found.f_frsize
    if found.f_flag & os.ST_RDONLY:
        return f"the disk of {path} is read-only"
    if free < LEAST_ROOM:
        return f"the disk of {path} is full ({free // 1000} kB free)"
    # A file system that does not limit the number of files reports 0 of 0.
    return f"the disk of {path} has no room for another file" if found.f_files and not found.f_favail else ""


def _drop(draft: str) -> None:
    with contextlib.suppress(OSError):
        os.unlink(draft)
