"""Ending: makes sure that a program which turns wheels through its own service stops them before a signal ends it.
Setup and the programs of the laboratory use this module."""

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
    """Within this context, SIGTERM and a lost terminal (SIGHUP) raise KeyboardInterrupt, as Ctrl-C does. So the program
    can stop the wheels before it exits."""

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
    """Within this context, SIGINT, SIGTERM and SIGHUP are ignored. Use it around the cleanup that stops the wheels."""
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
    """Within this context, SIGINT, SIGTERM and SIGHUP interrupt nothing. Instead, the number of each signal is added to
    the list that the context yields."""
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
    """Yield a descriptor that becomes readable when a signal arrives. Wait for it together with your input. A signal
    that arrives just before a plain read() would be handled only when the read() returns."""
    reads, writes = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
    before = signal.set_wakeup_fd(writes, warn_on_full_buffer=False)
    try:
        yield reads
    finally:
        signal.set_wakeup_fd(before)
        os.close(reads)
        os.close(writes)


def end_with_parent() -> None:
    """Make this process get SIGTERM when its parent dies. Call it in the child, before exec. Setup starts its
    supervisor this way, so the supervisor stops the wheels if setup dies."""
    _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
