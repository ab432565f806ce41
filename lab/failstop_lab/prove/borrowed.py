"""Borrowed: the port of a process that is frozen, through a descriptor of its own.

The port is the service's alone (TIOCEXCL), and another opening would raise the modem lines, which resets some boards. A
duplicate of the descriptor changes nothing: whatever is read through it was sent while everybody else stood.
"""

from __future__ import annotations

import ctypes
import errno
import os

_PIDFD_GETFD = 438
"""Its number is the same on every machine; Linux 5.6."""
_libc = ctypes.CDLL(None, use_errno=True)


def port_of(pid: int, device: str) -> int:
    """A duplicate of the descriptor by which this process has the device open; the caller closes it. Raises OSError: it
    has none, or the kernel does not give it (another user's process, a kernel older than 5.6)."""
    where, folder = os.path.realpath(device), f"/proc/{pid}/fd"
    for name in os.listdir(folder):
        if os.path.realpath(os.path.join(folder, name)) == where:
            return _duplicate(pid, int(name))
    raise OSError(errno.ENOENT, os.strerror(errno.ENOENT), device)


def _duplicate(pid: int, fd: int) -> int:
    process = os.pidfd_open(pid)
    try:
        found = int(_libc.syscall(_PIDFD_GETFD, process, fd, 0))
    finally:
        os.close(process)
    if found < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return found
