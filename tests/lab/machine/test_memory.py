"""The memory of a weak machine: two programs with Python's own modules see what AArch64 permits, and no more."""

from __future__ import annotations

import mmap
from collections.abc import Callable
from typing import Any

import pytest

from failstop_lab.machine.buffers import BUT_LAST, EARLY, LATE, REST_OF_PLACE, SAME_PLACE
from failstop_lab.machine.files import Regular
from failstop_lab.machine.loading import Loader
from failstop_lab.machine.memory import WeakMachine
from failstop_lab.machine.process import Process, Thread

PATH, A, B = "/dev/shm/both", 0, 64
CELL = slice(128, 160)
OLD, NEW = bytes(32), bytes(range(1, 33))
SECOND_NS = 1_000_000_000
Body = Callable[[Any, Any], object]


class Both:
    """Two programs that map one file. In the first a pause comes at its access of number `at`; the other waits for a
    pipe's byte, or for its time. `races`: it comes at a store, until the other looks, whose loads are early then."""

    def __init__(self, at: int, late: int = 0, early: int = 0, *, races: bool = False) -> None:
        self.machine = WeakMachine()
        self.loader = Loader(self.machine)
        self.machine.weaken(self.loader)
        file = Regular()
        file.resize(4096)
        self.machine.root.folder("/dev/shm").put("both", file)
        self._at, self._late, self._early, self._races = at, late, early, races
        self._accesses = 0

    def run(self, first: Body, second: Body) -> None:
        """`second` runs while `first` pauses, and after it where it does not."""
        processes = [
            self.machine.process("first", self._body(first)),
            self.machine.process("second", self._body(second)),
        ]
        self.machine.at_seam = self._pause
        assert self.machine.run(lambda: all(each.dead for each in processes), SECOND_NS)

    def _body(self, body: Body) -> Callable[[Process], object]:
        def run(process: Process) -> None:
            system = self.loader.system
            fd = system["os"].open(PATH, system["os"].O_RDWR)
            mapped = system["mmap"].mmap(fd, 4096, mmap.MAP_SHARED, mmap.PROT_READ)
            body(self.loader.load("failstop.shm.words"), mapped)

        return run

    def _pause(self, thread: Thread, call: str, about: Any) -> None:
        if thread.process.name == "first" and call in ("load", "store"):
            self._accesses += 1
            if self._accesses == self._at and self._races:
                self.machine.race(SECOND_NS // 10, about[0], self._early)
            elif self._accesses == self._at:
                self.machine.pause(1_000_000, self._late, self._early)


def writer_pauses(late: int, *, ordered: bool) -> tuple[int, int]:
    """A reader looks at B and then at A while the writer pauses behind its stores of A and B."""
    both, found = Both(3, late), list[int]()

    def write(words: Any, mapped: Any) -> None:
        barrier = words.Barrier()
        words.Word(mapped, A).set(1)
        if ordered:
            barrier()
        words.Word(mapped, B).set(1)
        assert words.Word(mapped, B).get() == 1

    both.run(write, lambda words, mapped: found.extend(words.Word(mapped, each).get() for each in (B, A)))
    return found[0], found[1]


def reader_pauses(early: int, *, ordered: bool) -> tuple[int, int]:
    """It looks at B and then at A, when both are stored while it pauses at B."""
    both, found = Both(1, 0, early), list[int]()

    def read(words: Any, mapped: Any) -> None:
        barrier = words.Barrier()
        found.append(words.Word(mapped, B).get())
        if ordered:
            barrier()
        found.append(words.Word(mapped, A).get())

    def write(words: Any, mapped: Any) -> None:
        words.Word(mapped, A).set(1)
        words.Word(mapped, B).set(1)

    both.run(read, write)
    return found[0], found[1]


@pytest.mark.parametrize("ordered", [False, True])
def test_a_later_store_is_seen_first_where_no_barrier_is_between(ordered: bool) -> None:
    assert ((1, 0) in {writer_pauses(late, ordered=ordered) for late in (0, *LATE)}) is not ordered


@pytest.mark.parametrize("ordered", [False, True])
def test_a_later_load_is_older_where_no_barrier_is_between(ordered: bool) -> None:
    assert ((1, 0) in {reader_pauses(early, ordered=ordered) for early in (0, *EARLY)}) is not ordered


@pytest.mark.parametrize("ordered", [False, True])
def test_who_looks_where_another_is_about_to_store_sees_it_in_another_order(ordered: bool) -> None:
    seen = set[tuple[int, int]]()
    for early in EARLY:
        both, found = Both(1, early=early, races=True), list[int]()

        def write(words: Any, mapped: Any) -> None:
            words.Word(mapped, A).set(1)
            words.Word(mapped, B).set(1)

        def read(words: Any, mapped: Any, found: list[int] = found) -> None:
            barrier = words.Barrier()
            found.append(words.Word(mapped, B).get())
            if ordered:
                barrier()
            found.append(words.Word(mapped, A).get())

        both.run(write, read)
        seen.add((found[0], found[1]))
    assert ((1, 0) in seen) is not ordered
    assert seen & {(1, 1), (0, 1)}


def test_stores_of_one_word_are_seen_in_their_order() -> None:
    for late in LATE:
        both, found = Both(3, late), list[int]()

        def write(words: Any, mapped: Any) -> None:
            for value in (1, 2):
                words.Word(mapped, A).set(value)
            assert words.Word(mapped, A).get() == 2

        def read(words: Any, mapped: Any, found: list[int] = found) -> None:
            word = words.Word(mapped, A)
            found += [word.get(), word.get()]

        both.run(write, read)
        assert found in ([0, 0], [1, 1], [2, 2])


def test_a_cell_is_torn_between_words_and_not_in_them() -> None:
    seen = set[bytes]()
    for late in LATE:
        both = Both(2, late)

        def write(words: Any, mapped: Any) -> None:
            mapped[CELL] = NEW
            words.Word(mapped, A).get()

        both.run(write, lambda words, mapped: seen.add(mapped[CELL]))
    assert seen == {OLD, NEW, NEW[:16] + OLD[16:], OLD[:16] + NEW[16:]}


def test_a_cell_is_torn_when_the_next_one_is_whole() -> None:
    seen = set[tuple[int, bytes]]()
    for late in LATE:
        both = Both(3, late)

        def write(words: Any, mapped: Any) -> None:
            mapped[CELL] = NEW
            words.Word(mapped, B).set(1)
            words.Word(mapped, A).get()

        both.run(write, lambda words, mapped: seen.add((words.Word(mapped, B).get(), mapped[CELL])))
    assert {(1, NEW[:16] + OLD[16:]), (1, OLD[:16] + NEW[16:])} <= seen


def test_who_looks_again_may_see_again_what_it_saw() -> None:
    both, found = Both(2, 0, SAME_PLACE), list[int]()

    def read(words: Any, mapped: Any) -> None:
        found.extend(words.Word(mapped, each).get() for each in (A, B, A))

    def write(words: Any, mapped: Any) -> None:
        words.Word(mapped, A).set(1)
        words.Word(mapped, B).set(1)

    both.run(read, write)
    assert found == [0, 1, 0]


def test_who_looks_again_at_a_torn_cell_may_see_it_torn_again_and_nowhere_newer() -> None:
    both, found = Both(2, 0, REST_OF_PLACE), list[bytes]()
    around = slice(CELL.start, CELL.stop + 8)

    def read(words: Any, mapped: Any) -> None:
        words.Word(mapped, A).get()
        found.extend(mapped[each] for each in (CELL, around, CELL))

    def write(words: Any, mapped: Any) -> None:
        mapped[CELL] = NEW
        mapped[slice(CELL.stop, CELL.stop + 8)] = NEW[:8]

    both.run(read, write)
    torn = NEW[:8] + OLD[8:]
    assert found == [torn, torn + NEW[:8], torn]


def test_who_has_seen_a_record_torn_looks_again_behind_a_barrier() -> None:
    """Else both of its cells could be as old as at the first look, and the older one be taken for the newest."""
    both, found = Both(5, 0, REST_OF_PLACE), list[bytes]()
    cell = both.loader.load("failstop.shm.cell")

    def record(kind: Any, mapped: Any) -> Any:
        return kind(mapped, CELL.start, 8, 2, 0)

    def read(words: Any, mapped: Any) -> None:
        writer, reader = record(cell.LatestWriter, mapped), record(cell.LatestReader, mapped)
        for value in (OLD, OLD):
            writer.write(value[:8])
        found.extend(reader.read()[2] for _ in range(2))

    def write(words: Any, mapped: Any) -> None:
        writer = record(cell.LatestWriter, mapped)
        for value in (OLD, NEW):
            writer.write(value[:8])

    both.run(read, write)
    assert found == [OLD[:8], NEW[:8]]


def test_a_wait_in_the_kernel_is_a_barrier() -> None:
    both, found = Both(3, BUT_LAST), list[int]()
    sleep = both.loader.system["time"].sleep

    def write(words: Any, mapped: Any) -> None:
        words.Word(mapped, A).set(1)
        sleep(0.001)
        words.Word(mapped, B).set(1)
        words.Word(mapped, B).get()

    def read(words: Any, mapped: Any) -> None:
        sleep(0.0015)
        found.extend(words.Word(mapped, each).get() for each in (B, A))

    both.run(write, read)
    assert found == [1, 1]


def test_what_a_process_has_stored_is_seen_when_it_dies() -> None:
    both, found = Both(2, 1), list[int]()

    def write(words: Any, mapped: Any) -> None:
        words.Word(mapped, A).set(1)
        words.Word(mapped, A).get()

    def read(words: Any, mapped: Any) -> None:
        found.append(words.Word(mapped, A).get())
        both.machine.die(next(each for each in both.machine.processes.values() if each.name == "first"), -9)
        found.append(words.Word(mapped, A).get())

    both.run(write, read)
    assert found == [0, 1]
