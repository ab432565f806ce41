"""Handover: duplicates of the port's descriptor between processes, so that a stop never needs to open anything."""

from __future__ import annotations

# The C module under `socket`: the Python one costs 3 ms more to import and 0.6 MB more to tear down at a death.
import _socket
import os
import struct

from failstop.messages import layout, records
from failstop.messages.records import PATH_BYTES, cut
from failstop.procs.loop import GONE

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Protocol

    from failstop.procs.context import Context
    from failstop.procs.loop import Loop

    class PortDescriptor(Protocol):
        """A descriptor of the port, whatever it is held for."""

        fd: int
        """-1: none."""
        lost: bool

        def adopt(self, fd: int) -> None:
            """Take another."""

        def close(self) -> None:
            """Let it go."""


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

    def newer(self, ready: dict[int, int], least: int) -> tuple[int, int, str] | None:
        """As receive(), of what this wake-up brings. One with a number below `least` is known, and was sent twice."""
        while self.fd in ready and (sent := self.receive()):
            if sent[1] >= least:
                return sent
            os.close(sent[0])
        return None

    def close(self) -> None:
        self._socket.close()


class HeldPort:
    """The port of a process that does not own it, taken as the supervisor hands it down, let go at once when it has
    gone: a descriptor kept open over a USB drop renumbers the device. A word tells which port it is."""

    def __init__(self, context: Context, loop: Loop, control: Control, port: PortDescriptor, wanted: int) -> None:
        """`wanted`: what the loop watches it for."""
        self._loop, self._control, self._port, self._wanted = loop, control, port, wanted
        self._record = context.segment(layout.PORT_OWNER).latest_reader("port")
        self._word = context.own.word("port_number")
        self._number = context.port_number
        self._word.set(0)
        if port.fd >= 0:
            self._hold()

    def _hold(self) -> None:
        self._word.set(self._number)
        self._loop.watch(self._port.fd, self._wanted)

    def watch(self, wanted: int) -> None:
        """Watch it for something else from here on."""
        if wanted != self._wanted:
            self._wanted = wanted
            if self._port.fd >= 0:
                self._loop.watch(self._port.fd, wanted)

    def follow(self, ready: dict[int, int]) -> bool:
        """Once a turn. True when it has taken one, a new one or its own again where that was closed."""
        port, taken = self._port, False
        given_up = records.port_state(self._record.read(), self._number) == records.PORT_LOST  # by the port owner
        if ready.get(port.fd, 0) & GONE or port.lost or given_up:
            self.let_go()
        while sent := self._control.newer(ready, self._number + (port.fd >= 0)):
            self.let_go()
            fd, self._number, _ = sent
            port.adopt(fd)
            self._hold()
            taken = True
        return taken

    def let_go(self) -> None:
        if self._port.fd >= 0:
            self._loop.forget(self._port.fd)
            self._port.close()
            self._word.set(0)


def pair() -> tuple[int, int]:
    """A new pair of connected control descriptors, closed on exec unless passed on."""
    mine, theirs = _socket.socketpair(_socket.AF_UNIX, _socket.SOCK_SEQPACKET)
    return mine.detach(), theirs.detach()
