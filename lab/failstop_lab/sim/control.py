"""The simulated board's control socket: requests and answers as JSON, one per message (SOCK_SEQPACKET, mode 0600).

A request is an object with "op"; the answer is an object, with "error" when the request failed. One kind of request
waits: "events" with a timeout is answered when there are events or the time is up, so that a judge need not poll.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import socket
import stat
from collections.abc import Callable, Iterator
from typing import Any

from failstop_lab.sim.pty_port import SimError

ControlMessage = dict[str, Any]
SUFFIX = ".ctl"
MESSAGE_SIZE = 1 << 18
# The longest path that fits a socket address, less the final zero.
_LONGEST_PATH = 107


@contextlib.contextmanager
def address(path: str) -> Iterator[str]:
    """A name for a socket at `path` that fits a socket address however long the path is."""
    if len(os.fsencode(path)) <= _LONGEST_PATH:
        yield path
        return
    directory = os.open(os.path.dirname(path), os.O_PATH | os.O_CLOEXEC)
    try:
        yield f"/proc/self/fd/{directory}/{os.path.basename(path)}"
    finally:
        os.close(directory)


def connect(path: str, timeout_s: float | None) -> socket.socket:
    """Connect to a board's control socket. Raises OSError."""
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        connection.settimeout(timeout_s)
        with address(path) as name:
            connection.connect(name)
    except BaseException:
        connection.close()
        raise
    return connection


class Wait:
    """A request for the events from `since` on that is answered at deadline_ns, or earlier: when there are more than
    `total` events. Without a total the time alone counts."""

    __slots__ = ("deadline_ns", "since", "total")

    def __init__(self, since: int, deadline_ns: int, total: int | None) -> None:
        self.since = since
        self.deadline_ns = deadline_ns
        self.total = total

    def over(self, total: int, now_ns: int) -> bool:
        """Whether to answer, with `total` events executed by now."""
        return now_ns >= self.deadline_ns or (self.total is not None and total > self.total)


class ControlServer:
    """Listens at `path`. `handle` answers a request, or returns a Wait; `events` answers a Wait that is over."""

    def __init__(
        self,
        epoll: select.epoll,
        path: str,
        handle: Callable[[ControlMessage], ControlMessage | Wait],
        events: Callable[[int], ControlMessage],
    ) -> None:
        self.path = path
        self._epoll = epoll
        self._handle = handle
        self._events = events
        self._connections: dict[int, socket.socket] = {}
        self._waits: dict[int, Wait] = {}
        self._listener = _listen(path)
        epoll.register(self._listener, select.EPOLLIN)

    @property
    def next_ns(self) -> int | None:
        """When the first waiting request is to be answered at the latest."""
        return min((wait.deadline_ns for wait in self._waits.values()), default=None)

    @property
    def waiting(self) -> int:
        """How many requests are waiting."""
        return len(self._waits)

    def ready(self, descriptor: int) -> bool:
        """Serve a descriptor that epoll reported; false when it is none of this server's."""
        if descriptor == self._listener.fileno():
            with contextlib.suppress(OSError):
                connection, _ = self._listener.accept()
                connection.setblocking(False)
                self._connections[connection.fileno()] = connection
                self._epoll.register(connection, select.EPOLLIN)
            return True
        if descriptor not in self._connections:
            return False
        try:
            message = self._connections[descriptor].recv(MESSAGE_SIZE)
        except BlockingIOError:
            return True
        except OSError:
            message = b""
        if message:
            self._serve(descriptor, message)
        else:
            self._drop(descriptor)
        return True

    def answer_waits(self, total: int, now_ns: int) -> None:
        """Answer the waiting requests that there are events for, and those whose time is up."""
        over = [fd for fd, wait in self._waits.items() if wait.over(total, now_ns)]
        for descriptor in over:
            self._send(descriptor, self._events(self._waits.pop(descriptor).since))

    def close(self) -> None:
        """Close everything and remove the socket."""
        for descriptor in list(self._connections):
            self._drop(descriptor)
        self._epoll.unregister(self._listener)
        self._listener.close()
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self.path)

    def _serve(self, descriptor: int, message: bytes) -> None:
        try:
            request = json.loads(message)
            if not isinstance(request, dict):
                raise TypeError("a request is an object")
            answer = self._handle(request)
        except SimError as error:
            answer = {"error": str(error)}
        except (ValueError, TypeError, KeyError) as error:
            answer = {"error": f"not a request: {type(error).__name__}: {error}"}
        self._waits.pop(descriptor, None)
        if isinstance(answer, Wait):
            self._waits[descriptor] = answer
        else:
            self._send(descriptor, answer)

    def _send(self, descriptor: int, answer: ControlMessage) -> None:
        try:
            self._connections[descriptor].send(json.dumps(answer).encode())
        except OSError:
            # Gone, or does not read its answers: the board waits for nobody.
            self._drop(descriptor)

    def _drop(self, descriptor: int) -> None:
        self._waits.pop(descriptor, None)
        connection = self._connections.pop(descriptor)
        self._epoll.unregister(connection)
        connection.close()


def _listen(path: str) -> socket.socket:
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
    before = os.umask(0o177)
    try:
        with address(path) as name:
            try:
                listener.bind(name)
            except OSError:
                _remove_stale(path)
                listener.bind(name)
        listener.listen(16)
    except OSError as error:
        listener.close()
        raise SimError(f"cannot make {path}: {error.strerror}: name another place for the link") from None
    except SimError:
        listener.close()
        raise
    finally:
        os.umask(before)
    return listener


def _remove_stale(path: str) -> None:
    """Remove the socket of a board that has died; raise SimError when it lives or when that is no socket."""
    try:
        mode = os.lstat(path).st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(mode):
        raise SimError(f"{path} exists and is not a socket: remove it, or name another place for the link")
    try:
        connect(path, 1.0).close()
    except ConnectionRefusedError:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(path)
    except OSError as error:
        raise SimError(f"{path} is in use ({error}): name another place for the link") from None
    else:
        link = path.removesuffix(SUFFIX)
        raise SimError(f"a simulated board is running at {link} already: stop it, or name another place for the link")
