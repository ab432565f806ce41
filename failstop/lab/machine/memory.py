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
from dataclasses import dataclass, field
from typing import Any

from failstop.lab.machine.calls import Calls
from failstop.lab.machine.files import Counter, Fifo, Regular, Socket
from failstop.lab.machine.kernel import Machine
from failstop.lab.machine.loading import Loader
from failstop.lab.machine.process import Death, Process, Thread
from failstop.lab.machine.system_threads import Lock

WORD_BYTES = 8
REMEMBERED = 256
"""Stores of all processes that a load may not have seen yet: far more than there are in any pause."""
RINGS, HEARS = ("write", "sendmsg", "spawn", "futex_wake", "kill"), ("read", "readv", "recvmsg", "pread")
ALL, LAST, BUT_LAST, FIRST_HALF, SECOND_HALF = LATE = range(1, 6)
"""The stores that are late, or a part of the last one."""
EVERY, FIRST, BUT_FIRST, BEGIN_OF_FIRST, END_OF_FIRST = EARLY = range(1, 6)
"""The loads that are early, or a part of the first one."""


@dataclass(eq=False)
class Store:
    """A store, or a part of one, and what was there before."""

    stamp: int
    """When others could see it."""
    process: Process
    node: Regular
    at: int
    before: bytes
    data: bytes
    made: int
    """Its stamp when it was made."""

    def cut(self, begin: int, end: int) -> Store:
        """A part of it."""
        before, data = self.before[begin:end], self.data[begin:end]
        return Store(self.stamp, self.process, self.node, self.at + begin, before, data, self.made)

    def touches(self, other: Store) -> bool:
        """Whether both are of one word."""
        return self.node is other.node and self.at < other.at + len(other.data) and other.at < self.at + len(self.data)


@dataclass
class View:
    """The state of one thread's processor."""

    since: list[Store] = field(default_factory=list)
    """Stores behind its last barrier that nobody can have seen."""
    late: list[Store] = field(default_factory=list)
    """Those that are taken back while it pauses."""
    released: int = -1
    """How many of `since` were made when it released a lock; -1: it has released none."""
    before: int = 0
    """Loads may be as old as this stamp, up to the next barrier; 0: they are new."""
    early: int = 0
    """Those of them that are, of EARLY."""
    loads: int = 0
    """How many there were since the pause."""
    seen: set[tuple[int, int]] = field(default_factory=set)
    """Places that were looked at since, and are not older at the next look."""


