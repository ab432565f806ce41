"""Collector: whether Python's garbage collector is at work in this thread.

A finalizer (`__del__`, a callback of `weakref.finalize`, a generator's `finally`) may run at any moment, in the middle
of any process, and after its machine has ended. The collector's make no calls (Machine.finalizer), and a call that
comes too late is a Death.
"""

from __future__ import annotations

import gc
from _thread import get_ident
from collections.abc import Mapping

_thread = 0
"""The thread of Python's in which it runs; 0: it does not."""


def _on_collection(phase: str, _: Mapping[str, int]) -> None:
    global _thread
    _thread = get_ident() if phase == "start" else 0


def at_work() -> bool:
    return _thread != 0 and _thread == get_ident()


gc.callbacks.append(_on_collection)
