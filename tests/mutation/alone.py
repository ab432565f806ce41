"""A mutant may signal anything: its tests run in a PID namespace of their own, and all they started ends with it."""

from __future__ import annotations

import ctypes
import os
import signal
from collections.abc import Callable

_NEWNS, _NEWPID = 0x20000, 0x20000000
_PRIVATE = 0x4000 | 0x40000  # MS_REC | MS_PRIVATE
_PDEATHSIG = 1
BROKEN = 35  # mutmut's "suspicious": the tests did not come to an end of their own

_libc = ctypes.CDLL(None, use_errno=True)


def _separate() -> None:
    """The next fork begins a PID namespace; this process gets mounts of its own at once."""
    if _libc.unshare(_NEWPID | _NEWNS) != 0:
        raise OSError(ctypes.get_errno(), "no PID namespace")


def _mount(what: bytes, where: bytes, kind: bytes | None, flags: int = 0) -> None:
    if _libc.mount(what, where, kind, ctypes.c_ulong(flags), None) != 0:
        raise OSError(ctypes.get_errno(), f"cannot mount {where.decode()}")


def _work(work: Callable[[], int]) -> None:
    code = BROKEN
    try:
        code = work()
    finally:
        os._exit(code)


def _first(work: Callable[[], int]) -> None:
    """The namespace's process 1: it has no handlers, so no signal from within reaches it. All end with it."""
    for number in signal.valid_signals():
        if callable(signal.getsignal(number)):
            signal.signal(number, signal.SIG_DFL)
    _libc.prctl(_PDEATHSIG, signal.SIGKILL)
    os.setsid()
    _mount(b"none", b"/", None, _PRIVATE)
    _mount(b"proc", b"/proc", b"proc")
    _mount(b"tmpfs", b"/dev/shm", b"tmpfs")  # the names there are made of pids, which others use as well
    os.environ["PYTEST_DEBUG_TEMPROOT"] = "/dev/shm"  # each pytest takes the rights of others off the one in /tmp
    tests = os.fork()
    if tests == 0:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        _work(work)
    while True:
        pid, status = os.wait()
        if pid == tests:
            code = os.waitstatus_to_exitcode(status)
            os._exit(code if code >= 0 else 128 - code)


def alone(work: Callable[[], int], *, separate: bool = True) -> int:
    """The exit code of this work, of a process in a PID namespace, a session and a /dev/shm of its own.

    128 and the signal's number when a signal ended it. Not `separate`: it has only the session. Raises OSError.
    """
    if separate:
        _separate()
    pid = os.fork()
    if pid == 0:
        if separate:
            try:
                _first(work)
            finally:
                os._exit(BROKEN)
        os.setsid()
        _work(work)
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    return code if code >= 0 else 128 - code


def possible() -> bool:
    """Whether this user may do so here: the kernel, or a container, may keep everybody but root from it, or all."""
    pid = os.fork()
    if pid == 0:
        _work(lambda: alone(lambda: 0))
    return os.waitpid(pid, 0)[1] == 0
