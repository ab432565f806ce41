"""Files: what a descriptor of the simulated machine may be open on, and who waits for it."""

from __future__ import annotations

import errno
import mmap
import os
import stat
from collections import deque
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from failstop_lab.machine.epoll import Epoll
    from failstop_lab.machine.process import Process, Thread

IN, PRI, OUT, ERR, HUP = 1, 2, 4, 8, 16
PIPE_BYTES = 65536
COUNTER_MOST = 2**64 - 2


class Node:
    """A thing in the file system, or only behind descriptors."""

    kind = stat.S_IFREG
    count = 0
    news = 0
    """How often an epoll heard of something or was asked."""

    def __init__(self, mode: int = 0o600, uid: int = 0, gid: int = 0) -> None:
        Node.count += 1
        self.number = Node.count
        self.mode, self.uid, self.gid = mode, uid, gid
        self.links = 0
        self.changed_ns = self.number
        self.device = 0
        self.locks: dict[int, Open] = {}
        """Which open file has each locked byte. -1: the lock on the whole file (flock)."""
        self.opened: list[Open] = []

    def size(self) -> int:
        return 0

    def mask(self, opened: Open) -> int:
        """The events that poll() would tell."""
        return IN | OUT

    def notify(self) -> None:
        """Something may be ready: let each that waits look."""
        for opened in tuple(self.opened):
            opened.notify()

    def read(self, opened: Open, most: int) -> bytes:
        raise OSError(errno.EINVAL, "not for reading")

    def write(self, opened: Open, data: bytes) -> int:
        raise OSError(errno.EINVAL, "not for writing")

    def open(self, opened: Open) -> None:
        """Called when one more is open; raises OSError where it can't be."""

    def closed(self, opened: Open) -> None:
        """The last descriptor of `opened` is closed."""


class Open:
    """An open file: a node with an offset and flags, which descriptors share."""

    __slots__ = ("flags", "in_epolls", "node", "offset", "references", "waiting")

    def __init__(self, node: Node, flags: int = os.O_RDWR) -> None:
        node.open(self)
        self.node = node
        self.flags = flags
        self.offset = 0
        self.references = 0
        self.waiting: list[Thread] = []
        self.in_epolls: list[tuple[Epoll, int]] = []
        node.opened.append(self)

    def notify(self) -> None:
        for epoll, fd in self.in_epolls:
            epoll.mark(fd)
        if self.waiting:
            waiting, self.waiting = self.waiting, []
            for thread in waiting:
                thread.process.machine.wake(thread)

    def mask(self) -> int:
        return self.node.mask(self)

    def release(self) -> None:
        """One reference less: a descriptor, or one on its way to another process."""
        self.references -= 1
        if self.references:
            return
        for epoll, number in tuple(self.in_epolls):
            epoll.drop(number)
        self.node.opened.remove(self)
        for byte in [byte for byte, holder in self.node.locks.items() if holder is self]:
            del self.node.locks[byte]
        self.node.closed(self)


