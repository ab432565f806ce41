"""Mapped: shared memory, its words, and locks, as a process of a weak machine gets them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from failstop_lab.machine.buffers import WORD_BYTES, View
from failstop_lab.machine.files import Regular
from failstop_lab.machine.process import Death, Process
from failstop_lab.machine.system_threads import Lock

if TYPE_CHECKING:
    from failstop_lab.machine.memory import WeakMachine


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
            machine: Any = self._calls.machine
            if view.since and machine.at_seam is not None:
                machine.at_seam(machine.current, "release", ())
            view.released = len(view.since)
        super().release()

    def _view(self) -> View | None:
        machine: Any = self._calls.machine
        thread = machine.current
        return thread.view if thread else None
