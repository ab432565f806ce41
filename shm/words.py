"""Words: lone aligned u64 values, each alone in a 64-byte line, one writer each.

A store or load of one through a memoryview cast to 'Q' is a single machine access, so a reader sees the old or the new
value and nothing between. What needs more than one word to be true at once belongs in a cell. Two words may be seen in
another order than they were stored in, but for a barrier between them on both sides (barrier.py).
"""

from __future__ import annotations

LINE_BYTES = 64

TYPE_CHECKING = False
if TYPE_CHECKING:
    from mmap import mmap


class Word:
    """One u64 in shared memory."""

    __slots__ = ("_index", "_words")

    def __init__(self, mapped: mmap, offset: int) -> None:
        if offset % LINE_BYTES:
            raise ValueError(f"word at offset {offset}: not at the start of a {LINE_BYTES}-byte line")
        self._words = memoryview(mapped).cast("Q")
        self._index = offset // 8

    def get(self) -> int:
        """The value now."""
        return self._words[self._index]

    def set(self, value: int) -> None:
        """Store a value; raises ValueError outside 0..2**64-1. Only the record's declared writer may."""
        self._words[self._index] = value
