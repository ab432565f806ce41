"""Robust futexes: the earliest way to learn from the kernel that a process has died.

A thread can give the kernel a list of words in shared memory (its robust list). Each word holds the thread's id. When
the thread dies, the kernel marks the words, and wakes one waiting thread per word. After that the kernel frees the
process's memory, which takes 2 ms for 10 MB or 45 ms for 500 MB. A pidfd, the end of a pipe, the release of a lock and
SIGCHLD all report the death only after the memory is freed.

The kernel wakes only one thread per word, so each watching process has its own word. A watcher never writes to the
word. If the robust futex does not report a death, the pidfd still does (lifeline.py).

This file gives the kernel a list of its own. The C library's robust mutexes are not used, because only the thread that
has locked such a mutex may unlock it. Here, any thread of the process may clear the word.

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

from failstop.shm import owned
from failstop.shm.words import LINE_BYTES

PER_BLOCK = 2
BLOCKS = 256
"""The number of blocks of futexes. Each started process gets one block, which has a line for each watching process. A
block is used again only after about 250 other starts."""

_OWNER_DIED = 1 << 30
_WAITERS = 1 << 31  # without this bit, the kernel marks the word but wakes nobody
_OWNER = _OWNER_DIED - 1
_WAIT, _WAKE = 0, 1
_FUTEX, _SET_ROBUST_LIST = {"x86_64": (202, 273), "aarch64": (98, 99)}.get(os.uname().machine, (-1, -1))
_PROOF_NS = 1_000_000_000
_LOOK_S = 0.0001
NO_DUMP = 1
"""The size limit for core dumps, bytes. No dump fits into 1 byte. The limit is not 0, because the kernel ignores a
limit of 0 if a program collects the dumps (core(5))."""
_LIST_HEAD = struct.Struct("<QqQ")  # robust_list_head: first entry, offset from an entry to its word, entry being added
_POINTER = struct.Struct("<Q")

_libc = ctypes.CDLL(None, use_errno=True)
_libc.mmap.restype = ctypes.c_void_p
_libc.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_long]
_libc.munmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t]


class Futex:
    """A futex: the word at the start of a 64-byte line of a file. One thread can hold several futexes at once if their
    lines follow each other.

    Only the kernel uses the mapping of the file. So a client that truncates the file can't kill this process by a
    SIGBUS.
    """

    def __init__(self, fd: int, offset: int, *, write: bool) -> None:
        """Map the page that contains the futex and all its lines. While a thread waits on the futex, the caller must
        keep `fd` open. Raises OSError."""
        self._fd = fd
        self._own: owned.Inode | None = None
        """The file behind `_fd` if this object has to close it, and otherwise None."""
        self._offset = offset
        start = offset // mmap.PAGESIZE * mmap.PAGESIZE
        access = mmap.PROT_READ | (mmap.PROT_WRITE if write else 0)
        self._page = _libc.mmap(None, mmap.PAGESIZE, access, mmap.MAP_SHARED, fd, start)
        if self._page == ctypes.c_void_p(-1).value:
            raise OSError(ctypes.get_errno(), "a futex can't be mapped")
        self._address = self._page + offset - start

    def detach(self) -> None:
        """Duplicate the descriptor of the file, so that the caller may close `fd` at any time. Without the duplicate,
        another file could get the number of the closed `fd`, and a thread that is about to hold this futex would write
        to that file. Call this at most once. Raises OSError."""
        self._fd = os.dup(self._fd)
        self._own = owned.inode_of(self._fd)

    def _value(self) -> int:
        try:
            return int.from_bytes(os.pread(self._fd, 4, self._offset), "little")
        except OSError:  # closed by a caller that no longer waits for the death
            return 0

    def hold(self, lines: int = 1) -> object:
        """Let the calling thread hold `lines` futexes: this one, and those in the lines after it. When the thread dies,
        the kernel marks all of them. Keep the returned object until the thread ends or calls let_go(), because the
        kernel uses its memory. Returns None if the kernel can't report deaths. Raises OSError."""
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
        """True after the thread that held the futex has died and the kernel has marked the futex."""
        return bool(self._value() & _OWNER_DIED)

    def wait_for_death(self, wanted: Callable[[], bool] = lambda: True) -> bool:
        """Block until the thread that holds the futex has died. Returns False if no thread holds the futex, if the
        holder lets go of it, or if `wanted` returns False. `wanted` is called first, and again after each wake(). Other
        threads keep running."""
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
        """Wake all threads that wait for the holder's death, so that each one calls its `wanted` again."""
        _libc.syscall(_FUTEX, ctypes.c_void_p(self._address), _WAKE, ctypes.c_int(1 << 30))

    def close(self) -> None:
        """Unmap the page. Call it when no thread of this process holds the futex or waits for it."""
        _libc.munmap(self._page, mmap.PAGESIZE)
        owned.close(self._fd, self._own)


_NOTHING = ctypes.create_string_buffer(_LIST_HEAD.size)
"""An empty robust list: its head points to itself."""
_NOTHING.raw = _LIST_HEAD.pack(ctypes.addressof(_NOTHING), 0, 0)


def let_go() -> None:
    """Stop reporting the death of the calling thread."""
    _libc.syscall(_SET_ROBUST_LIST, _NOTHING, _LIST_HEAD.size)


def leave_no_dump() -> None:
    """Disable core dumps for this process. Writing a dump would delay the report of its death."""
    _, hard = resource.getrlimit(resource.RLIMIT_CORE)
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_CORE, (min(hard, NO_DUMP) if hard >= 0 else NO_DUMP, hard))


def proven() -> bool:
    """Test whether this kernel reports deaths through robust futexes. The test starts a thread that holds a futex and
    ends, and takes 0.2 ms. gVisor and qemu's user mode run Linux programs, but report no deaths this way."""
    fd = os.memfd_create("proof")
    word = None
    kept: list[object] = []  # what hold() returned in the thread; None if the kernel refused
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
    """Hold the futex, then end while still holding it. The test thread of proven() runs this."""
    try:
        kept.append(word.hold())
    except Exception:  # set after any error too, because proven() waits for it
        kept.append(None)
