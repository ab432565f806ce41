"""Memory: a simulated machine whose processes see each other's stores as AArch64 permits, and not in one order.

Threads run one at a time, so nobody can see another order than that of the stores but while a thread pauses between
two of its accesses. What its processor may have done by then, or not yet, is drawn there:

- A store since its last barrier may not have left its store buffer: it is taken back, whole or from an 8-byte place
  on, while the others run. Those of one word keep their order, and the thread itself has seen its own.
- A load up to its next barrier may have been made before the pause, whole or up to an 8-byte place, but none that
  comes after a newer look at the same place.

A barrier is a lock that is released and acquired again; a wait in the kernel; a hold; a death. Whatever rings (eventfd,
pipe, socket) lets the stores before it out first, and whoever reads there makes no later load before that. Clock
readings, and calls that ring nobody, order nothing. Loads are never later than a store behind them: herd7 has those.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any

from failstop_lab.machine.buffers import (
    ALL,
    BEGIN_OF_FIRST,
    BUT_FIRST,
    BUT_LAST,
    END_OF_FIRST,
    EVERY,
    HALVES,
    REST_OF_PLACE,
    SAME_PLACE,
    WORD_BYTES,
    Race,
    Store,
    View,
)
from failstop_lab.machine.calls import Calls
from failstop_lab.machine.files import Counter, Fifo, Regular, Socket
from failstop_lab.machine.kernel import Machine
from failstop_lab.machine.loading import Loader
from failstop_lab.machine.mapped import Mapped, OrderingLock, Words
from failstop_lab.machine.process import Process, Thread

REMEMBERED = 256
"""Stores of all processes that a load may not have seen yet: far more than there are in any pause."""
RINGS, HEARS = ("write", "sendmsg", "spawn", "futex_wake", "kill"), ("read", "readv", "recvmsg", "pread")
ORDERING = frozenset((*RINGS, *HEARS))
MET_NS = 50_000
"""A thread that looks where another was about to store pauses for so long, while the other makes its stores."""


class WeakMachine(Machine):
    """A machine with such a memory, once weaken() was called. While nobody is at its seam, its memory has one order."""

    def __init__(self, seed: int = 0) -> None:
        super().__init__(seed)
        self.order = 0
        """By which of all orders threads that could run are chosen; 0: first come, first served."""
        self.lowered: dict[int, int] = {}
        """Threads that run behind all others, by their numbers, each further one lower."""
        self._held_back: dict[int, View] = {}
        """The views of the threads whose stores are late, by the threads' numbers."""
        self._race: Race | None = None
        self.stamp = 1
        """The number of the newest store."""
        self._stores: deque[Store] = deque(maxlen=REMEMBERED)
        self._orderings: dict[tuple[str, int], int] = {}
        self.on_load: Callable[[Thread, Mapped, int, int], None] | None = None
        """Told of each load: its place, and the stamp of the store that it sees."""
        self.on_store: Callable[[Thread, Mapped, int, int], None] | None = None
        self.on_late: Callable[[Thread], None] | None = None
        """Told of a thread that looks where another's store is late."""

    def weaken(self, loader: Loader) -> None:
        """Before anything is loaded: shared memory, locks and views of it are those of this module."""
        system = loader.system
        calls: Calls = system["mmap"]._calls
        system["mmap"].mmap = lambda fd, size, flags=0, prot=0: self._mapped(calls, fd)
        for name in ("_thread", "threading"):
            system[name].allocate_lock = system[name].Lock = lambda: OrderingLock(calls)
        loader._builtins["memoryview"] = lambda what: Words(what) if isinstance(what, Mapped) else memoryview(what)

    def _mapped(self, calls: Calls, fd: int) -> Mapped:
        process = calls.process("mmap", fd)
        node = calls.opened(process, fd).node
        if not isinstance(node, Regular):
            raise OSError(19, "not a file")
        return Mapped(self, process, node)

    # Accesses.

    def view(self, thread: Thread) -> View:
        """The state of a thread's processor."""
        if thread.view is None:
            thread.view = View()
        view: View = thread.view
        return view

    def load(self, mapped: Mapped, at: int, end: int) -> bytes:
        """The bytes that the thread that runs reads there."""
        thread = self.caller()
        node = mapped.node
        assert self.at_seam is not None
        self.at_seam(thread, "load", (node, at, end - at))
        if self._race is not None:
            self._meet(thread, node)
        if self._held_back and self.on_late:
            late = (each for number, view in self._held_back.items() if number != thread.number for each in view.late)
            if any(each.node is node and at < each.at + len(each.data) and each.at < end for each in late):
                self.on_late(thread)
        now = bytes(mapped.data[at:end])
        view = self.view(thread)
        view.last = node.number, at, end
        old = self._older(view, mapped, at, end, now) if view.before else None
        if self.on_load:
            self.on_load(thread, mapped, at, self.stamp if old is None else view.before)
        return now if old is None else old

    def _older(self, view: View, mapped: Mapped, at: int, end: int, now: bytes) -> bytes | None:
        """The bytes that a load finds there that was made early; None: this one was not."""
        view.loads += 1
        number, first = mapped.node.number, view.loads == 1
        if view.early == REST_OF_PLACE and first:
            view.again = number, at + WORD_BYTES, end
        if view.early in (SAME_PLACE, REST_OF_PLACE):
            begin, stop = max(view.again[1], at) - at, min(view.again[2], end) - at
            if number != view.again[0] or begin >= stop:
                return None
            return now[:begin] + self._as_of(view.before, mapped, at, now)[begin:stop] + now[stop:]
        again = (number, at) in view.seen
        view.seen.add((number, at))
        if again or (view.early == BUT_FIRST and first) or (view.early not in (EVERY, BUT_FIRST) and not first):
            return None
        old = self._as_of(view.before, mapped, at, now)
        half = (end - at) // 2 // WORD_BYTES * WORD_BYTES
        if view.early == BEGIN_OF_FIRST:
            return old[:half] + now[half:]
        return now[:half] + old[half:] if view.early == END_OF_FIRST else old

    def _as_of(self, stamp: int, mapped: Mapped, at: int, now: bytes) -> bytes:
        old, end = bytearray(now), at + len(now)
        for store in reversed(self._stores):
            if store.stamp <= stamp:
                break
            if store.node is mapped.node and store.process is not mapped.process:
                begin, stop = max(at, store.at), min(end, store.at + len(store.data))
                if begin < stop:
                    old[begin - at : stop - at] = store.before[begin - store.at : stop - store.at]
        return bytes(old)

    def store(self, mapped: Mapped, at: int, data: bytes) -> None:
        """The thread that runs writes there."""
        thread = self.caller()
        assert self.at_seam is not None
        self.at_seam(thread, "store", (mapped.node, at, len(data)))
        self.stamp += 1
        end, made = at + len(data), self.stamp
        store = Store(made, mapped.process, mapped.node, at, bytes(mapped.data[at:end]), bytes(data), made)
        mapped.data[at:end] = data
        self._stores.append(store)
        self.view(thread).since.append(store)
        if self.on_store:
            self.on_store(thread, mapped, at, self.stamp)

    def unseen(self, stamp: int) -> set[int]:
        """The stores, by when they were made, that a load as of that stamp does not see."""
        late = {each.made for view in self._held_back.values() for each in view.late}
        if stamp < self.stamp:
            later = itertools.takewhile(lambda each: each.stamp > stamp, reversed(self._stores))
            late.update(each.made for each in later)
        return late

    # Pauses.

    def hold_back(self, thread: Thread, which: int) -> int:
        """Take stores back that have not left the thread's buffer; returns how many. All others are seen from now
        on."""
        view = self.view(thread)
        since, (which_one, first) = view.since, HALVES.get(which, (0, False))
        if which_one:
            half = since[which_one].half(first=first) if len(since) >= -which_one else None
            chosen, out = [half] if half else [], since[len(since) + which_one + 1 :]
        else:
            chosen = {0: [], ALL: since, BUT_LAST: since[:-1]}.get(which, since[-1:])
            out = [each for each in since if each not in chosen]
        chosen = [each for each in chosen if not any(each.stamp < later.stamp and each.touches(later) for later in out)]
        for each in reversed(chosen):
            self._put(each, each.before)
        view.late = list(chosen)
        view.since = [each for each in since if each in chosen]
        if chosen:
            self._held_back[thread.number] = view
        return len(chosen)

    def _put(self, store: Store, data: bytes) -> None:
        store.node.data[store.at : store.at + len(data)] = data

    def let_out(self, thread: Thread) -> None:
        """Let the stores out that were taken back."""
        view = self._held_back.pop(thread.number, None)
        if view is None:
            return
        late, view.late = view.late, []
        for each in late:
            self.stamp += 1
            self._stores.append(Store(self.stamp, each.process, each.node, each.at, each.before, each.data, each.made))
            self._put(each, each.data)

    def make_early(self, thread: Thread, stamp: int, which: int) -> None:
        """Up to its next barrier these loads of the thread may be as old as that."""
        view = self.view(thread)
        view.before, view.early, view.loads, view.again = stamp, which, 0, view.last
        view.seen.clear()

    # Barriers.

    def order_all(self, thread: Thread, most: int | None = None) -> None:
        """A barrier; `most`: behind so many of the stores since the one before."""
        view: View | None = thread.view
        if view:
            self.let_out(thread)
            del view.since[:most]
            view.before = 0
            view.released = -1

    def call(self, name: str, *about: Any) -> Process:
        process = super().call(name, *about)
        if name in ORDERING and self.current and (view := self.current.view) and (view.since or view.before):
            opened = process.files.get(about[0]) if about and isinstance(about[0], int) else None
            rings = opened is None or isinstance(opened.node, (Counter, Fifo, Socket))
            if rings and name in RINGS:
                view.since.clear()
            elif rings:
                view.before = 0
        return process

    def give_way(self, to: Process | None = None) -> None:
        self.hold_back(self.caller(), 0)
        super().give_way(to)

    def lower(self, thread: Thread) -> None:
        """From now on the thread runs when no other can."""
        self.lowered[thread.number] = max(self.lowered.values(), default=0) + 1
        self.give_way()

    def block(self, until_ns: int | None = None) -> bool:
        thread = self.current
        if thread:
            self.order_all(thread)
        return super().block(until_ns)

    def pause(self, ns: int, late: int = 0, early: int = 0) -> int:
        """The thread that runs makes no access and no call for so long: it is on a processor, and that is no barrier.
        `late`: stores before it, of LATE; `early`: loads behind it, of EARLY. Returns how many stores are late."""
        thread, until_ns, stamp = self.caller(), self.now_ns + ns, self.stamp
        held = self.hold_back(thread, late)
        while self.now_ns < until_ns:
            super().block(until_ns)
        self.let_out(thread)
        if early:
            self.make_early(thread, stamp, early)
        return held

    def race(self, ns: int, node: Regular, early: int) -> None:
        """The thread that runs is about to store in that file, and does once another process looks there, at the latest
        after so long. That one waits for it, and its loads up to its next barrier may have been made before."""
        thread, until_ns = self.caller(), self.now_ns + ns
        self.hold_back(thread, 0)
        race = self._race = Race(thread, node, early)
        while self._race is race and self.now_ns < until_ns:
            super().block(until_ns)
        if self._race is race:
            self._race = None

    def _meet(self, thread: Thread, node: Regular) -> None:
        race = self._race
        if race and race.node is node and race.thread.process is not thread.process:
            self._race = None
            self.wake(race.thread)
            self.pause(MET_NS, 0, race.early)

    def calm(self) -> None:
        """From now on nothing is seen in another order."""
        self.order, self._race = 0, None
        self.lowered.clear()
        for process in self.processes.values():
            self._settle(process.threads)

    def hold(self, process: Process, ns: int, *, starved: bool = False) -> None:
        self._settle(process.threads)
        super().hold(process, ns, starved=starved)

    def die(self, process: Process, code: int) -> None:
        self._settle(process.threads)
        super().die(process, code)

    def _settle(self, threads: Iterable[Thread]) -> None:
        for thread in threads:
            self.order_all(thread)

    # The schedule.

    def _switch(self, thread: Thread) -> None:
        if (self.order or self.lowered) and self.runnable and not thread.process.dead:
            best = min((thread, *self.runnable), key=self._rank)
            if best is not thread:
                self.runnable.remove(best)
                self.runnable.appendleft(thread)
                thread = best
        super()._switch(thread)

    def _rank(self, thread: Thread) -> tuple[int, int]:
        """Its place among those that could run."""
        own = int(thread is not thread.process.threads[0]) if thread.process.threads else 0
        key = thread.process.name, own
        if key not in self._orderings:
            self._orderings[key] = len(self._orderings)
        mixed = (self._orderings[key] + 1) * 0x9E3779B1 * self.order >> 8 & 0xFFFF
        return self.lowered.get(thread.number, 0), mixed if self.order else 0
