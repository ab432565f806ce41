"""Ending: whatever ends a program that turns wheels by a service of its own ends it by way of wheels at rest. The
laboratory's programs end so too."""

from __future__ import annotations

import contextlib
import ctypes
import signal
from collections.abc import Iterator
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_PR_SET_PDEATHSIG = 1
_libc = ctypes.CDLL(None, use_errno=True)


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """A lost terminal and a kill end it as Ctrl-C does: by way of wheels at rest."""

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
    """None of these signals is heard: an end that is interrupted would leave the wheels to chance."""
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
    """These signals interrupt nothing: the list that is yielded gets the number of each that arrives."""
    found: list[int] = []

    def note(number: int, _frame: FrameType | None) -> None:
        found.append(number)

    before = {number: signal.signal(number, note) for number in SIGNALS}
    try:
        yield found
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def end_with_parent() -> None:
    """In the child, before exec: SIGTERM when the parent dies. The supervisor then stops the wheels and ends."""
    _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
