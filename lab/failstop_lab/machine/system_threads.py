"""The simulated `_thread`, `threading`, `_queue`, `signal` and `_signal`."""

from __future__ import annotations

import _queue
import errno
import signal
from collections.abc import Callable, Iterable
from typing import Any

from failstop_lab.machine.calls import NS, Calls, Module, constants
from failstop_lab.machine.files import Pidfd
from failstop_lab.machine.process import Thread


class Lock:
    """A lock of `_thread`."""

    __slots__ = ("_calls", "_held", "_waiting")

    def __init__(self, calls: Calls) -> None:
        self._calls = calls
        self._held = False
        self._waiting: list[Thread] = []

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        machine = self._calls.machine
        until_ns = None if timeout < 0 else machine.now_ns + round(timeout * NS)
        while not self._try_acquire():
            if not blocking or (until_ns is not None and machine.now_ns >= until_ns):
                return False
            self._waiting.append(machine.caller())
            machine.block(until_ns)
        return True

    def _try_acquire(self) -> bool:
        was, self._held = self._held, True
        return not was

    def release(self) -> None:
        if not self._held:
            raise RuntimeError("release unlocked lock")
        self._held = False
        if self._waiting:
            self._calls.machine.wake(self._waiting.pop(0))

    def locked(self) -> bool:
        return self._held

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *_: object) -> None:
        self.release()


class ReentrantLock:
    """threading.RLock."""

    def __init__(self, calls: Calls) -> None:
        self._lock = Lock(calls)
        self._machine = calls.machine
        self._owner: Thread | None = None
        self._depth = 0

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        if not self._depth or self._owner is not self._machine.current:
            if not self._lock.acquire(blocking, timeout):
                return False
            self._owner = self._machine.current
        self._depth += 1
        return True

    def release(self) -> None:
        self._depth -= 1
        if not self._depth:
            self._owner = None
            self._lock.release()

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *_: object) -> None:
        self.release()


class Queue:
    """_queue.SimpleQueue."""

    def __init__(self, calls: Calls) -> None:
        self._machine = calls.machine
        self._items: list[Any] = []
        self._waiting: list[Thread] = []

    def put(self, item: Any) -> None:
        self._items.append(item)
        if self._waiting:
            self._machine.wake(self._waiting.pop(0))

    def get(self) -> Any:
        while not self._items:
            self._waiting.append(self._machine.caller())
            self._machine.block()
        return self._items.pop(0)

    def get_nowait(self) -> Any:
        if not self._items:
            raise _queue.Empty
        return self._items.pop(0)

    def qsize(self) -> int:
        return len(self._items)

    def empty(self) -> bool:
        return not self._items


class Threads(Module):
    """`_thread` and `threading`, as far as the service uses them."""

    LockType = Lock

    def start_new_thread(self, body: Callable[..., object], arguments: tuple[Any, ...] = ()) -> int:
        process = self._calls.process("thread")
        return self._machine.thread(process, lambda: body(*arguments)).number

    def allocate_lock(self) -> Lock:
        return Lock(self._calls)

    def Lock(self) -> Lock:
        return Lock(self._calls)

    def RLock(self) -> ReentrantLock:
        return ReentrantLock(self._calls)

    def get_ident(self) -> int:
        return self._machine.current.number if self._machine.current else 0

    get_native_id = get_ident

    def stack_size(self, size: int = 0) -> int:
        return 0


class Signals(Module):
    """`signal` and `_signal`."""

    def __init__(self, name: str, calls: Calls) -> None:
        fixed = constants(signal, "SIG", "ITIMER")
        super().__init__(name, calls, **fixed, Signals=signal.Signals, valid_signals=signal.valid_signals)

    def signal(self, number: int, handler: Any) -> Any:
        process = self._calls.process("sigaction", number)
        if self._machine.current is not process.threads[0]:
            raise ValueError("signal only works in main thread")
        if handler is None:
            raise TypeError("signal handler must be signal.SIG_IGN, signal.SIG_DFL, or a callable object")
        before = process.handlers.get(number, signal.SIG_DFL)
        if handler == signal.SIG_DFL:
            process.handlers.pop(number, None)
        else:
            process.handlers[number] = handler
        return before

    def setitimer(self, which: int, seconds: float, interval: float = 0.0) -> tuple[float, float]:
        return 0.0, 0.0

    def pthread_sigmask(self, how: int, mask: object) -> set[int]:
        return set()

    def sigtimedwait(self, wanted: Iterable[int], timeout: float) -> object:
        process = self._calls.process("sigtimedwait")
        came, process.continued = process.continued and signal.SIGCONT in wanted, False
        return signal.SIGCONT if came else None

    def pidfd_send_signal(self, fd: int, number: int) -> None:
        node = self._calls.begin("kill", fd).node
        if not isinstance(node, Pidfd) or node.process.reaped:
            raise ProcessLookupError(errno.ESRCH, "no such process")
        self._machine.kill(node.process, int(number))


def threads(calls: Calls) -> dict[str, Module]:
    """By name."""
    return {
        "_thread": Threads("_thread", calls),
        "threading": Threads("threading", calls),
        "_queue": Module("_queue", calls, SimpleQueue=lambda: Queue(calls), Empty=_queue.Empty),
        "signal": Signals("signal", calls),
        "_signal": Signals("_signal", calls),
    }
