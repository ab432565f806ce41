"""Rights: what a process asks of the kernel for itself - real-time scheduling, locked memory, death with its parent."""

from __future__ import annotations

import ctypes
import gc
import os

from failstop.shm import futex
from failstop.shm.heartbeat import EARLY_NEWS, MEMORY_LOCKED, REALTIME

_PR_SET_PDEATHSIG = 1
_PR_SET_NAME = 15
_SIGKILL = 9
_MCL_CURRENT = 1
_MCL_FUTURE = 2
_MCL_ONFAULT = 4

_libc = ctypes.CDLL(None, use_errno=True)


def name_process(name: str) -> None:
    """The name that ps and top show: at most 15 bytes."""
    _libc.prctl(_PR_SET_NAME, name.encode()[:15], 0, 0, 0)


def die_with_parent(parent_pid: int) -> None:
    """SIGKILL this process when its parent dies. A parent that died before the call is noticed: raises SystemExit."""
    _libc.prctl(_PR_SET_PDEATHSIG, _SIGKILL, 0, 0, 0)
    if os.getppid() != parent_pid:
        raise SystemExit(f"parent {parent_pid} is gone")


def take_rights(priority: int) -> int:
    """Ask for SCHED_FIFO at `priority` and locked memory; returns the heartbeat bits of what was granted, and of the
    early news, which some kernels don't give.

    What this process starts begins without real-time rights, so that a restart's imports disturb nobody's tick.

    Memory is locked as it is touched (MCL_ONFAULT): locking all of it doubles the resident size, and with it the time
    that the kernel needs to report this process's death.
    """
    granted = 0
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
        granted |= REALTIME
    except PermissionError:
        pass
    if _libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) == 0:
        granted |= MEMORY_LOCKED
    if futex.proven():
        granted |= EARLY_NEWS
    return granted


def settle() -> None:
    """End of the start-up: collect once, freeze what is there and leave reference counting to do the rest."""
    gc.collect()
    gc.freeze()
    gc.disable()
