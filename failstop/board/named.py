"""Named: opens a serial port whose path another user has named, with no more than that user's rights.

A user's file may name any path: one of root's own devices, a device that reacts to being opened, or a file system that
never answers. So root looks up the path with that user's rights, and accepts only a terminal that this user may read
and write. Root then opens exactly this device as root. Only root can open a port that a service holds exclusively, and
a stop must still be written to such a port.
"""

from __future__ import annotations

import errno
import os
import stat

_PTS = range(136, 144)
_BY_NUMBER = (4, 166, 188, 204, *_PTS)
"""The major numbers of terminals: UARTs, USB ports, the Pi's serial pins, and ptys. They are used if the system does
not name the class of a device."""
_NO_BOARD = 5
"""The major number of /dev/tty, /dev/console and /dev/ptmx, which are never a board."""
PASSWD_FILE, GROUP_FILE = "/etc/passwd", "/etc/group"


def open_named(path: str, uid: int, flags: int) -> int:
    """Open a terminal that the user `uid` may read and write, and return its descriptor. Only root can call this.
    Raises OSError."""
    gid, groups = _groups(uid)
    before = os.getegid(), os.getgroups()
    os.setgroups(groups)
    os.setegid(gid)
    os.seteuid(uid)
    try:
        node = os.open(path, os.O_PATH | os.O_CLOEXEC)
    finally:
        os.seteuid(0)
        os.setegid(before[0])
        os.setgroups(before[1])
    try:
        found = os.fstat(node)
        if not stat.S_ISCHR(found.st_mode) or not _is_terminal(found.st_rdev):
            raise OSError(errno.ENOTTY, os.strerror(errno.ENOTTY), path)
        if not _may(found, uid, {gid, *groups}):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), path)
        return os.open(f"/proc/self/fd/{node}", flags)
    finally:
        os.close(node)


def _is_terminal(device: int) -> bool:
    number = os.major(device)
    if number in _PTS or number == _NO_BOARD:
        return number != _NO_BOARD
    try:
        return os.path.basename(os.readlink(f"/sys/dev/char/{number}:{os.minor(device)}/subsystem")) == "tty"
    except OSError:
        return number in _BY_NUMBER


def _may(found: os.stat_result, uid: int, groups: set[int]) -> bool:
    """True if the mode of a device lets this user read and write it."""
    shift = 6 if found.st_uid == uid else 3 if found.st_gid in groups else 0
    return found.st_mode >> shift & 0o6 == 0o6


def _groups(uid: int) -> tuple[int, list[int]]:
    """Return the user's main group, and the ids of the user's other groups. This reads only files, because a directory
    service that does not answer must not delay a stop."""
    name, gid = "", 65534
    for fields in _rows(PASSWD_FILE, 4):
        if fields[2] == str(uid):
            name, gid = fields[0], int(fields[3])
            break
    return gid, [int(fields[2]) for fields in _rows(GROUP_FILE, 4) if name and name in fields[3].split(",")]


def _rows(path: str, least: int) -> list[list[str]]:
    try:
        with open(path, encoding="utf-8", errors="replace") as file:
            rows = [line.rstrip("\n").split(":") for line in file]
    except OSError:
        return []
    return [row for row in rows if len(row) >= least and row[2].isdigit()]
