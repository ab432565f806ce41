"""Stand-ins for the few modules of the service that call the kernel without Python's modules (futexes, rights,
starvation), and for the module that loads your own board."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any

from failstop.board import own
from failstop.procs import rights
from failstop.procs.starved import LONGEST_NS
from failstop.shm.futex import BLOCKS, PER_BLOCK
from failstop.shm.heartbeat import EARLY_NEWS, MEMORY_LOCKED, REALTIME
from failstop.shm.words import LINE_BYTES
from failstop_lab.machine.calls import Calls, Module
from failstop_lab.machine.files import Regular
from failstop_lab.machine.process import Thread

EVERY_RIGHT = REALTIME | MEMORY_LOCKED | EARLY_NEWS
OWNER_DIED = 1 << 30
WAITERS = 1 << 31
NUMBER = OWNER_DIED - 1


class FutexWord:
    """A futex's word in a file, as the kernel sees it: every process that maps the file waits at the same place."""

    def __init__(self, node: Regular, offset: int) -> None:
        self.node, self.offset = node, offset
        self.waiting: list[Thread] = []

    def value(self) -> int:
        return int.from_bytes(self.node.data[self.offset : self.offset + 4], "little")

    def put(self, value: int) -> None:
        self.node.put(value.to_bytes(4, "little"), self.offset)

    def owner_died(self, number: int) -> None:
        """Handle the word as the robust list of a dying thread: mark it and wake one waiter."""
        value = self.value()
        if value & NUMBER == number:
            self.put(value & WAITERS | OWNER_DIED)
            if value & WAITERS:
                self.wake(1)

    def wake(self, most: int) -> None:
        woken, self.waiting = self.waiting[:most], self.waiting[most:]
        for thread in woken:
            thread.process.machine.wake(thread)


class FutexStandIn:
    """failstop.shm.futex.Futex on a simulated machine, which `calls` asks."""

    calls: Calls

    def __init__(self, fd: int, offset: int, *, write: bool) -> None:
        node = self.calls.opened(self.calls.process("mmap", fd), fd).node
        assert isinstance(node, Regular)
        words = node.__dict__.setdefault("words", {})
        self._words: dict[int, FutexWord] = words
        self._node, self._offset = node, offset
        self._mine = self._word(0)

    def detach(self) -> None:
        self.calls.process("dup")

    def _word(self, line: int) -> FutexWord:
        at = self._offset + line * LINE_BYTES
        return self._words.setdefault(at, FutexWord(self._node, at))

    def hold(self, lines: int = 1) -> object:
        self.calls.process("set_robust_list")
        thread = self.calls.machine.caller()
        for line in range(lines):
            word = self._word(line)
            word.put(thread.number | WAITERS)
            thread.robust.append(word)
        return thread

    def held(self) -> bool:
        self.calls.process("pread")
        return bool(self._mine.value() & NUMBER)

    def owner_died(self) -> bool:
        self.calls.process("pread")
        return bool(self._mine.value() & OWNER_DIED)

    def wait_for_death(self, wanted: Callable[[], bool] = lambda: True) -> bool:
        self.calls.process("futex_wait")
        value = held = self._mine.value()
        while wanted():
            if value != held or not held & NUMBER:
                return bool(value & OWNER_DIED)
            self._mine.waiting.append(self.calls.machine.caller())
            self.calls.machine.block()
            value = self._mine.value()
        self.wake()
        return False

    def wake(self) -> None:
        self.calls.process("futex_wake")
        self._mine.wake(1 << 30)

    def close(self) -> None:
        self.calls.process("munmap")


def make_futex(calls: Calls) -> ModuleType:
    """failstop.shm.futex."""

    def let_go() -> None:
        calls.process("set_robust_list")
        calls.machine.caller().robust = []

    futex = type("Futex", (FutexStandIn,), {"calls": calls})
    return Module(
        "failstop.shm.futex", calls, Futex=futex, PER_BLOCK=PER_BLOCK, BLOCKS=BLOCKS, let_go=let_go, proven=lambda: True
    )


def make_rights(calls: Calls) -> ModuleType:
    """failstop.procs.rights: every right is granted, except the ones that the machine refuses."""

    def die_with_parent(parent: int) -> None:
        process = calls.process("prctl")
        process.dies_with_parent = True
        if process.parent is None or process.parent.pid != parent:
            raise SystemExit(f"parent {parent} is gone")

    def nothing(*_: Any) -> None:
        calls.process("prctl")

    @contextlib.contextmanager
    def realtime(priority: int) -> Iterator[bool]:
        calls.process("sched_setscheduler", priority)
        yield not calls.machine.refused & REALTIME

    return Module(
        "failstop.procs.rights",
        calls,
        name_process=nothing,
        die_with_parent=die_with_parent,
        request_rights=lambda priority: EVERY_RIGHT & ~calls.machine.refused,
        settle=nothing,
        raise_limits=nothing,
        realtime=realtime,
        no_descriptors=str,
        DESCRIPTORS=rights.DESCRIPTORS,
        LOOP_US=rights.LOOP_US,
        SUPERVISOR_LOOP_US=rights.SUPERVISOR_LOOP_US,
    )


def make_starved(calls: Calls) -> ModuleType:
    """failstop.procs.starved: the machine knows which processes it did not run."""

    def look(pid: int, heart: object, deadline_ns: int, bell: object) -> bool:
        calls.process("stat")
        process = calls.machine.processes.get(pid)
        calls.machine.starved_looks += bool(process and process.held_until_ns)
        return bool(process and process.starved)

    return Module("failstop.procs.starved", calls, look=look, LONGEST_NS=LONGEST_NS)


def make_thread_state(calls: Calls) -> ModuleType:
    """failstop.shm.thread_state: the machine knows which threads it runs."""

    def state_of(pid: int) -> str:
        """The letter that /proc would have."""
        process = calls.machine.processes.get(pid)
        if process is None or process.dead:
            return "Z"
        calls.machine.starved_looks += bool(process.held_until_ns)
        return "S" if not process.held_until_ns else "R" if process.starved else "T"

    return Module("failstop.shm.thread_state", calls, state_of=state_of)


def make_own(calls: Calls) -> ModuleType:
    """failstop.board.own: the folder is on the real machine, and its modules make no system calls."""
    return Module(
        "failstop.board.own",
        calls,
        wire=own.wire,
        load=own.load,
        OwnBoardError=own.OwnBoardError,
        OWN_PACKAGE=own.OWN_PACKAGE,
    )


def make_helpers(calls: Calls) -> ModuleType:
    """failstop.helpers: a process of the machine has no search path."""
    return Module("failstop.helpers", calls, leave_current_folder=lambda: None)


def stand_ins(calls: Calls) -> dict[str, ModuleType]:
    """Every stand-in, by the name of the module that it replaces."""
    return {
        "failstop.shm.futex": make_futex(calls),
        "failstop.procs.rights": make_rights(calls),
        "failstop.procs.starved": make_starved(calls),
        "failstop.shm.thread_state": make_thread_state(calls),
        "failstop.board.own": make_own(calls),
        "failstop.helpers": make_helpers(calls),
    }
