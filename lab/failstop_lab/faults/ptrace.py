"""An endless loop put into a running process: it is alive, takes its processor time, and never beats again."""

from __future__ import annotations

import ctypes
import os
import platform

_PEEK, _POKE, _ATTACH, _DETACH = 1, 4, 16, 17
_GETREGSET, _PRSTATUS = 0x4204, 1
_WALL = 0x40000000
_LOOPS = {"x86_64": (16, b"\xeb\xfe"), "aarch64": (32, b"\x00\x00\x00\x14")}
"""By machine: which of the general registers is the program counter, and the instruction that jumps to itself."""


class _Span(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))


_libc = ctypes.CDLL(None, use_errno=True)
_libc.ptrace.argtypes = (ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p)
_libc.ptrace.restype = ctypes.c_long


def unfit() -> str:
    """Why this machine can't do it; empty when it can."""
    machine = platform.machine()
    return "" if machine in _LOOPS else f"no loop instruction for {machine} is known here"


def spin(pid: int) -> None:
    """Let the process's main thread loop forever from its next instruction on; only a kill ends it. Raises OSError."""
    counter, loop = _LOOPS[platform.machine()]
    _call(_ATTACH, pid)
    try:
        os.waitpid(pid, _WALL)
        registers = (ctypes.c_uint64 * 80)()
        span = _Span(ctypes.addressof(registers), ctypes.sizeof(registers))
        _call(_GETREGSET, pid, _PRSTATUS, ctypes.addressof(span))
        at = registers[counter]
        word = _call(_PEEK, pid, at).to_bytes(8, "little", signed=True)
        _call(_POKE, pid, at, int.from_bytes(loop + word[len(loop) :], "little"))
    finally:
        _call(_DETACH, pid)


def _call(request: int, pid: int, address: int = 0, data: int = 0) -> int:
    ctypes.set_errno(0)
    result: int = _libc.ptrace(request, pid, address, data)
    if error := ctypes.get_errno():
        raise OSError(error, f"ptrace: {os.strerror(error)}")
    return result
