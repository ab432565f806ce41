"""A futex that reports this program's death. A thread that only waits holds it."""

from __future__ import annotations

import _thread
import contextlib
import os
import signal
import weakref

# The C module under `queue`.
from _queue import SimpleQueue

from failstop.shm import futex
from failstop.shm.futex import Futex

_FIRST = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK


class HeldByThread:
    """A futex that is held by a thread of its own, so any thread may release it. The thread also ends when this object
    is freed, even if a signal handler raises an exception at any moment, so none is left behind."""

    def __init__(self, word: Futex) -> None:
        """Returns once it is held. Raises RuntimeError if no thread can be started, OSError if there is no descriptor
        left."""
        self._ends: SimpleQueue[object] = SimpleQueue()
        held = _thread.allocate_lock()
        held.acquire()
        # The thread keeps the reference whose callback tells it that this object is freed. In Python code, such as
        # __del__, an exception of the next signal handler could prevent that.
        gone = weakref.ref(self, self._ends.put)
        word.detach()
        try:
            try:
                _thread.start_new_thread(_live, (word, self._ends, held, gone))
            except RuntimeError:
                word.close()
                raise
            held.acquire()
        except BaseException:
            self.let_go()
            raise

    def let_go(self) -> None:
        """End the thread. The caller must clear the word of the futex before."""
        self._ends.put(None)


def _live(word: Futex, ends: SimpleQueue[object], held: _thread.LockType, _gone: object) -> None:
    signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())  # signals are for the program's own threads
    # Among a process's dying threads, the kernel then runs this one first. It sleeps until then, and delays nobody.
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, _FIRST, os.sched_param(1))
    kept = None
    try:
        with contextlib.suppress(OSError):  # without it the late news still comes
            kept = word.hold()
    finally:
        held.release()
    ends.get()
    futex.let_go()
    del kept
    word.close()
