"""Handover: duplicates of the port's descriptor between processes, so that a stop never needs to open anything."""

from __future__ import annotations

# The C module under `socket`: the Python one costs 3 ms more to import and 0.6 MB more to tear down at a death.
import _socket
import struct

from failstop.messages.records import PATH_BYTES, cut

_FD = struct.Struct("i")
_NUMBER = struct.Struct("<Q")


class Control:
    """One end of a process's control socket."""

    def __init__(self, fd: int) -> None:
        self.fd = fd
        self._socket = _socket.socket(_socket.AF_UNIX, _socket.SOCK_SEQPACKET, 0, fd)

    def send(self, fd: int, number: int, path: str) -> None:
        """Send a duplicate of the port's descriptor, its number in this run and its path. A peer that has died does not
        need one: its successor inherits it. One that has no free descriptor number gets none: the duplicate is lost."""
        packed = [(_socket.SOL_SOCKET, _socket.SCM_RIGHTS, _FD.pack(fd))]
        try:
            self._socket.sendmsg([_NUMBER.pack(number) + cut(path, PATH_BYTES)], packed, _socket.MSG_DONTWAIT)
        except OSError:
            return

    def receive(self) -> tuple[int, int, str] | None:
        """Return (descriptor, number, path) of a port that was sent; None: none waits, it was lost, the peer is
        gone."""
        flags = _socket.MSG_DONTWAIT | _socket.MSG_CMSG_CLOEXEC
        try:
            data, ancillary, _, _ = self._socket.recvmsg(_NUMBER.size + PATH_BYTES, _socket.CMSG_LEN(_FD.size), flags)
        except OSError:
            return None
        for level, kind, packed in ancillary:
            if data and level == _socket.SOL_SOCKET and kind == _socket.SCM_RIGHTS and len(packed) >= _FD.size:
                (number,) = _NUMBER.unpack_from(data)
                return _FD.unpack_from(packed)[0], number, data[_NUMBER.size :].decode("utf-8", "replace")
        return None

    def close(self) -> None:
        self._socket.close()


def pair() -> tuple[int, int]:
    """A new pair of connected control descriptors, closed on exec unless passed on."""
    mine, theirs = _socket.socketpair(_socket.AF_UNIX, _socket.SOCK_SEQPACKET)
    return mine.detach(), theirs.detach()
