"""Handover: passes duplicates of the port's descriptor from one process to another, so that a process need not open the
port before it can stop the robot."""

from __future__ import annotations

# The C module under `socket`. The Python module costs 3 ms more to import, and 0.6 MB more to free when the process
# dies.
import _socket
import os
import struct
from collections.abc import Callable

from failstop.messages import layout, records
from failstop.messages.records import PATH_BYTES, cut
from failstop.procs.loop import GONE, Loop

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.procs.context import Context

_FD = struct.Struct("i")
_NUMBER = struct.Struct("<Q")


class Control:
    """One end of a process's control socket, through which the supervisor sends ports."""

    def __init__(self, fd: int) -> None:
        self.fd = fd
        self._socket = _socket.socket(_socket.AF_UNIX, _socket.SOCK_SEQPACKET, 0, fd)

    def send(self, fd: int, number: int, path: str) -> None:
        """Send a duplicate of the port's descriptor, with the port's number in this run and its path. Errors are
        ignored, because the successor of a dead process inherits the port. If the other process has no free descriptor
        number, the duplicate is lost."""
        packed = [(_socket.SOL_SOCKET, _socket.SCM_RIGHTS, _FD.pack(fd))]
        try:
            self._socket.sendmsg([_NUMBER.pack(number) + cut(path, PATH_BYTES)], packed, _socket.MSG_DONTWAIT)
        except OSError:
            return

    def receive(self) -> tuple[int, int, str] | None:
        """Return (descriptor, number, path) of a port that the supervisor has sent. None if no port was sent, or if its
        descriptor was lost."""
        flags = _socket.MSG_DONTWAIT | _socket.MSG_CMSG_CLOEXEC
        try:
            data, ancillary, _, _ = self._socket.recvmsg(_NUMBER.size + PATH_BYTES, _socket.CMSG_LEN(_FD.size), flags)
        except OSError:
            return None
        for level, kind, packed in ancillary:
            if level == _socket.SOL_SOCKET and kind == _socket.SCM_RIGHTS and len(packed) >= _FD.size:
                (fd,) = _FD.unpack_from(packed)
                if len(data) >= _NUMBER.size:
                    (number,) = _NUMBER.unpack_from(data)
                    return fd, number, data[_NUMBER.size :].decode("utf-8", "replace")
                os.close(fd)
        return None

    def newer(self, ready: dict[int, int], least: int) -> tuple[int, int, str] | None:
        """Like receive(), but only for ports whose number is at least `least`. The descriptors of older ports are
        closed. Returns None if `ready` does not show that something was sent."""
        while self.fd in ready and (sent := self.receive()):
            if sent[1] >= least:
                return sent
            os.close(sent[0])
        return None

    def close(self) -> None:
        self._socket.close()


class HeldPort:
    """Holds the port in a process other than the port owner. It adopts newer descriptors from the supervisor, and
    publishes the port's number in a word of shared memory (0 without a port). It closes the port as soon as the device
    is gone, because the device would otherwise come back with a different name."""

    def __init__(
        self, context: Context, loop: Loop, control: Control, adopt: Callable[[int], None], wanted: int
    ) -> None:
        """`adopt`: called with each new descriptor, which replaces the old one (-1 means no port). `wanted`: the events
        for which the loop watches the port."""
        self._loop, self._control, self._adopt, self._wanted = loop, control, adopt, wanted
        self._record = context.segment(layout.PORT_OWNER).latest_reader("port")
        self._word = context.own.word("port_number")
        self._number = context.port_number
        self._hold(context.fd("port"))

    def _hold(self, fd: int) -> None:
        self._fd = fd
        self._word.set(self._number if fd >= 0 else 0)
        if fd >= 0:
            self._loop.watch(fd, self._wanted)

    def watch(self, wanted: int) -> None:
        """Watch the port for the events in `wanted` from now on."""
        if wanted != self._wanted:
            self._wanted = wanted
            if self._fd >= 0:
                self._loop.watch(self._fd, wanted)

    def follow(self, ready: dict[int, int], *, lost: bool) -> bool:
        """Close the port if the device is gone, and adopt a port that the supervisor has sent. Call it once per turn.
        `lost`: True if this process has found that the port is gone. Returns True if it adopted a descriptor, of a new
        port or of the same one."""
        taken = False
        given_up = records.port_state(self._record.read(), self._number) == records.PORT_LOST  # by the port owner
        if ready.get(self._fd, 0) & GONE or lost or given_up:
            self.let_go()
        while sent := self._control.newer(ready, self._number + (self._fd >= 0)):
            self.let_go()
            fd, self._number, _ = sent
            self._adopt(fd)
            self._hold(fd)
            taken = True
        return taken

    def let_go(self) -> None:
        """Close the port, if it is open."""
        if self._fd >= 0:
            self._loop.forget(self._fd)
            self._adopt(-1)
            self._hold(-1)


def pair() -> tuple[int, int]:
    """Return a new pair of connected control sockets, as descriptors. Processes inherit them only if they are passed
    on."""
    mine, theirs = _socket.socketpair(_socket.AF_UNIX, _socket.SOCK_SEQPACKET)
    return mine.detach(), theirs.detach()
