"""Robust futexes: the kernel's earliest news of a death.

A robust list names words of shared memory that hold the number of a thread. When the thread dies, the kernel marks the
words and wakes one waiter for each. Only then does it free the process's memory, which a pidfd, a pipe's end, the
release of a lock and SIGCHLD all wait for: 2 ms for 10 MB, 45 ms for 500 MB. Because one waiter is woken, each word has
one watcher. A watcher changes nothing, and the late news (lifeline.py) does not depend on this.

The list is the thread's own and not the C library's, because with that one only the thread that locked a mutex may
unlock it.

Source: Linux, Documentation/locking/robust-futex-ABI.rst; set_robust_list(2), futex(2).
"""

from __future__ import annotations

import _thread
import contextlib
import ctypes
import errno
import mmap
import os
import resource
import struct
from collections.abc import Callable
from time import monotonic_ns, sleep

from failstop.shm.words import LINE_BYTES

PER_BLOCK = 2
BLOCKS = 256
"""The number of blocks. Each start of a process uses one, with a line for each watcher, and a block is used again after
255 later starts."""

_OWNER_DIED = 1 << 30
_WAITERS = 1 << 31  # without this bit, the kernel marks the word but wakes nobody
_OWNER = _OWNER_DIED - 1
_WAIT, _WAKE = 0, 1
_FUTEX, _SET_ROBUST_LIST = {"x86_64": (202, 273), "aarch64": (98, 99)}.get(os.uname().machine, (-1, -1))
_PROOF_NS = 1_000_000_000
_LOOK_S = 0.0001
NO_DUMP = 1
"""The limit for core dumps, bytes. No dump fits into 1 byte. The kernel would ignore 0 if a program collects the dumps
(core(5))."""
_LIST_HEAD = struct.Struct("<QqQ")  # robust_list_head: first entry, offset from an entry to its word, entry being added
_POINTER = struct.Struct("<Q")

_libc = ctypes.CDLL(None, use_errno=True)
_libc.mmap.restype = ctypes.c_void_p
_libc.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_long]
_libc.munmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t]