class WeakMachine(Machine):
    """A machine with such a memory, once weaken() was called. While nobody is at its seam, its memory has one order."""

    def __init__(self, seed: int = 0) -> None:
        super().__init__(seed)
        self.order = 0
        """By which of all orders threads that could run are chosen; 0: first come, first served."""
        self.lowered: dict[int, int] = {}
        """Threads that run behind all others, by their numbers, each further one lower."""
        self._views: dict[int, View] = {}
        self.stamp = 1
        """Of the newest store."""
        self._stores: deque[Store] = deque(maxlen=REMEMBERED)
        self._orderings: dict[tuple[str, int], int] = {}
        self.on_load: Callable[[Thread, Mapped, int, int], None] | None = None
        """Told of each load: its place, and the stamp of the store that it sees."""
        self.on_store: Callable[[Thread, Mapped, int, int], None] | None = None

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
        found = self._views.get(thread.number)
        if found is None:
            found = self._views[thread.number] = View()
        return found

    def load(self, mapped: Mapped, at: int, end: int) -> bytes:
        """The bytes that the thread that runs reads there."""
        thread = self.caller()
        assert self.at_seam is not None
        self.at_seam(thread, "load", (mapped.node, at, end - at))
        now = bytes(mapped.data[at:end])
        view = self._views.get(thread.number)
        if view is not None and view.before:
            old = self._older(view, mapped, at, end, now)
            if self.on_load:
                self.on_load(thread, mapped, at, self.stamp if old is None else view.before)
            return now if old is None else old
        if self.on_load:
            self.on_load(thread, mapped, at, self.stamp)
        return now

    def _older(self, view: View, mapped: Mapped, at: int, end: int, now: bytes) -> bytes | None:
        """The bytes that a load finds there that was made early; None: this one was not."""
        view.loads += 1
        place = id(mapped.node), at
        again = place in view.seen
        view.seen.add(place)
        first = view.loads == 1
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
        before, made = bytes(mapped.data[at : at + len(data)]), self.stamp
        store = Store(made, mapped.process, mapped.node, at, before, bytes(data), made)
        mapped.data[at : at + len(data)] = data
        self._stores.append(store)
        self.view(thread).since.append(store)
        if self.on_store:
            self.on_store(thread, mapped, at, self.stamp)

    def unseen(self, stamp: int) -> set[int]:
        """The stores, by when they were made, that a load as of that stamp does not see."""
        late = {each.made for view in self._views.values() for each in view.late}
        later = itertools.takewhile(lambda each: each.stamp > stamp, reversed(self._stores))
        return late.union(each.made for each in later)

    # Pauses.

    def hold_back(self, thread: Thread, which: int) -> int:
        """Take stores back that have not left the thread's buffer; returns how many. All others are seen from now
        on."""
        view = self.view(thread)
        since = view.since
        chosen = {0: [], ALL: since, BUT_LAST: since[:-1]}.get(which, since[-1:])
        if since and which in (FIRST_HALF, SECOND_HALF):
            last = since[-1]
            half = len(last.data) // 2 // WORD_BYTES * WORD_BYTES
            begin, end = (0, half) if which == FIRST_HALF else (half, len(last.data))
            chosen = [last.cut(begin, end)] if half else []
        whole = which not in (FIRST_HALF, SECOND_HALF)
        out = [each for each in since if each not in chosen] if whole else []
        chosen = [each for each in chosen if not any(each.stamp < later.stamp and each.touches(later) for later in out)]
        for each in reversed(chosen):
            self._put(each, each.before)
        view.late = list(chosen)
        view.since = [each for each in since if each in chosen]
        return len(chosen)

    def _put(self, store: Store, data: bytes) -> None:
        store.node.data[store.at : store.at + len(data)] = data

    def let_out(self, thread: Thread) -> None:
        """Let the stores out that were taken back."""
        view = self._views.get(thread.number)
        if view is None or not view.late:
            return
        late, view.late = view.late, []
        for each in late:
            self.stamp += 1
            self._stores.append(Store(self.stamp, each.process, each.node, each.at, each.before, each.data, each.made))
            self._put(each, each.data)

    def make_early(self, thread: Thread, stamp: int, which: int) -> None:
        """Up to its next barrier these loads of the thread may be as old as that."""
        view = self.view(thread)
        view.before, view.early, view.loads = stamp, which, 0
        view.seen.clear()

    # Barriers.

    def order_all(self, thread: Thread, most: int | None = None) -> None:
        """A barrier; `most`: behind so many of the stores since the one before."""
        view = self._views.get(thread.number)
        if view:
            self.let_out(thread)
            del view.since[:most]
            view.before = 0
            view.released = -1

    def call(self, name: str, *about: Any) -> Process:
        process = super().call(name, *about)
        if (name in RINGS or name in HEARS) and self.current and (view := self._views.get(self.current.number)):
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


class Mapped:
    """A process's map of a file."""

    __slots__ = ("data", "machine", "node", "process")

    def __init__(self, machine: WeakMachine, process: Process, node: Regular) -> None:
        self.machine, self.process, self.node = machine, process, node
        self.data = node.mapped()

    def __len__(self) -> int:
        return len(self.data)

    def __getitem__(self, where: slice) -> bytes:
        if self.machine.at_seam is None or self.machine.current is None:
            return self.data[where]
        return self.machine.load(self, where.start, where.stop)

    def __setitem__(self, where: slice, data: bytes) -> None:
        if self.process.dead:
            raise Death
        if self.machine.at_seam is None or self.machine.current is None:
            self.data[where] = data
        else:
            self.machine.store(self, where.start, data)

    def close(self) -> None:
        """Nothing: a simulated file keeps its map."""


class Words:
    """As memoryview(map).cast("Q")."""

    __slots__ = ("_words", "obj")

    def __init__(self, mapped: Mapped) -> None:
        self.obj = mapped
        self._words = memoryview(mapped.data)

    def cast(self, kind: str) -> Words:
        """Eight bytes each."""
        self._words = self._words.cast(kind)  # type: ignore[call-overload]
        return self

    def __getitem__(self, index: int) -> int:
        machine = self.obj.machine
        if machine.at_seam is None or machine.current is None:
            return self._words[index]
        at = index * WORD_BYTES
        return int.from_bytes(machine.load(self.obj, at, at + WORD_BYTES), "little")

    def __setitem__(self, index: int, value: int) -> None:
        if self.obj.process.dead:
            raise Death
        machine = self.obj.machine
        if machine.at_seam is None or machine.current is None:
            self._words[index] = value
        else:
            machine.store(self.obj, index * WORD_BYTES, value.to_bytes(WORD_BYTES, "little"))


class OrderingLock(Lock):
    """A lock that orders what is before its release ahead of what is behind the next acquire of the same thread."""

    __slots__ = ()

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        taken = super().acquire(blocking, timeout)
        view = self._view()
        if taken and view and view.released >= 0:
            machine: Any = self._calls.machine
            machine.order_all(machine.current, view.released)
        return taken

    def release(self) -> None:
        if view := self._view():
            view.released = len(view.since)
        super().release()

    def _view(self) -> View | None:
        machine: Any = self._calls.machine
        thread = machine.current
        return machine._views.get(thread.number) if thread else None
