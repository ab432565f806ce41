"""Robust futexes: what the kernel tells of a thread's end, and whom it wakes."""

from __future__ import annotations

import ctypes
import os
import resource
import struct
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from failstop.messages import segments
from failstop.shm import futex
from failstop.shm.futex import BLOCKS, PER_BLOCK, Futex
from failstop.shm.lifeline import Lifeline
from failstop.shm.segment import Segment
from tests.support.children import NOBODY, Child, call, needs_root
from tests.support.waiting import until

from .dying import Send, Wait, asleep, holding, lifelines

OWNER_DIED = 1 << 30
GET_ROBUST_LIST = {"x86_64": 274, "aarch64": 100}.get(os.uname().machine, -1)


def held_by_thread(lines: Segment, line: int = 0) -> Callable[[], None]:
    """A thread holds this line until what is returned is called."""
    let_go, ready = threading.Event(), threading.Event()

    def work() -> None:
        kept = lines.futex("held", line, write=True).hold()
        ready.set()
        let_go.wait()
        futex.let_go()
        del kept

    thread = threading.Thread(target=work)
    thread.start()
    ready.wait()
    return lambda: (let_go.set(), thread.join())[1]


@pytest.mark.parametrize("line", [-1, BLOCKS * PER_BLOCK])
def test_there_is_no_line_beyond_the_record(lines: Segment, line: int) -> None:
    with pytest.raises(IndexError, match=rf"held has {BLOCKS * PER_BLOCK} lines, none is {line}$"):
        lines.futex("held", line)


def test_a_futex_needs_the_file(lines: Segment) -> None:
    lines.close()
    with pytest.raises(TypeError, match="needs the file"):
        lines.futex("held")


def test_the_end_of_a_thread_is_told_on_each_of_its_lines_and_on_no_other(lines: Segment) -> None:
    first = (BLOCKS - 2) * PER_BLOCK  # not in the file's first page
    word = lines.futex("held", first, write=True)
    kept: list[object] = []
    thread = threading.Thread(target=lambda: kept.append(word.hold(PER_BLOCK)))
    thread.start()
    thread.join()
    each = [lines.futex("held", line) for line in range(first - 1, first + PER_BLOCK + 1)]
    until(lambda: not any(line.held() for line in each), "the kernel has marked them")
    assert [line.wait_for_death() for line in each] == [False, *[True] * PER_BLOCK, False]
    assert kept != [None]


def test_a_futex_is_mapped_until_it_is_closed_and_for_writing_only_by_who_holds_it(name: str, lines: Segment) -> None:
    def mapped() -> list[str]:
        maps = Path("/proc/self/maps").read_text().splitlines()
        return [line.split()[1] for line in maps if line.endswith(segments.path_of(name, "lifelines"))]

    watching, holding = lines.futex("held"), lines.futex("held", write=True)
    assert sorted(mapped()) == ["r--s", "rw-s"]
    holding.close()
    assert mapped() == ["r--s"]
    watching.close()
    assert mapped() == []


def test_what_can_not_be_mapped_is_an_error(name: str, lines: Segment) -> None:
    with open(segments.path_of(name, "lifelines"), "rb") as file:
        Futex(file.fileno(), 0, write=False).close()
        with pytest.raises(PermissionError, match="a futex can't be mapped"):
            Futex(file.fileno(), 0, write=True)


def test_a_file_that_was_closed_meanwhile_holds_nothing(lines: Segment) -> None:
    let_go, word = held_by_thread(lines), lines.futex("held")
    assert word.held(), "without a number the first line is meant"
    lines.close()
    assert not word.held()
    assert word.wait_for_death() is False
    let_go()