class Regular(Node):
    """A file's bytes. Once it is mapped, they are a map of this process's own, which all who map it share."""

    def __init__(self, mode: int = 0o600) -> None:
        super().__init__(mode)
        self.data: bytearray | mmap.mmap = bytearray()
        """The first bytes; those that are not here, up to the length, are zeros."""
        self._length = 0

    def size(self) -> int:
        return self._length

    def resize(self, size: int) -> None:
        if size == self._length:
            return
        if isinstance(self.data, mmap.mmap):
            raise OSError(errno.EBUSY, "a mapped file keeps its size here")
        self._length = size
        del self.data[size:]

    def mapped(self, size: int = 0) -> mmap.mmap:
        """As a map, of at least so many bytes."""
        if not isinstance(self.data, mmap.mmap):
            before, self._length = bytes(self.data), max(1, size, self._length)
            self.data = mmap.mmap(-1, self._length, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
            if before:
                self.data[: len(before)] = before
        return self.data

    def get(self, at: int, most: int) -> bytes:
        """So many bytes from a place on, or those that there are."""
        found = bytes(self.data[at : at + most])
        return found + bytes(max(0, min(most, self._length - at) - len(found)))

    def read(self, opened: Open, most: int) -> bytes:
        found = self.get(opened.offset, most)
        opened.offset += len(found)
        return found

    def write(self, opened: Open, data: bytes) -> int:
        at = self.size() if opened.flags & os.O_APPEND else opened.offset
        self.put(data, at)
        opened.offset = at + len(data)
        return len(data)

    def put(self, data: bytes, at: int) -> None:
        if at + len(data) > self._length:
            self.resize(at + len(data))
        if not isinstance(self.data, mmap.mmap) and at > len(self.data):
            self.data.extend(bytes(at - len(self.data)))
        self.data[at : at + len(data)] = data


class Directory(Node):
    """Names, and what has them."""

    kind = stat.S_IFDIR

    def __init__(self, mode: int = 0o755, above: Directory | None = None) -> None:
        super().__init__(mode)
        self.names: dict[str, Node] = {}
        self.above = above or self

    def found(self) -> dict[str, Node]:
        """The names that are looked up."""
        return self.names

    def put(self, name: str, node: Node) -> None:
        self.names[name] = node
        node.links += 1

    def folder(self, path: str, mode: int = 0o755) -> Directory:
        """The directory at a path below this one, made with all on the way where there is none."""
        here = self
        for part in filter(None, path.split("/")):
            if part not in here.names:
                here.put(part, Directory(mode, here))
            found = here.names[part]
            assert isinstance(found, Directory)
            here = found
        return here

    def drop(self, name: str) -> Node:
        node = self.names.pop(name)
        node.links -= 1
        return node


class Fifo(Node):
    """A named pipe."""

    kind = stat.S_IFIFO

    def __init__(self, mode: int) -> None:
        super().__init__(mode)
        self.data = bytearray()
        self.openers: list[Thread] = []
        """Those whose open waits for the other end."""
        self.looks = 0
        """How often it was asked for its state, or changed."""

    def open(self, opened: Open) -> None:
        self.looks += 1
        openers, self.openers = self.openers, []
        for thread in openers:
            thread.process.machine.wake(thread)

    def ends(self, *modes: int) -> int:
        """How many are open so."""
        return sum(opened.flags & 3 in modes for opened in self.opened)

    def mask(self, opened: Open) -> int:
        self.looks += 1
        mask = 0
        if opened.flags & 3 != os.O_WRONLY:
            mask |= IN if self.data else 0
            mask |= 0 if self.ends(os.O_WRONLY, os.O_RDWR) else HUP
        if opened.flags & 3 != os.O_RDONLY:
            mask |= OUT if len(self.data) < PIPE_BYTES else 0
            mask |= 0 if self.ends(os.O_RDONLY, os.O_RDWR) else ERR
        return mask

    def read(self, opened: Open, most: int) -> bytes:
        self.looks += 1
        if not self.data:
            if self.ends(os.O_WRONLY, os.O_RDWR):
                raise BlockingIOError(errno.EAGAIN, "empty")
            return b""
        found = bytes(self.data[:most])
        del self.data[:most]
        return found

    def write(self, opened: Open, data: bytes) -> int:
        self.looks += 1
        if not self.ends(os.O_RDONLY, os.O_RDWR):
            raise BrokenPipeError(errno.EPIPE, "nobody reads")
        if len(self.data) + len(data) > PIPE_BYTES:
            raise BlockingIOError(errno.EAGAIN, "full")
        self.data += data
        self.notify()
        return len(data)

    def closed(self, opened: Open) -> None:
        self.looks += 1
        self.notify()


class Counter(Node):
    """An eventfd."""

    kind = 0

    def __init__(self, value: int = 0) -> None:
        super().__init__()
        self.value = value

    def mask(self, opened: Open) -> int:
        return (IN if self.value else 0) | (OUT if self.value < COUNTER_MOST else 0)

    def read(self, opened: Open, most: int) -> bytes:
        if not self.value:
            raise BlockingIOError(errno.EAGAIN, "not rung")
        value, self.value = self.value, 0
        return value.to_bytes(8, "little")

    def write(self, opened: Open, data: bytes) -> int:
        added = int.from_bytes(data, "little")
        if self.value + added > COUNTER_MOST:
            raise BlockingIOError(errno.EAGAIN, "full")
        self.value += added
        self.notify()
        return 8


class Null(Node):
    """/dev/null, and every standard stream: `heard` gets what is written there."""

    kind = stat.S_IFCHR

    def __init__(self) -> None:
        super().__init__(0o666)
        self.heard: list[bytes] = []

    def read(self, opened: Open, most: int) -> bytes:
        return b""

    def write(self, opened: Open, data: bytes) -> int:
        self.heard.append(bytes(data))
        return len(data)


class Pidfd(Node):
    """Readable once its process has ended."""

    kind = 0

    def __init__(self, process: Process) -> None:
        super().__init__()
        self.process = process

    def mask(self, opened: Open) -> int:
        return IN if self.process.code is not None else 0

    def closed(self, opened: Open) -> None:
        self.process.watchers = [each for each in self.process.watchers if each is not opened]


class Socket(Node):
    """One end of a pair; `queue` holds what came: bytes, and descriptors with them."""

    kind = stat.S_IFSOCK

    def __init__(self, *, packets: bool) -> None:
        super().__init__()
        self.packets = packets
        self.peer: Socket | None = None
        self.queue: deque[tuple[bytes, list[Open]]] = deque()
        self.ended = False

    def mask(self, opened: Open) -> int:
        gone = self.peer is None
        return (IN if self.queue or gone or self.ended else 0) | OUT | (HUP if gone else 0)

    def write(self, opened: Open, data: bytes) -> int:
        return self.send(data)

    def send(self, data: bytes, files: tuple[Open, ...] = ()) -> int:
        """To the other end, with descriptors."""
        if self.peer is None:
            raise BrokenPipeError(errno.EPIPE, "the other end is closed")
        for each in files:
            each.references += 1
        self.peer.queue.append((bytes(data), list(files)))
        self.peer.notify()
        return len(data)

    def pop(self, most: int) -> tuple[bytes, list[Open]]:
        if not self.queue:
            if self.peer is None or self.ended:
                return b"", []
            raise BlockingIOError(errno.EAGAIN, "nothing has come")
        data, files = self.queue.popleft()
        if not self.packets and len(data) > most:
            self.queue.appendleft((data[most:], []))
        return data[:most], files

    def read(self, opened: Open, most: int) -> bytes:
        return self.pop(most)[0]

    def closed(self, opened: Open) -> None:
        peer, self.peer = self.peer, None
        for _, passed in self.queue:
            for each in passed:
                each.release()
        self.queue.clear()
        if peer:
            peer.peer = None
            peer.notify()
