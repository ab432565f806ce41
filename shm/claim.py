"""Claims: locks on single bytes of a file (open-file-description record locks), which show who holds what.

The kernel drops such a lock when the last descriptor of its holder is closed, so a crash leaves none behind. A forked
copy of the holder that has not called exec has the lock too, and may outlive the holder. The content of the file means
nothing. If a thread or a library opens and closes the same file, the lock is not lost, as it would be with classic
POSIX locks.
"""

from __future__ import annotations

import fcntl
import os
import struct

from failstop.files import place

_FLOCK = struct.Struct("hhqqi4x")  # l_type, l_whence, l_start, l_len, l_pid on every 64-bit Linux


def open_claims(path: str, *, create: bool = False, mode: int = 0o660, gid: int = -1) -> int:
    """Open a claim file; the service creates it. Raises OSError, place.Untrusted among them."""
    fd = place.opened(path, os.O_RDWR | (os.O_CREAT if create else 0))
    if create:
        if gid >= 0:
            os.fchown(fd, -1, gid)
        os.fchmod(fd, mode)
    return fd


def acquire(fd: int, index: int) -> bool:
    """Claim byte `index` for as long as `fd` stays open; False if another holder has it."""
    try:
        fcntl.fcntl(fd, fcntl.F_OFD_SETLK, _FLOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, index, 1, 0))
    except (BlockingIOError, PermissionError):
        return False
    return True


def release(fd: int, index: int) -> None:
    """Give a claim back while the descriptor stays open."""
    fcntl.fcntl(fd, fcntl.F_OFD_SETLK, _FLOCK.pack(fcntl.F_UNLCK, os.SEEK_SET, index, 1, 0))


def held(fd: int, index: int, *, by_writer: bool = False) -> bool:
    """True if another holder has claimed it; `by_writer`: count only holders that may write the file. A read-only
    descriptor is enough."""
    asked = fcntl.F_RDLCK if by_writer else fcntl.F_WRLCK
    answer = fcntl.fcntl(fd, fcntl.F_OFD_GETLK, _FLOCK.pack(asked, os.SEEK_SET, index, 1, 0))
    return bool(_FLOCK.unpack(answer)[0] != fcntl.F_UNLCK)
