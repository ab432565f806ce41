"""A futex that tells of this program's death, held by a thread that only waits."""

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
    """A futex that a thread of its own holds, which does nothing else: any thread may let it go. The thread ends when
    nobody refers to this any more, too: whatever moment an exception of a signal's handler comes at, none is left."""

    def __init__(self, word: Futex) -> None:
        """Returns once it is held. Raises RuntimeError for want of a thread, OSError for want of a descriptor."""
        self._ends: SimpleQueue[object] = SimpleQueue()
        held = _thread.allocate_lock()
        held.acquire()
        # The thread keeps the reference that tells it of this object's end. In Python's words, as in a __del__, the
        # next handler's exception could keep the thread from being told.
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
        """End the thread. The word is the caller's to clear, before."""
        self._ends.put(None)


def _live(word: Futex, ends: SimpleQueue[object], held: _thread.LockType, _gone: object) -> None:
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
    ends.get()
    futex.let_go()
    del kept
    word.close()