@pytest.mark.parametrize("happens", ["death", "cut"])
def test_what_happens_between_the_look_and_the_wait_is_seen(name: str, lines: Segment, happens: str) -> None:
    """A death; or the file is cut, which is nobody's death."""
    let_go, word, at = held_by_thread(lines), lines.futex("held"), lines.spec.offsets["held"]
    looks: list[bool] = []

    def wanted() -> bool:
        if not looks and happens == "death":
            value = int.from_bytes(os.pread(lines.fileno(), 4, at), "little") | OWNER_DIED
            os.pwrite(lines.fileno(), value.to_bytes(4, "little"), at)
        elif not looks:
            os.truncate(segments.path_of(name, "lifelines"), 0)
        looks.append(True)
        return True

    assert word.wait_for_death(wanted) is (happens == "death")
    assert word.owner_died() is (happens == "death")
    let_go()


def test_a_truncated_file_is_nobody_s_death(name: str, lines: Segment) -> None:
    """A client may cut its own slot; nobody gets a SIGBUS for it."""
    word = lines.futex("held", 40)
    with holding(name, 20):
        os.truncate(segments.path_of(name, "lifelines"), 0)
        assert word.wait_for_death() is False
        assert not word.held()


class Waiter(threading.Thread):
    """One that waits for a death, as long as it is wanted."""

    def __init__(self, word: Futex) -> None:
        super().__init__(daemon=True)
        self.word = word
        self.wanted = True
        self.told: bool | None = None
        self.start()
        until(lambda: asleep(self.native_id or 0), "its sleep")

    def run(self) -> None:
        self.told = self.word.wait_for_death(lambda: self.wanted)


def test_one_that_has_missed_its_call_takes_the_news_from_nobody(name: str, lines: Segment) -> None:
    """The kernel wakes one alone, who has waited for longest."""
    with holding(name, 5) as holder:
        left = Waiter(lines.futex("held", 5 * PER_BLOCK))
        left.wanted = False
        other = Waiter(lines.futex("held", 5 * PER_BLOCK))
        holder.kill()
        until(lambda: not other.is_alive(), "the news")
        assert other.told is True
        until(lambda: not left.is_alive(), "its end")
        assert left.told is False


def test_who_waits_sleeps(lines: Segment) -> None:
    let_go = held_by_thread(lines)
    waiter = Waiter(lines.futex("held"))
    clock = time.pthread_getcpuclockid(waiter.ident)  # type: ignore[arg-type]
    before_s, until_ns = time.clock_gettime(clock), time.monotonic_ns() + 200_000_000
    until(lambda: time.monotonic_ns() >= until_ns, "the time to have passed")
    assert time.clock_gettime(clock) - before_s < 0.01
    waiter.wanted = False
    until(lambda: waiter.word.wake() or not waiter.is_alive(), "its end")
    let_go()


def test_a_large_process_is_known_to_be_dead_before_its_memory_is_gone(name: str, lines: Segment) -> None:
    """The pidfd waits for the memory. This process may be held up longer than that takes: then it tries again."""

    def large(send: Send, wait: Wait) -> None:
        memory = bytearray(os.urandom(1 << 20)) * 200
        kept = lifelines(name).futex("held", 30, write=True).hold()
        send("here")
        wait()
        del kept, memory

    first = False
    for _ in range(10):
        with Child(large) as child:
            assert child.receive() == "here"
            life = Lifeline(child.pid)
            child_dies = lines.futex("held", 30)
            os.kill(child.pid, 9)
            assert child_dies.wait_for_death()
            first = first or not life.dead()
            life.close()
        if first:
            return
    pytest.fail("the pidfd came first ten times")


def test_where_the_kernel_can_t_nothing_is_held_or_proven(lines: Segment, monkeypatch: pytest.MonkeyPatch) -> None:
    """As under qemu's user mode, which has no robust lists."""
    assert futex.proven()
    monkeypatch.setattr(futex, "_SET_ROBUST_LIST", -1)
    word = lines.futex("held", 50, write=True)
    assert word.hold() is None
    assert not word.held()
    assert not futex.proven()


