"""Rights: what a process requests from the kernel for itself. It asks for real-time scheduling, locked memory and
enough open files. It also asks to be killed when its parent dies or when it loops endlessly, and to leave no dump when
it crashes."""

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
"""How long, in us, this process may run at real-time priority without a pause. The kernel kills it if it runs longer.
Without this limit, an endless loop would take the core from every process of lower priority. If only one core is free,
these are also the processes that must notice the loop and stop the wheels."""
SUPERVISOR_LOOP_US = 500_000
"""The limit for the supervisor, in us, in place of LOOP_US. It is longer, because the service ends if the supervisor is
killed. It can be longer, because the supervisor has the lowest priority on the stop path, so a loop in it delays no
stop. The kernel counts whole ticks, even those in which a virtual machine did not get the processor. The limit must be
shorter than the time after which the kernel pauses all real-time processes of a core (sched_rt_runtime_us)."""

DESCRIPTORS = 68
"""The most descriptors that the supervisor has open. These are 52 for the processes, segments and bells, 5 for the
memory of an earlier run that died, 2 for each of 4 savers of black boxes, and a few to read files."""
STACK_BYTES = 256 * 1024
"""The stack size of each process. It is four times the most that any process was seen to need."""

_libc = ctypes.CDLL(None, use_errno=True)


def name_process(name: str) -> None:
    """Set the name that ps and top show for this process. Only the first 15 bytes count."""
    _libc.prctl(_PR_SET_NAME, name.encode()[:15], 0, 0, 0)


def die_with_parent(parent_pid: int) -> None:
    """Make the kernel kill this process (SIGKILL) when its parent dies. Raises SystemExit if the parent is dead
    already."""
    _libc.prctl(_PR_SET_PDEATHSIG, _SIGKILL, 0, 0, 0)
    if os.getppid() != parent_pid:
        raise SystemExit(f"parent {parent_pid} is gone")


@contextlib.contextmanager
def realtime(priority: int) -> Iterator[bool]:
    """Ask the kernel for SCHED_FIFO at `priority` for the length of the `with` block. Yields True if the kernel has
    granted it. Don't check limits and capabilities instead, because a container or a control group may still refuse."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        yield False
        return
    try:
        yield True
    finally:
        with contextlib.suppress(PermissionError):  # the old priority was inherited, and this process may not set it
            os.sched_setscheduler(0, *before)


def request_rights(priority: int) -> int:
    """Ask for SCHED_FIFO at `priority` and for locked memory. Returns what this process has, as bits of its heartbeat:
    REALTIME, MEMORY_LOCKED, and EARLY_NEWS if the kernel reports deaths early.

    Child processes begin without real-time rights, so the imports of a restarted process don't delay the ticks of the
    others. A process that crashes leaves no dump. The limit for endless loops (LOOP_US) begins with settle(), because a
    start takes longer than any turn.

    Memory is locked only when it is first used (MCL_ONFAULT). Locking all of it would double the resident size, and
    with it the time that the kernel needs to report this process's death.
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
    """End the start-up. Collect garbage once, and turn the collector off, so that only reference counting frees memory.
    From now on, the kernel kills the process if it runs at real-time priority for `loop_us` without a pause."""
    gc.collect()
    gc.freeze()
    gc.disable()
    _limit(resource.RLIMIT_RTTIME, loop_us)


def _limit(which: int, soft: int | None) -> None:
    """Set a soft limit to `soft`, or to the hard limit if that is lower or if `soft` is None. The hard limit stays, so
    child processes may set their own."""
    _, hard = resource.getrlimit(which)
    if soft is None or 0 <= hard < soft:
        soft = hard
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(which, (soft, hard))


def raise_limits() -> None:
    """Make sure that this process and its child processes can open DESCRIPTORS files and have STACK_BYTES of stack.
    With too small a stack, SIGSEGV would kill a process without a message. Raises OSError if a hard limit is too
    low."""
    needed = (resource.RLIMIT_NOFILE, DESCRIPTORS, no_descriptors), (resource.RLIMIT_STACK, STACK_BYTES, _no_stack)
    for which, least, remedy in needed:
        soft, hard = resource.getrlimit(which)
        if 0 <= hard < least:
            raise OSError(remedy(hard))
        if 0 <= soft < least:
            resource.setrlimit(which, (least, hard))


def no_descriptors(most: int) -> str:
    """Return a text that says what to do if the limit of open files (RLIMIT_NOFILE) is too low. `most`: the limit that
    was found."""
    return _too_low(f"RLIMIT_NOFILE is {most}", f"{DESCRIPTORS} open files", "`ulimit -n 1024`, or LimitNOFILE=")


def _no_stack(most: int) -> str:
    return _too_low(f"RLIMIT_STACK is {most >> 10} KB", f"{STACK_BYTES >> 10} KB", "`ulimit -s 8192`, or LimitSTACK=")


def _too_low(what: str, needed: str, how: str) -> str:
    return f"{what}, and {needed} are needed: raise it ({how} of a systemd unit)"
