"""Words and barriers. A word is one aligned u64 value with one writer, alone in a 64-byte line. A barrier keeps loads
and stores of words and cells in order.

A load or store of a word (through a memoryview cast to 'Q') is a single machine access, so a reader never sees a
mixture of two values. Put values that belong together in one cell, not in several words. A reader may see the second of
two stores before the first. To prevent this, the writer must pass a barrier between its two stores, and the reader must
pass one between its two loads.
"""

from __future__ import annotations

import _thread
from mmap import mmap

LINE_BYTES = 64


class Word:
    def __init__(self, mapped: mmap, offset: int) -> None:
        if offset % LINE_BYTES:
            raise ValueError(f"word at offset {offset}: not at the start of a {LINE_BYTES}-byte line")
        self._words = memoryview(mapped).cast("Q")
        self._index = offset // 8

    def get(self) -> int:
        return self._words[self._index]

    def set(self, value: int) -> None:
        """Store a value. Only the word's one writer (messages/layout.py) may call this. Raises ValueError outside
        0..2**64-1."""
        self._words[self._index] = value


class Barrier:
    """A full memory fence. For all other threads, this thread's loads and stores before a call happen before those
    after the call. Each thread needs its own Barrier object. A call takes 0.2 us and no memory.

    Words and cells are read and written with plain loads and stores. AArch64 may reorder these, and x86-64 lets a load
    pass an earlier store. No library gives Python a fence, so this class makes one from a lock, which it always holds.
    A call releases the lock (a store-release) and acquires it again (a load-acquire), and no load-acquire passes an
    earlier store-release. If a call first acquired a lock and then released it, it would be no barrier: accesses from
    before and after the call could move between the acquire and the release.

    The folder model/aarch64 lists the pairs of accesses that need a barrier, with a litmus test for each.
    """

    def __init__(self) -> None:
        lock = _thread.allocate_lock()
        lock.acquire()
        self._acquire = lock.acquire
        self._release = lock.release

    def __call__(self) -> None:
        self._release()
        self._acquire()
