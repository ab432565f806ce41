"""Rights: what a process requests from the kernel for itself: real-time scheduling, locked memory, to be killed when
its parent dies, to end at once when it crashes or loops, and enough open files."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import resource
from collections.abc import Iterator

from failstop.shm import futex
from failstop.shm.heartbeat import EARLY_NEWS, MEMORY_LOCKED, REALTIME

_PR_SET_PDEATHSIG, _PR_SET_NAME = 1, 15
_SIGKILL = 9
_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4

LOOP_US = 100_000
"""The kernel kills this process if it runs for this long at real-time priority without a pause. Otherwise an endless
loop would take the core from every process of lower priority. On a computer with one free core those are also the
processes that must stop the wheels because of the loop."""
SUPERVISOR_LOOP_US = 500_000
"""The same limit for the supervisor. It is longer, because the supervisor has the lowest priority on the stop path, so
its loop delays no stop, but its end is the end of the service. The kernel counts whole ticks, including those that the
host of a virtual machine withholds. The limit must be shorter than the time after which the kernel pauses all real-time
processes of a core (sched_rt_runtime_us)."""

DESCRIPTORS = 68
"""The most descriptors that the supervisor has open: 52 with every process, segment and bell, 5 for a dead run, 2 for
each of 4 savers, and a few to read files."""
STACK_BYTES = 256 * 1024
"""The stack size of each process: four times the most that any of them was seen to need."""

_libc = ctypes.CDLL(None, use_errno=True)


def name_process(name: str) -> None:
    """Set the name that ps and top show; at most 15 bytes."""
    _libc.prctl(_PR_SET_NAME, name.encode()[:15], 0, 0, 0)


def die_with_parent(parent_pid: int) -> None:
    """Make the kernel kill this process (SIGKILL) when its parent dies. Raises SystemExit if the parent has died
    already."""
    _libc.prctl(_PR_SET_PDEATHSIG, _SIGKILL, 0, 0, 0)
    if os.getppid() != parent_pid:
        raise SystemExit(f"parent {parent_pid} is gone")


@contextlib.contextmanager
def realtime(priority: int) -> Iterator[bool]:
    """Ask the kernel for SCHED_FIFO at `priority`, and yield whether it was granted; within the block the process has
    it. Asking is the only way to know, because a container or a control group may refuse what limits and capabilities
    allow."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        yield False
        return
    try:
        yield True
    finally:
        with contextlib.suppress(PermissionError):  # an inherited priority that this process may not set itself
            os.sched_setscheduler(0, *before)


def request_rights(priority: int) -> int:
    """Ask for SCHED_FIFO at `priority` and locked memory; returns the heartbeat bits of the granted rights, and of the
    early news of deaths, which some kernels don't give.

    Processes started from this one begin without real-time rights, so that the imports of a restart disturb no tick.

    A process that crashes leaves no dump. The limit that ends an endless loop (LOOP_US) applies from settle() on,
    because a start takes longer than any turn.

    Memory is locked as it is touched (MCL_ONFAULT). Locking all of it would double the resident size, and with it the
    time that the kernel needs to report this process's death.
    """
    granted = 0
    futex.leave_no_dump()
    _limit(resource.RLIMIT_RTTIME, None)
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
        granted |= REALTIME
    if _libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) == 0:
        granted |= MEMORY_LOCKED
    if futex.proven():
        granted |= EARLY_NEWS
    return granted


def settle(loop_us: int = LOOP_US) -> None:
    """End the start-up: collect garbage once and leave the rest to reference counting. From now on, a loop of `loop_us`
    kills the process."""
    gc.collect()
    gc.freeze()
    gc.disable()
    _limit(resource.RLIMIT_RTTIME, loop_us)


def _limit(which: int, soft: int | None) -> None:
    """Set a soft limit, or as much of it as the hard limit allows; None: set it to the hard limit. Processes that are
    started here may set their own."""
    _, hard = resource.getrlimit(which)
    if soft is None or 0 <= hard < soft:
        soft = hard
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(which, (soft, hard))


def raise_limits() -> None:
    """Make sure that this process and those that it starts can open DESCRIPTORS and have STACK_BYTES of stack;
    otherwise the first call that needs more would end a process by SIGSEGV without a message. Raises the limits that a
    process may raise itself. Raises OSError."""
    needed = (resource.RLIMIT_NOFILE, DESCRIPTORS, no_descriptors), (resource.RLIMIT_STACK, STACK_BYTES, _no_stack)
    for which, least, remedy in needed:
        soft, hard = resource.getrlimit(which)
        if 0 <= hard < least:
            raise OSError(remedy(hard))
        if 0 <= soft < least:
            resource.setrlimit(which, (least, hard))


def no_descriptors(most: int) -> str:
    """What to do if the limit of open files (RLIMIT_NOFILE, `most`) is too low."""
    return _too_low(f"RLIMIT_NOFILE is {most}", f"{DESCRIPTORS} open files", "`ulimit -n 1024`, or LimitNOFILE=")


def _no_stack(most: int) -> str:
    return _too_low(f"RLIMIT_STACK is {most >> 10} KB", f"{STACK_BYTES >> 10} KB", "`ulimit -s 8192`, or LimitSTACK=")


def _too_low(what: str, needed: str, how: str) -> str:
    return f"{what}, and {needed} are needed: raise it ({how} of a systemd unit)"
