"""Rights: what a process asks of the kernel for itself - real-time scheduling, locked memory, death with its parent, an
end at once when it crashes or loops, open files."""

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
"""Processor time at real-time priority without a pause after which the kernel ends this process: a loop there takes the
core from all of lower priority, with the last core from those who are to stop for it."""
SUPERVISOR_LOOP_US = 500_000
"""The supervisor's: a loop of the lowest of the stop path keeps nobody from stopping, and its end is the service's. The
kernel counts whole ticks, those of a core that a virtual machine's host withholds too. It is less than the time after
which the kernel pauses all real-time processes of a core (sched_rt_runtime_us)."""

DESCRIPTORS = 68
"""Descriptors that the supervisor has open at most: 52 with every process, segment and bell, 5 of a dead run's, 2 for
each of 4 savers, and those that a look at a file takes."""
STACK_BYTES = 256 * 1024
"""Room for the stack of each process: four times that with which all of them ran."""

_libc = ctypes.CDLL(None, use_errno=True)


def name_process(name: str) -> None:
    """The name that ps and top show: at most 15 bytes."""
    _libc.prctl(_PR_SET_NAME, name.encode()[:15], 0, 0, 0)


def die_with_parent(parent_pid: int) -> None:
    """SIGKILL this process when its parent dies. A parent that died before the call is noticed: raises SystemExit."""
    _libc.prctl(_PR_SET_PDEATHSIG, _SIGKILL, 0, 0, 0)
    if os.getppid() != parent_pid:
        raise SystemExit(f"parent {parent_pid} is gone")


@contextlib.contextmanager
def realtime(priority: int) -> Iterator[bool]:
    """Whether the kernel gives this process SCHED_FIFO at `priority` when it asks; the process has it within. Limits
    and capabilities do not tell: a container or a control group may refuse all the same."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        yield False
        return
    try:
        yield True
    finally:
        with contextlib.suppress(PermissionError):  # a priority that it inherited, and may not take itself
            os.sched_setscheduler(0, *before)


def take_rights(priority: int) -> int:
    """Ask for SCHED_FIFO at `priority` and locked memory; returns the heartbeat bits of what was granted, and of the
    early news, which some kernels don't give.

    What this process starts begins without real-time rights, so that a restart's imports disturb nobody's tick.

    A process that crashes leaves no dump. That one ends which loops (LOOP_US) begins with settle(): a start
    takes longer than any turn.

    Memory is locked as it is touched (MCL_ONFAULT): locking all of it doubles the resident size, and with it the time
    that the kernel needs to report this process's death.
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
    """End the start-up: collect once, and leave the rest to reference counting; a loop of `loop_us` is now the end."""
    gc.collect()
    gc.freeze()
    gc.disable()
    _limit(resource.RLIMIT_RTTIME, loop_us)


def _limit(which: int, soft: int | None) -> None:
    """A soft limit, as near as the hard one lets it be; None: the hard one. What is started here may set its own."""
    _, hard = resource.getrlimit(which)
    if soft is None or 0 <= hard < soft:
        soft = hard
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(which, (soft, hard))


def take_room() -> None:
    """See to it that this process, and those that it starts, can have DESCRIPTORS open, and have STACK_BYTES for their
    stacks: the first call that needs more ends a process by SIGSEGV, without a word. A limit that a process may raise
    itself is raised. Raises OSError."""
    needed = (resource.RLIMIT_NOFILE, DESCRIPTORS, no_descriptors), (resource.RLIMIT_STACK, STACK_BYTES, _no_stack)
    for which, least, told in needed:
        soft, hard = resource.getrlimit(which)
        if 0 <= hard < least:
            raise OSError(told(hard))
        if 0 <= soft < least:
            resource.setrlimit(which, (least, hard))


def no_descriptors(most: int) -> str:
    """Advice where RLIMIT_NOFILE, `most`, is too low."""
    return _too_low(f"RLIMIT_NOFILE is {most}", f"{DESCRIPTORS} open files", "`ulimit -n 1024`, or LimitNOFILE=")


def _no_stack(most: int) -> str:
    return _too_low(f"RLIMIT_STACK is {most >> 10} KB", f"{STACK_BYTES >> 10} KB", "`ulimit -s 8192`, or LimitSTACK=")


def _too_low(what: str, needed: str, how: str) -> str:
    return f"{what}, and {needed} are needed: raise it ({how} of a systemd unit)"
