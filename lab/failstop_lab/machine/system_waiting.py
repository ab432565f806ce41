"""The simulated `select` and `time`."""

from __future__ import annotations

import errno
import select
import time
from collections.abc import Iterable
from typing import Any

from failstop_lab.machine.calls import NS, Calls, Module, constants
from failstop_lab.machine.epoll import Epoll
from failstop_lab.machine.files import ERR, HUP, IN, OUT, Open


def _number(fd: Any) -> int:
    return fd if isinstance(fd, int) else int(fd.fileno())


class SimulatedEpoll:
    """select.epoll."""

    def __init__(self, calls: Calls) -> None:
        self._calls = calls
        process = calls.process("epoll_create")
        self._node = Epoll()
        self._opened = Open(self._node)
        self._fd = process.descriptor(self._opened)

    def fileno(self) -> int:
        return self._fd

    def register(self, fd: Any, events: int = 0) -> None:
        number = _number(fd)
        opened = self._calls.begin("epoll_ctl", number)
        if number in self._node.wanted or number in self._node.late:
            raise FileExistsError(errno.EEXIST, "registered already")
        self._node.add(number, opened, events)

    def modify(self, fd: Any, events: int) -> None:
        number = _number(fd)
        self._node.add(number, self._calls.begin("epoll_ctl", number), events)

    def unregister(self, fd: Any) -> None:
        number = _number(fd)
        self._calls.begin("epoll_ctl", number)
        if number not in self._node.wanted and number not in self._node.late:
            raise FileNotFoundError(errno.ENOENT, "not registered")
        self._node.drop(number)

    def poll(self, timeout: float | None = None, maxevents: int = -1) -> list[tuple[int, int]]:
        self._calls.process("epoll_wait")
        if timeout is not None and timeout > 0:
            timeout = -(-timeout * 1000 // 1) / 1000  # whole milliseconds, as the kernel takes them
        found: list[tuple[int, int]] = self._calls.wait_for((self._opened,), self._node.pop_ready, timeout)
        return found

    def close(self) -> None:
        self._calls.process("close").close(self._fd)


class SimulatedPoll:
    """select.poll."""

    def __init__(self, calls: Calls) -> None:
        self._calls = calls
        self._wanted: dict[int, int] = {}

    def register(self, fd: Any, events: int = IN | OUT) -> None:
        self._wanted[_number(fd)] = events

    def unregister(self, fd: Any) -> None:
        del self._wanted[_number(fd)]

    def poll(self, timeout: float | None = None) -> list[tuple[int, int]]:
        process = self._calls.process("poll")
        held = {fd: self._calls.opened(process, fd) for fd in self._wanted}

        def ready() -> list[tuple[int, int]]:
            masks = ((fd, each.mask() & (self._wanted[fd] | ERR | HUP)) for fd, each in held.items())
            return [(fd, mask) for fd, mask in masks if mask]

        seconds = None if timeout is None or timeout < 0 else timeout / 1000
        found: list[tuple[int, int]] = self._calls.wait_for(held.values(), ready, seconds)
        return found


class Select(Module):
    """The module `select`."""

    def __init__(self, calls: Calls) -> None:
        super().__init__("select", calls, **constants(select, "EPOLL", "POLL", "PIPE"))

    def epoll(self) -> SimulatedEpoll:
        return SimulatedEpoll(self._calls)

    def poll(self) -> SimulatedPoll:
        return SimulatedPoll(self._calls)

    def select(
        self, reading: Iterable[Any], writing: Iterable[Any], other: Iterable[Any], timeout: float | None = None
    ) -> tuple[list[Any], list[Any], list[Any]]:
        process, opened = self._calls.process("select"), self._calls.opened
        wanted = [(each, opened(process, each), IN | HUP | ERR, 0) for each in reading]
        wanted += [(each, opened(process, each), OUT | ERR, 1) for each in writing]

        def ready() -> list[tuple[Any, int]]:
            return [(each, which) for each, held, mask, which in wanted if held.mask() & mask]

        found = self._calls.wait_for([held for _, held, _, _ in wanted], ready, timeout)
        return [each for each, which in found if which == 0], [each for each, which in found if which == 1], []


class Time(Module):
    """The module `time`. Each look takes look_ns, so that a loop that waits for a time comes to its end."""

    def __init__(self, calls: Calls) -> None:
        plain = {name: getattr(time, name) for name in ("gmtime", "localtime", "strftime", "mktime", "struct_time")}
        super().__init__("time", calls, **plain, **constants(time, "CLOCK_"))

    def monotonic_ns(self) -> int:
        self._machine.now_ns += self._machine.look_ns
        return self._machine.now_ns

    perf_counter_ns = monotonic_ns

    def monotonic(self) -> float:
        return self.monotonic_ns() / NS

    perf_counter = monotonic

    def time_ns(self) -> int:
        self._machine.sleep_looks += 1
        return self._machine.unix_ns + self.monotonic_ns() + self._machine.slept_ns

    def time(self) -> float:
        return self.time_ns() / NS

    def process_time_ns(self) -> int:
        return self._machine.now_ns // 100

    def clock_gettime_ns(self, clock: int) -> int:
        if clock == time.CLOCK_BOOTTIME:
            self._machine.sleep_looks += 1
            return self.monotonic_ns() + self._machine.slept_ns
        if clock == time.CLOCK_MONOTONIC:
            return self.monotonic_ns()
        raise OSError(errno.EINVAL, "no such clock here")

    def clock_gettime(self, clock: int) -> float:
        return self.clock_gettime_ns(clock) / NS

    def sleep(self, seconds: float) -> None:
        self._calls.process("sleep")
        until_ns = self._machine.now_ns + round(seconds * NS)
        if seconds <= 0:
            self._machine.give_way()
        while self._machine.now_ns < until_ns:
            self._machine.block(until_ns)
