"""Robust mutexes in shared memory: the kernel's earliest word of a death.

A process that dies is marked in the robust mutexes it holds before its memory is torn down; a pidfd, a pipe's end or
SIGCHLD follow only after. Each watched process locks mutexes of its own once, at its start, and holds them for life,
one for each watcher, since a death wakes only one waiter of each.

This is memory that several processes of the service write, and the only such; it holds no record, and nobody but the
service's user can open it. The late word (lifeline.py) does not depend on it.
"""

from __future__ import annotations

import ctypes
import errno

MUTEX_BYTES = 64
"""More than pthread_mutex_t takes on any 64-bit Linux (40 on x86-64, 48 on aarch64)."""
PER_BLOCK = 2
BLOCKS = 256
"""A block for each start of a process; used again only when 255 later ones have been started."""

_PTHREAD_PROCESS_SHARED = 1
_PTHREAD_MUTEX_ROBUST = 1

TYPE_CHECKING = False
if TYPE_CHECKING:
    from mmap import mmap

_libc = ctypes.CDLL(None)
_held: list[object] = []  # at a death the kernel looks into these mutexes: their memory must still be mapped


class Mutexes:
    """The service's mutexes, by block (one a started process) and index (one a watcher)."""

    __slots__ = ("_address", "_pinned")

    def __init__(self, mapped: mmap, offset: int) -> None:
        self._pinned = ctypes.c_char.from_buffer(mapped, offset)
        self._address = ctypes.addressof(self._pinned)

    def _at(self, block: int, index: int) -> ctypes.c_void_p:
        if not (0 <= block < BLOCKS and 0 <= index < PER_BLOCK):
            raise IndexError(f"mutex {block}.{index}: there are {BLOCKS} blocks of {PER_BLOCK}")
        return ctypes.c_void_p(self._address + (block * PER_BLOCK + index) * MUTEX_BYTES)

    def prepare(self, block: int) -> None:
        """Make a block's mutexes anew, for a process that is about to be started. The supervisor only."""
        attributes = (ctypes.c_char * MUTEX_BYTES)()
        _libc.pthread_mutexattr_init(attributes)
        _libc.pthread_mutexattr_setpshared(attributes, _PTHREAD_PROCESS_SHARED)
        _libc.pthread_mutexattr_setrobust(attributes, _PTHREAD_MUTEX_ROBUST)
        for index in range(PER_BLOCK):
            ctypes.memset(self._at(block, index), 0, MUTEX_BYTES)
            _libc.pthread_mutex_init(self._at(block, index), attributes)
        _libc.pthread_mutexattr_destroy(attributes)

    def hold(self, block: int) -> None:
        """Lock a block for the life of this process. From its main thread, once, at its start."""
        _held.append(self._pinned)
        for index in range(PER_BLOCK):
            _libc.pthread_mutex_trylock(self._at(block, index))

    def wait_for_death(self, block: int, index: int) -> bool:
        """Block until the holder has died; False when nobody held it. Lets other threads run meanwhile."""
        result: int = _libc.pthread_mutex_lock(self._at(block, index))
        if result == 0:
            _libc.pthread_mutex_unlock(self._at(block, index))
        return result == errno.EOWNERDEAD
