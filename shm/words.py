"""Words: single aligned u64 values, each alone in a 64-byte line with one writer; and the barrier that orders them.

A store or load through a memoryview cast to 'Q' is a single machine access, so a reader sees the old or the new value
and nothing between. Values that must be true together belong in a cell. Two words may be seen in another order than
they were stored in, unless both sides have a barrier between them.
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
        """Store a value. Only the record's declared writer may do this. Raises ValueError outside 0..2**64-1."""
        self._words[self._index] = value


class Barrier:
    """A full memory fence: every other thread sees the loads and stores that this thread made before it ahead of those
    made after it. Only one thread may call it. Takes 0.2 us, and no memory.

    Words and cells are plain loads and stores, which AArch64 may reorder; x86-64 lets a load pass an earlier store. No
    library gives Python a fence. But releasing a lock is a store-release and acquiring one is a load-acquire, and no
    load-acquire passes an earlier store-release. So a held lock is released and acquired again. Acquiring and then
    releasing would be no barrier: accesses before it could move behind the acquire, and accesses after it could move
    before the release.

    model/aarch64 names the pairs that need one, and has each as a litmus test.
    """

    def __init__(self) -> None:
        lock = _thread.allocate_lock()
        lock.acquire()
        self._acquire = lock.acquire
        self._release = lock.release

    def __call__(self) -> None:
        self._release()
        self._acquire()
