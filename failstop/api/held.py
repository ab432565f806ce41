"""A futex that tells of this program's death, held by a thread that only waits."""

from __future__ import annotations

import _thread
import contextlib
import os
import signal

from failstop.shm import futex
from failstop.shm.futex import Futex

_FIRST = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK


class HeldByThread:
    """A futex that a thread of its own holds, which does nothing else: whichever thread may let it go."""

    def __init__(self, word: Futex) -> None:
        """Returns once it is held. Raises RuntimeError when there are no more threads."""
        self._until = _thread.allocate_lock()
        self._until.acquire()
        held = _thread.allocate_lock()
        held.acquire()
        _thread.start_new_thread(self._live, (word, held))
        held.acquire()

    def _live(self, word: Futex, held: _thread.LockType) -> None:
        signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())  # they are for the program's own threads
        # Of a process's dying threads the kernel then runs this one first. It sleeps until then, and delays nobody.
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, _FIRST, os.sched_param(1))
        kept = None
        try:
            with contextlib.suppress(OSError):  # without it there is the late news
                kept = word.hold()
        finally:
            held.release()
        self._until.acquire()
        futex.let_go()
        del kept
        word.close()

    def let_go(self) -> None:
        """Once. The word is the caller's to clear, before."""
        self._until.release()
