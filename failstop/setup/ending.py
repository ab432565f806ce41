"""Ending: makes sure that a program that turns wheels through its own service stops them before it ends, whatever ends
it. The laboratory's programs use it too."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
from collections.abc import Iterator
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_PR_SET_PDEATHSIG = 1
_libc = ctypes.CDLL(None, use_errno=True)


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Within this context a lost terminal or a SIGTERM ends the program in the same way as Ctrl-C does, so that the
    wheels are stopped first."""

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Within this context these signals are ignored, because a program that is interrupted while it ends might leave
    the wheels turning."""
    held = {number: signal.getsignal(number) for number in SIGNALS}
    for number in held:
        signal.signal(number, signal.SIG_IGN)
    try:
        yield
    finally:
        for number, handler in held.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def noted() -> Iterator[list[int]]:
    """Within this context these signals interrupt nothing. The number of each signal that arrives is added to the list
    that is yielded."""
    found: list[int] = []

    def note(number: int, _frame: FrameType | None) -> None:
        found.append(number)

    before = {number: signal.signal(number, note) for number in SIGNALS}
    try:
        yield found
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def arrivals() -> Iterator[int]:
    """A descriptor that can be read once a signal has arrived. A wait that includes it misses none: a signal that
    arrives just before a plain read() interrupts nothing, and its handler runs only when the read returns."""
    reads, writes = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
    before = signal.set_wakeup_fd(writes, warn_on_full_buffer=False)
    try:
        yield reads
    finally:
        signal.set_wakeup_fd(before)
        os.close(reads)
        os.close(writes)


def end_with_parent() -> None:
    """Call it in the child, before exec: the child gets SIGTERM when the parent dies. The supervisor then stops the
    wheels and ends."""
    _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
