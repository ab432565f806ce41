"""Words: one store each, seen whole by every process."""

from __future__ import annotations

import mmap
from collections.abc import Callable

import pytest

from failstop.messages import segments
from failstop.shm.words import Word
from tests.support.children import Child

from .segments import RUN


def test_words_refuse_what_does_not_fit_and_where_they_may_not_lie(name: str) -> None:
    segments.create(name, "supervisor", RUN).close()
    word = segments.attach(name, "supervisor", RUN, write=True).word("epoch")
    for value in (1, 2**32, 2**63, 2**64 - 1, 5):
        word.set(value)
        assert segments.attach(name, "supervisor", RUN).word("epoch").get() == value
    for wrong in (-1, 2**64):
        with pytest.raises(ValueError, match="memoryview"):
            word.set(wrong)
    assert word.get() == 5
    mapped = mmap.mmap(-1, 4096)
    for offset in (8, 32, 63):
        with pytest.raises(ValueError, match="64-byte line"):
            Word(mapped, offset)
    Word(mapped, 192).set(7)
    assert mapped[184:208] == bytes([0] * 8 + [7] + [0] * 15)


def test_a_word_is_never_seen_half_written(name: str) -> None:
    segments.create(name, "supervisor", RUN).close()
    patterns = (0x5555555555555555, 0xAAAAAAAAAAAAAAAA)
    segments.attach(name, "supervisor", RUN, write=True).word("epoch").set(patterns[0])

    def work(send: Callable[[object], None], wait: object) -> None:
        word = segments.attach(name, "supervisor", RUN, write=True).word("epoch")
        send("writing")
        for _ in range(400_000):
            word.set(patterns[0])
            word.set(patterns[1])

    word = segments.attach(name, "supervisor", RUN).word("epoch")
    with Child(work) as child:
        assert child.receive() == "writing"
        seen = {word.get() for _ in range(400_000)}
        child.result()
    assert seen <= set(patterns)
    assert word.get() == patterns[1]
