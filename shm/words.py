"""Words and barriers. A word is a single aligned u64 value, alone in a 64-byte line, with one writer. A barrier orders
accesses to words and cells.

Loading or storing a word (through a memoryview cast to 'Q') is a single machine access, so a reader sees either the old
or the new value and never a mixture. Put values that must be true together in a cell. A reader may see two words change
in a different order than they were stored, unless both the writer and the reader have a barrier between their two
accesses.
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
        """Store a value. Only the word's declared writer may do this. Raises ValueError outside 0..2**64-1."""
        self._words[self._index] = value


class Barrier:
    """A full memory fence. Other threads see this thread's loads and stores from before the barrier before they see
    those from after it. Each thread needs a barrier of its own. A call takes 0.2 us and no memory.

    It is needed because words and cells are plain loads and stores. AArch64 may reorder them, and x86-64 lets a load
    pass an earlier store. No library gives Python a fence, so this class makes one from a lock. Releasing a lock is a
    store-release, acquiring it is a load-acquire, and no load-acquire passes an earlier store-release. So the barrier
    releases and acquires a lock that it holds. The other order (acquire, then release) would be no barrier: accesses
    before it could move behind the acquire, and accesses after it could move before the release.

    model/aarch64 lists the pairs of accesses that need a barrier, with a litmus test for each.
    """

    def __init__(self) -> None:
        lock = _thread.allocate_lock()
        lock.acquire()
        self._acquire = lock.acquire
        self._release = lock.release

    def __call__(self) -> None:
        self._release()
        self._acquire()
