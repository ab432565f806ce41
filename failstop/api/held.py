"""Held: holds a futex while this program lives, so that the service notices when the program dies. An extra thread
holds it, and does nothing else."""

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
    """Holds a futex in an extra thread until let_go(), which any thread may call. The extra thread also ends when this
    object is freed, even if a signal handler raises an exception at that moment."""

    def __init__(self, word: Futex) -> None:
        """Start the extra thread, and wait until it holds the futex. Raises RuntimeError if no thread can be started,
        and OSError if no descriptor is left."""
        self._ends: SimpleQueue[object] = SimpleQueue()
        held = _thread.allocate_lock()
        held.acquire()
        # When this object is freed, the callback of this reference ends the thread. The thread itself keeps the
        # reference. Python code such as __del__ would not do, because an exception from a signal handler could
        # interrupt it.
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
        """End the extra thread, which releases the futex. Clear the word of the futex before this call."""
        self._ends.put(None)


def _live(word: Futex, ends: SimpleQueue[object], held: _thread.LockType, _gone: object) -> None:
    signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())  # signals are for the program's own threads
    # When a process dies, the kernel then runs this thread before the others. Until then it sleeps, and delays no
    # other.
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, _FIRST, os.sched_param(1))
    kept = None
    try:
        with contextlib.suppress(OSError):  # without this, the service notices a death later
            kept = word.hold()
    finally:
        held.release()
    ends.get()
    futex.let_go()
    del kept
    word.close()
