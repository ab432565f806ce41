"""The simulated `fcntl`, `termios`, `mmap`, `_socket` and `posix_ipc`."""

from __future__ import annotations

import _socket
import errno
import fcntl
import mmap
import struct
import termios
from typing import Any

from failstop_lab.machine import users
from failstop_lab.machine.calls import Calls, Module, constants
from failstop_lab.machine.files import IN, Directory, Fifo, Open, Regular, Socket
from failstop_lab.machine.port import Port
from failstop_lab.machine.process import Process

WHOLE = -1
"""The place of a lock on a whole file (flock)."""
_LOCK = struct.Struct("hhqqi4x")
_FD = struct.Struct("i")


class Fcntl(Module):
    """The module `fcntl`: record locks of open files, flock, and what a port is asked."""

    def __init__(self, calls: Calls) -> None:
        super().__init__("fcntl", calls, **constants(fcntl, "F_", "LOCK_", "FD_"))

    def fcntl(self, fd: int, command: int, argument: bytes = b"") -> Any:
        opened = self._calls.begin("fcntl", fd)
        kind, _, begin, _, _ = _LOCK.unpack(argument)
        locks = opened.node.locks
        other = locks.get(begin, opened) is not opened
        if command == fcntl.F_OFD_GETLK:
            return _LOCK.pack(fcntl.F_WRLCK if other else fcntl.F_UNLCK, 0, begin, 1, -1)
        if kind == fcntl.F_UNLCK:
            if not other:
                locks.pop(begin, None)
        elif other:
            raise BlockingIOError(errno.EAGAIN, "held")
        else:
            locks[begin] = opened
        return 0

    def flock(self, fd: int, operation: int) -> None:
        opened = self._calls.begin("flock", fd)
        locks = opened.node.locks
        other = locks.get(WHOLE, opened) is not opened
        if operation & fcntl.LOCK_UN:
            if not other:
                locks.pop(WHOLE, None)
        elif other:
            raise BlockingIOError(errno.EAGAIN, "held")
        else:
            locks[WHOLE] = opened

    def ioctl(self, fd: int, request: int, argument: Any = b"") -> Any:
        node = self._calls.begin("ioctl", fd).node
        if isinstance(node, Port):
            if node.gone:
                raise OSError(errno.EIO, "the device is gone")
            return _FD.pack(node.unsent()) if request == termios.TIOCOUTQ else argument
        if isinstance(node, Fifo) and request == termios.FIONREAD:
            return _FD.pack(len(node.data))
        raise OSError(errno.ENOTTY, "not a terminal")


class Termios(Module):
    """The module `termios`."""

    def __init__(self, calls: Calls) -> None:
        numbers = {name: value for name, value in vars(termios).items() if name.isupper()}
        super().__init__("termios", calls, **numbers, error=termios.error)

    def _port(self, fd: int) -> Port:
        node = self._calls.begin("tcattr", fd).node
        if not isinstance(node, Port) or node.gone:
            raise termios.error(errno.ENOTTY if not isinstance(node, Port) else errno.EIO, "no terminal")
        return node

    def tcgetattr(self, fd: int) -> list[Any]:
        settings = self._port(fd).settings
        return [*settings[:6], list(settings[6])]

    def tcsetattr(self, fd: int, when: int, settings: list[Any]) -> None:
        self._port(fd).settings = [*settings[:6], list(settings[6])]

    def tcflow(self, fd: int, action: int) -> None:
        self._port(fd)


class Mmap(Module):
    """The module `mmap`."""

    def __init__(self, calls: Calls) -> None:
        super().__init__("mmap", calls, **{name: value for name, value in vars(mmap).items() if name.isupper()})

    def mmap(self, fd: int, size: int, flags: int = 0, prot: int = 0) -> mmap.mmap:
        node = self._calls.begin("mmap", fd).node
        if not isinstance(node, Regular):
            raise OSError(errno.ENODEV, "not a file")
        return node.mapped()


