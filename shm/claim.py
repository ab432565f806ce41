"""Claims: locks on single bytes of a file. They show which process holds which slot. They are open-file-description
record locks.

The kernel drops a lock when its holder's last descriptor is closed, so a crash leaves no lock behind. A forked child
shares the lock until it calls exec, so the child may keep the lock after the holder has died. The content of the file
means nothing. Classic POSIX locks are not used, because a process loses them as soon as any of its code closes the same
file.
"""

from __future__ import annotations

import fcntl
import os
import struct

from failstop.files import place

_FLOCK = struct.Struct("hhqqi4x")  # l_type, l_whence, l_start, l_len, l_pid on every 64-bit Linux


def open_claims(path: str, *, create: bool = False, mode: int = 0o660, gid: int = -1) -> int:
    """Open a claim file. `create`: create the file if it does not exist, and give it the mode `mode` and the group
    `gid`. Only the service creates it. Raises OSError, for example place.Untrusted."""
    fd = place.opened(path, os.O_RDWR | (os.O_CREAT if create else 0))
    if create:
        if gid >= 0:
            os.fchown(fd, -1, gid)
        os.fchmod(fd, mode)
    return fd


def acquire(fd: int, index: int) -> bool:
    """Claim the byte `index`. The claim lasts as long as `fd` stays open. Returns False if the byte is already claimed
    through a descriptor from a different open()."""
    try:
        fcntl.fcntl(fd, fcntl.F_OFD_SETLK, _FLOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, index, 1, 0))
    except (BlockingIOError, PermissionError):
        return False
    return True


def release(fd: int, index: int) -> None:
    """Give up the claim of the byte `index`. The descriptor stays open."""
    fcntl.fcntl(fd, fcntl.F_OFD_SETLK, _FLOCK.pack(fcntl.F_UNLCK, os.SEEK_SET, index, 1, 0))


def held(fd: int, index: int, *, by_writer: bool = False) -> bool:
    """True if the byte `index` is claimed through a descriptor other than `fd`. `by_writer`: count only holders that
    may write the file. `fd` itself may be read-only."""
    asked = fcntl.F_RDLCK if by_writer else fcntl.F_WRLCK
    answer = fcntl.fcntl(fd, fcntl.F_OFD_GETLK, _FLOCK.pack(asked, os.SEEK_SET, index, 1, 0))
    return bool(_FLOCK.unpack(answer)[0] != fcntl.F_UNLCK)
