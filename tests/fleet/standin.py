"""A stand-in of a broker, for tests where there is no mosquitto: MQTT 3.1.1 as far as a fleet needs it. The tests that
use it are run on a mosquitto too, where there is one."""

from __future__ import annotations

import contextlib
import dataclasses
import selectors
import socket
import threading
from collections.abc import Callable

from failstop.fleet.settings import FleetSettings

May = Callable[[str, str], bool]


def matches(wanted: str, topic: str) -> bool:
    """Whether a subscription, with `+` and `#` in it, is for that topic."""
    want, have = wanted.split("/"), topic.split("/")
    if want[-1] == "#":
        want, have = want[:-1], have[: len(want) - 1]
    return len(want) == len(have) and all(a in ("+", b) for a, b in zip(want, have, strict=True))


def text(body: bytes, at: int) -> tuple[bytes, int]:
    """The string that begins there, and where it ends."""
    end = at + 2 + int.from_bytes(body[at : at + 2], "big")
    return body[at + 2 : end], end


def packet(first: int, body: bytes) -> bytes:
    length, head = len(body), b""
    while True:
        length, digit = divmod(length, 128)
        head += bytes([digit | (0x80 if length else 0)])
        if not length:
            return bytes([first]) + head + body


@dataclasses.dataclass(eq=False)
class Link:
    """A client's connection."""

    socket: socket.socket
    data: bytes = b""
    client: str = ""
    user: str = ""
    will: tuple[str, bytes, bool] | None = None
    wanted: list[str] = dataclasses.field(default_factory=list)


class Standin:
    """A broker on a port of its own, in a thread. Killed and started again, it has forgotten everything."""

    def __init__(
        self,
        may_read: May = lambda _user, _topic: True,
        may_write: May = lambda _user, _topic: True,
        *,
        users_are_clients: bool = False,
    ) -> None:
        """`may_read`: whether a user gets a message on a topic; `may_write`: whether a user's message on a topic is
        taken, or dropped without a word; `users_are_clients`: a second connection of a user takes over the first
        one."""
        self._may_read = may_read
        self._may_write = may_write
        self._users_are_clients = users_are_clients
        self.port = 0

    def start(self) -> None:
        """Listen, on the port that it had, or on one that is free."""
        self._listener = socket.create_server(("127.0.0.1", self.port))
        self.port = self._listener.getsockname()[1]
        self._kept: dict[str, bytes] = {}
        self._links: dict[socket.socket, Link] = {}
        self._ends, self._end = socket.socketpair()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def kill(self) -> None:
        """All connections end; nobody's last will is published."""
        self._end.close()
        self._thread.join()

    def settings(self, **changed: object) -> FleetSettings:
        """Settings to get there; `changed`: with `__` for the dot."""
        given = {key.replace("__", "."): value for key, value in changed.items()}
        return FleetSettings({"broker.port": self.port, "broker.keepalive_s": 2, **given})

    def _run(self) -> None:
        with selectors.DefaultSelector() as self._ready, self._ends, self._listener:
            for each in (self._ends, self._listener):
                self._ready.register(each, selectors.EVENT_READ)
            while True:
                found = [key.fileobj for key, _ in self._ready.select()]
                if self._ends in found:
                    break
                if self._listener in found:
                    link = Link(self._listener.accept()[0])
                    self._links[link.socket] = link
                    self._ready.register(link.socket, selectors.EVENT_READ)
                for link in [link for link in self._links.values() if link.socket in found]:
                    if link.socket in self._links:  # not lost by what another one has just done
                        self._read(link)
            for left in self._links:
                left.close()

    def _read(self, link: Link) -> None:
        with contextlib.suppress(OSError):
            if data := link.socket.recv(1 << 16):
                link.data += data
                while link.socket in self._links and self._take(link):
                    pass
                return
        self._lose(link)

    def _lose(self, link: Link) -> None:
        """It is gone, without a word unless its will was dropped."""
        self._ready.unregister(link.socket)
        del self._links[link.socket]
        link.socket.close()
        if link.will:
            self._publish(*link.will)

    def _take(self, link: Link) -> bool:
        """Deal with one packet; False: the rest of it has not come."""
        length = at = 0
        for at in range(1, min(5, len(link.data))):
            length |= (link.data[at] & 0x7F) << (7 * (at - 1))
            if link.data[at] < 0x80:
                break
        else:
            return False
        end = at + 1 + length
        if len(link.data) < end:
            return False
        first, body, link.data = link.data[0], link.data[at + 1 : end], link.data[end:]
        kind = first >> 4
        if kind == 1:
            self._connect(link, body)
        elif kind == 3:
            topic, at = text(body, 0)
            if first & 0x06:
                self._send(link, packet(0x40, body[at : at + 2]))
                at += 2
            if self._may_write(link.user, topic.decode()):
                self._publish(topic.decode(), body[at:], bool(first & 1))
        elif kind == 8:
            self._subscribe(link, body)
        elif kind == 12:
            self._send(link, b"\xd0\x00")
        elif kind == 14:
            link.will = None
            self._lose(link)
        return True

    def _connect(self, link: Link, body: bytes) -> None:
        _, at = text(body, 0)
        flags = body[at + 1]
        client, at = text(body, at + 4)
        if flags & 0x04:
            topic, at = text(body, at)
            payload, at = text(body, at)
            link.will = topic.decode(), payload, bool(flags & 0x20)
        link.user = text(body, at)[0].decode() if flags & 0x80 else ""
        link.client = link.user if self._users_are_clients else client.decode()
        for other in list(self._links.values()):
            if other is not link and other.client == link.client:
                self._lose(other)
        self._send(link, b"\x20\x02\x00\x00")

    def _subscribe(self, link: Link, body: bytes) -> None:
        at, new = 2, []
        while at < len(body):
            wanted, at = text(body, at)
            new.append(wanted.decode())
            at += 1
        link.wanted += new
        self._send(link, packet(0x90, body[:2] + bytes(len(new))))
        for topic, payload in self._kept.items():
            if any(matches(wanted, topic) for wanted in new):
                self._deliver(link, topic, payload, 0x31)

    def _publish(self, topic: str, payload: bytes, retain: bool) -> None:
        if retain and payload:
            self._kept[topic] = payload
        elif retain:
            self._kept.pop(topic, None)
        for link in list(self._links.values()):
            if any(matches(wanted, topic) for wanted in link.wanted):
                self._deliver(link, topic, payload, 0x30)

    def _deliver(self, link: Link, topic: str, payload: bytes, first: int) -> None:
        if self._may_read(link.user, topic):
            self._send(link, packet(first, len(topic.encode()).to_bytes(2, "big") + topic.encode() + payload))

    def _send(self, link: Link, data: bytes) -> None:
        with contextlib.suppress(OSError):
            link.socket.sendall(data)