class SimulatedSocket:
    """_socket.socket of an AF_UNIX pair."""

    def __init__(self, calls: Calls, fd: int) -> None:
        self._calls = calls
        self._fd = fd
        self._blocking = True

    def fileno(self) -> int:
        return self._fd

    def setblocking(self, blocking: bool) -> None:
        """Whether recv() waits; no other call does."""
        self._blocking = blocking

    def _own(self, call: str) -> tuple[Process, Open, Socket]:
        process = self._calls.process(call, self._fd)
        opened = self._calls.opened(process, self._fd)
        assert isinstance(opened.node, Socket)
        return process, opened, opened.node

    def sendmsg(self, buffers: list[bytes], ancillary: Any = (), flags: int = 0) -> int:
        process, _, node = self._own("sendmsg")
        passed = tuple(self._calls.opened(process, _FD.unpack_from(data)[0]) for _, _, data in ancillary)
        return node.send(b"".join(buffers), passed)

    def recvmsg(self, most: int, room: int = 0, flags: int = 0) -> tuple[bytes, list[Any], int, None]:
        process, _, node = self._own("recvmsg")
        data, passed = node.pop(most)
        fds = []
        for each in passed:
            each.references -= 1
            fds.append(process.descriptor(each))
        packed = b"".join(map(_FD.pack, fds))
        return data, [(_socket.SOL_SOCKET, _socket.SCM_RIGHTS, packed)] if fds else [], 0, None

    def send(self, data: bytes) -> int:
        return self._own("write")[2].send(data)

    def recv(self, most: int) -> bytes:
        _, opened, node = self._own("read")
        self._calls.wait_for((opened,), lambda: node.mask(opened) & IN, None if self._blocking else 0)
        return node.pop(most)[0]

    def shutdown(self, how: int) -> None:
        peer = self._own("shutdown")[2].peer
        if peer:
            peer.ended = True
            peer.notify()

    def detach(self) -> int:
        fd, self._fd = self._fd, -1
        return fd

    def close(self) -> None:
        if self._fd >= 0:
            self._calls.process("close").close(self.detach())


class Sockets(Module):
    """The module `_socket`: pairs alone, since the machine has no network."""

    CMSG_LEN = staticmethod(_socket.CMSG_LEN)

    def __init__(self, calls: Calls) -> None:
        super().__init__("_socket", calls, **constants(_socket, "AF_", "SOCK_", "SOL_", "SCM_", "MSG_", "SHUT_"))

    def socketpair(
        self, family: int = _socket.AF_UNIX, kind: int = _socket.SOCK_STREAM
    ) -> tuple[SimulatedSocket, SimulatedSocket]:
        process = self._calls.process("socketpair")
        packets = kind & 0xF == _socket.SOCK_SEQPACKET
        ends = Socket(packets=packets), Socket(packets=packets)
        ends[0].peer, ends[1].peer = ends[1], ends[0]
        first, second = (SimulatedSocket(self._calls, process.descriptor(Open(end))) for end in ends)
        return first, second

    def socket(self, family: int = 0, kind: int = 0, protocol: int = 0, fileno: int | None = None) -> SimulatedSocket:
        if fileno is None:
            raise OSError(errno.EAFNOSUPPORT, "no network here")
        return SimulatedSocket(self._calls, fileno)

    def close(self, fd: int) -> None:
        self._calls.process("close").close(fd)


class Error(Exception):
    """posix_ipc.Error."""


class SharedMemory:
    """posix_ipc.SharedMemory, newly made."""

    def __init__(self, calls: Calls, name: str, mode: int) -> None:
        process, folder = calls.process("shm_open", name), shared_folder(calls)
        if name.lstrip("/") in folder.names:
            raise Error("there is one of this name")
        made = users.made(process, Regular(mode))
        folder.put(name.lstrip("/"), made)
        self.fd = process.descriptor(Open(made))


def shared_folder(calls: Calls) -> Directory:
    """/dev/shm."""
    device = calls.machine.root.names["dev"]
    assert isinstance(device, Directory)
    folder = device.names["shm"]
    assert isinstance(folder, Directory)
    return folder


class PosixIpc(Module):
    """The module `posix_ipc`."""

    O_CREX = 1
    Error = Error

    def SharedMemory(self, name: str, flags: int = 0, mode: int = 0o600) -> SharedMemory:
        return SharedMemory(self._calls, name, mode)

    def unlink_shared_memory(self, name: str) -> None:
        process = self._calls.process("unlink", name)
        folder = shared_folder(self._calls)
        if name.lstrip("/") not in folder.names:
            raise Error("no such name")
        node = folder.names[name.lstrip("/")]
        users.check_drop(process, folder, node, name)
        if isinstance(node, Directory):
            raise IsADirectoryError(errno.EISDIR, "Is a directory", name)
        folder.drop(name.lstrip("/"))


def devices(calls: Calls) -> dict[str, Module]:
    """By name."""
    return {
        "fcntl": Fcntl(calls),
        "termios": Termios(calls),
        "mmap": Mmap(calls),
        "_socket": Sockets(calls),
        "posix_ipc": PosixIpc("posix_ipc", calls),
    }
