"""Durable: files that are either whole and on the disk, or absent, and that are what they seem to be.

A draft is written and synced, then renamed. Only regular files are read or appended to, so that no open waits for the
other end of a pipe.
"""

from __future__ import annotations

import contextlib
import os
import stat
from errno import EINVAL, EPERM

LEAST_ROOM = 1_000_000
"""Bytes. An incident, the largest file that outlives a run, takes about half of this."""
FILE_TYPES = {
    stat.S_IFLNK: "a link",
    stat.S_IFIFO: "a FIFO",
    stat.S_IFDIR: "a directory",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


def open_regular(path: str, flags: int = os.O_RDONLY) -> int:
    """Open a regular file, also through links. Returns at once; opening a pipe would wait. Raises OSError."""
    # Check before opening, because opening a device has effects, such as raising a port's modem lines.
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
    """Open a file of the service: regular, with no second name, owned by this user or its folder's owner. Raises
    OSError."""
    fd = open_regular(path, flags | os.O_NOFOLLOW)
    try:
        found = os.fstat(fd)
        owners = (os.geteuid(), os.stat(os.path.dirname(path) or ".").st_uid)
        # The caller may have more rights than the folder's owner, who could have given any file a second name here.
        if found.st_nlink > 1 or found.st_uid not in owners:
            raise OSError(EPERM, "a file of somebody else's, or with another name: move it away", path)
    except OSError:
        os.close(fd)
        raise
    return fd


def _check_regular(found: os.stat_result, path: str) -> None:
    if not stat.S_ISREG(found.st_mode):
        what = FILE_TYPES.get(stat.S_IFMT(found.st_mode), "something else")
        raise OSError(EINVAL, f"{what}, not a regular file", path)


def write_draft(draft: str, data: bytes) -> None:
    """Write a draft, replacing an old one. Raises OSError, and then leaves none."""
    with contextlib.suppress(FileNotFoundError):
        os.unlink(draft)
    try:
        # Never through a link, because the caller may have more rights than the folder's owner.
        with open(draft, "xb", opener=lambda path, flags: os.open(path, flags | os.O_NOFOLLOW, 0o644)) as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
    except OSError:
        _drop(draft)
        raise


def write_all(fd: int, data: bytes) -> None:
    """Write all of the data to a descriptor, and wait until it is on the disk. Raises OSError."""
    while data:
        data = data[os.write(fd, data) :]
    os.fsync(fd)


def publish(draft: str, path: str) -> None:
    """Rename a draft to its final name, replacing the old file. Raises OSError; until the rename the old file stays."""
    try:
        os.rename(draft, path)
    except OSError:
        _drop(draft)
        raise
    # Without this, a power cut can still undo the rename.
    fd = os.open(os.path.dirname(path) or ".", os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


def no_room(path: str) -> str:
    """Why no file can be put on the disk of this path, or of the nearest existing folder above it; empty if it can, or
    the disk doesn't say."""
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
    # A file system that does not count its files reports 0 of 0.
    return f"the disk of {path} has no room for another file" if found.f_files and not found.f_favail else ""


def _drop(draft: str) -> None:
    with contextlib.suppress(OSError):
        os.unlink(draft)
