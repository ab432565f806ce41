"""Handover: duplicates of the port's descriptor between processes, so that a stop never needs to open anything."""

from __future__ import annotations

# The C module under `socket`: the Python one costs 3 ms more to import and 0.6 MB more to tear down at a death.
import _socket
import struct

_FD = struct.Struct("i")
OPENING_NS = 2_000_000_000
"""Without a port there is nothing to move, and opening one that comes back takes several USB transfers, of a board that
may be slow to wake up. So the port owner is given this much beyond its deadlines."""


class Control:
    """One end of a process's control socket."""

    __slots__ = ("_socket", "fd")

    def __init__(self, fd: int) -> None:
        self.fd = fd
        self._socket = _socket.socket(_socket.AF_UNIX, _socket.SOCK_SEQPACKET, 0, fd)

    def send(self, fd: int) -> None:
        """Send a duplicate of a descriptor. A peer that has died does not need one: its successor inherits it. One that
        has no free descriptor number gets none, and the duplicate is lost."""
        packed = [(_socket.SOL_SOCKET, _socket.SCM_RIGHTS, _FD.pack(fd))]
        try:
            self._socket.sendmsg([b"port"], packed, _socket.MSG_DONTWAIT)
        except OSError:
            return

    def receive(self) -> int:
        """Return a descriptor that was sent, or -1 when none waits, it was lost, or the peer is gone."""
        flags = _socket.MSG_DONTWAIT | _socket.MSG_CMSG_CLOEXEC
        try:
            data, ancillary, _, _ = self._socket.recvmsg(16, _socket.CMSG_LEN(_FD.size), flags)
        except OSError:
            return -1
        for level, kind, packed in ancillary:
            if data and level == _socket.SOL_SOCKET and kind == _socket.SCM_RIGHTS and len(packed) >= _FD.size:
                fd: int = _FD.unpack_from(packed)[0]
                return fd
        return -1

    def close(self) -> None:
        """Close this end."""
        self._socket.close()


def pair() -> tuple[int, int]:
    """A new pair of connected control descriptors, closed on exec unless passed on."""
    mine, theirs = _socket.socketpair(_socket.AF_UNIX, _socket.SOCK_SEQPACKET)
    return mine.detach(), theirs.detach()