class Futex:
    """The word at the start of a line of a file, and the lines after it that belong together.

    Only the kernel reaches it through the mapping, so a truncated file causes no SIGBUS.
    """

    def __init__(self, fd: int, offset: int, *, write: bool) -> None:
        """Map the page that has all the lines. A thread that waits needs the caller's descriptor to stay open. Raises
        OSError."""
        self._fd = fd
        self._owned = False
        self._offset = offset
        start = offset // mmap.PAGESIZE * mmap.PAGESIZE
        access = mmap.PROT_READ | (mmap.PROT_WRITE if write else 0)
        self._page = _libc.mmap(None, mmap.PAGESIZE, access, mmap.MAP_SHARED, fd, start)
        if self._page == ctypes.c_void_p(-1).value:
            raise OSError(ctypes.get_errno(), "a futex can't be mapped")
        self._address = self._page + offset - start

    def detach(self) -> None:
        """Duplicate the descriptor, once. Otherwise, when the caller closes its own, a thread that is about to hold
        this futex could write to the next file that gets the number. Raises OSError."""
        self._fd = os.dup(self._fd)
        self._owned = True

    def _value(self) -> int:
        try:
            return int.from_bytes(os.pread(self._fd, 4, self._offset), "little")
        except OSError:  # closed by a caller that no longer wants the news
            return 0

    def hold(self, lines: int = 1) -> object:
        """Let the kernel report the death of the calling thread on this many lines. Returns an object that must be kept
        for as long as the thread lives, or until let_go(); None if the kernel can't do it. Raises OSError."""
        kept = ctypes.create_string_buffer(_LIST_HEAD.size + lines * LINE_BYTES)
        head = ctypes.addressof(kept)
        entries = [head + _LIST_HEAD.size + line * LINE_BYTES for line in range(lines)]
        following = [_POINTER.pack(entry).ljust(LINE_BYTES, b"\0") for entry in (*entries[1:], head)]
        kept.raw = _LIST_HEAD.pack(entries[0], self._address - entries[0], 0) + b"".join(following)
        if _libc.syscall(_SET_ROBUST_LIST, kept, _LIST_HEAD.size):
            return None
        word = (_thread.get_native_id() | _WAITERS).to_bytes(4, "little")
        try:
            for line in range(lines):
                os.pwrite(self._fd, word, self._offset + line * LINE_BYTES)
        except OSError:
            let_go()
            raise
        return kept

    def held(self) -> bool:
        """True while a living thread holds the futex."""
        return bool(self._value() & _OWNER)

    def owner_died(self) -> bool:
        """True after the kernel has reported that the thread which held the futex has died."""
        return bool(self._value() & _OWNER_DIED)

    def wait_for_death(self, wanted: Callable[[], bool] = lambda: True) -> bool:
        """Block until the thread that holds the futex has died. Returns False if no thread holds it, if it was given
        back, or once it is no longer `wanted` (wake() makes it look). Other threads run meanwhile."""
        value = held = self._value()
        while wanted():
            if value != held or not held & _OWNER:
                return bool(value & _OWNER_DIED)
            failed = _libc.syscall(_FUTEX, ctypes.c_void_p(self._address), _WAIT, ctypes.c_uint(held), None)
            if failed and ctypes.get_errno() not in (errno.EAGAIN, errno.EINTR):
                return False
            value = self._value()
        # The kernel wakes one waiter; if it woke this stale one, pass the wake-up on.
        self.wake()
        return False

    def wake(self) -> None:
        """Make the waiting threads look again."""
        _libc.syscall(_FUTEX, ctypes.c_void_p(self._address), _WAKE, ctypes.c_int(1 << 30))

    def close(self) -> None:
        """Unmap it. Call it once no thread of this process holds it or waits for it."""
        _libc.munmap(self._page, mmap.PAGESIZE)
        if self._owned:
            os.close(self._fd)


_NOTHING = ctypes.create_string_buffer(_LIST_HEAD.size)
"""The empty list. Its first entry points to itself."""
_NOTHING.raw = _LIST_HEAD.pack(ctypes.addressof(_NOTHING), 0, 0)


def let_go() -> None:
    """Stop reporting the death of the calling thread."""
    _libc.syscall(_SET_ROBUST_LIST, _NOTHING, _LIST_HEAD.size)


def leave_no_dump() -> None:
    """Allow this process no dump when it crashes, because a dying process keeps the futexes that report its death until
    its dump is written."""
    _, hard = resource.getrlimit(resource.RLIMIT_CORE)
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_CORE, (min(hard, NO_DUMP) if hard >= 0 else NO_DUMP, hard))


def proven() -> bool:
    """Test whether this kernel reports deaths at all, with a thread that holds its own word and ends. Some systems that
    run Linux programs don't (gVisor, qemu's user mode). Takes 0.2 ms."""
    fd = os.memfd_create("proof")
    word = None
    kept: list[object] = []  # memory that the kernel looks into; None: it refused
    try:
        os.ftruncate(fd, mmap.PAGESIZE)
        word = Futex(fd, 0, write=True)
        _thread.start_new_thread(_hold_until_the_end, (word, kept))
        while not kept:  # until then the thread holds the word
            sleep(_LOOK_S)
        until_ns = monotonic_ns() + _PROOF_NS
        while not word.owner_died() and kept != [None] and monotonic_ns() < until_ns:
            sleep(_LOOK_S)
        return word.owner_died()
    except (OSError, RuntimeError):
        return False
    finally:
        if word:
            word.close()
        os.close(fd)


def _hold_until_the_end(word: Futex, kept: list[object]) -> None:
    """What the thread does: it holds the word and ends."""
    try:
        kept.append(word.hold())
    except Exception:  # set after any error too, because proven() waits for it
        kept.append(None)