@pytest.mark.parametrize("looks", [3, 1 << 30])
def test_a_kernel_that_tells_late_is_proven_and_a_mute_one_is_not(monkeypatch: pytest.MonkeyPatch, looks: int) -> None:
    """The last as gVisor's, which takes the list and marks nothing: it is waited for for a second."""
    owner_died = Futex.owner_died
    seen: list[bool] = []

    def look(word: Futex) -> bool:
        seen.append(len(seen) >= looks and owner_died(word))
        return seen[-1]

    monkeypatch.setattr(Futex, "owner_died", look)
    before = time.monotonic()
    assert futex.proven() is (looks == 3)
    assert seen[:3] == [False] * 3
    assert looks == 3 or 1 <= time.monotonic() - before < 20


@pytest.mark.parametrize("refused", [False, True])
def test_the_proof_is_over_when_its_thread_is(monkeypatch: pytest.MonkeyPatch, refused: bool) -> None:
    """However late that runs: it would write to a descriptor that is somebody else's by then."""
    ran: list[object] = []
    hold, run = Futex.hold, threading.Event()

    def late(word: Futex) -> object:
        run.wait()
        ran.append(None if refused else hold(word))
        if refused:
            raise OSError(5, "can't be written")
        return ran[0]

    monkeypatch.setattr(Futex, "hold", late)
    if not refused:
        monkeypatch.setattr(futex, "_PROOF_NS", 0)
    timer = threading.Timer(0.05, run.set)
    timer.start()
    before = time.monotonic()
    assert not (futex.proven() and refused)
    assert ran
    assert time.monotonic() - before < 0.9, "who could not hold it is not waited for"
    timer.join()


@needs_root
def test_a_machine_without_a_thread_to_spare_proves_nothing() -> None:
    def attempt() -> tuple[bool, bool]:
        before = os.listdir("/proc/self/fd")
        resource.setrlimit(resource.RLIMIT_NPROC, (0, 0))
        return futex.proven(), os.listdir("/proc/self/fd") == before

    assert futex.proven()
    assert call(attempt, NOBODY) == (False, True)


def test_a_word_that_can_t_be_written_is_not_looked_into_later(lines: Segment) -> None:
    """The kernel's list of held words is emptied before its memory is given back."""

    def attempt() -> tuple[bool, bool]:
        head, size = ctypes.c_void_p(), ctypes.c_size_t()
        word = lines.futex("held", 70, write=True)
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
        with pytest.raises(OSError, match="File too large"):
            word.hold()
        ctypes.CDLL(None).syscall(GET_ROBUST_LIST, 0, ctypes.byref(head), ctypes.byref(size))
        assert head.value
        (first,) = struct.unpack("<Q", ctypes.string_at(head.value, 8))
        return word.held(), first == head.value

    assert lines.futex("held", 71, write=True).hold()
    futex.let_go()
    assert call(attempt) == (False, True), "nobody's, and the list is empty"


@pytest.mark.parametrize(
    ("hard", "soft"),
    [(resource.RLIM_INFINITY, futex.NO_DUMP), (4096, futex.NO_DUMP), (futex.NO_DUMP, futex.NO_DUMP), (0, 0)],
)
def test_a_process_leaves_no_dump_and_keeps_its_hard_limit(
    hard: int, soft: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_to: list[object] = []
    monkeypatch.setattr(resource, "getrlimit", lambda kind: (hard, hard) if kind == resource.RLIMIT_CORE else (7, 7))
    monkeypatch.setattr(resource, "setrlimit", lambda *about: set_to.append(about))
    futex.leave_no_dump()
    assert set_to == [(resource.RLIMIT_CORE, (soft, hard))]


@pytest.mark.parametrize("error", [OSError, ValueError])
def test_a_process_that_may_not_set_its_limit_goes_on(error: type[Exception], monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*about: object) -> None:
        raise error

    monkeypatch.setattr(resource, "setrlimit", refuse)
    futex.leave_no_dump()
