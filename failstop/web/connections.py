"""Connections: limits how many connections the page has open. Otherwise a flood of connections could use up the file
descriptors, and a STOP could not get through."""

from __future__ import annotations

from collections import Counter
from typing import Any, Generic, Protocol, TypeVar

from tornado.httpserver import HTTPServer
from tornado.iostream import SSLIOStream

from failstop.web import plain

TYPE_CHECKING = False
if TYPE_CHECKING:
    from tornado.iostream import IOStream


class Closes(Protocol):
    """Anything that can be closed, for example a connection."""

    def close(self) -> None:
        """Close the connection."""


T = TypeVar("T", bound=Closes)

MOST = 256
"""How many connections may be open at once. A connection counts until it becomes a websocket."""
IDLE_S = 10.0
"""How long to wait for the head of the next request before the connection is closed, s."""
BODY_S = 5.0
MOST_HEAD = 16 * 1024
MOST_BODY = 4 * 1024


class Places(Generic[T]):
    """A limited number of places for connections. A new connection always gets a place, because it may be a STOP. If
    all places are taken, the network address that holds the most places loses its oldest connection."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._held: dict[T, str] = {}

    def __len__(self) -> int:
        return len(self._held)

    def add(self, one: T, address: str) -> None:
        """Give a place to a new connection from `address`."""
        while len(self._held) >= self._most:
            fullest, _ = Counter(self._held.values()).most_common(1)[0]
            oldest = next(each for each, whose in self._held.items() if whose == fullest)
            del self._held[oldest]
            oldest.close()
        self._held[one] = address

    def leave(self, one: T) -> None:
        """Free the place of a connection."""
        self._held.pop(one, None)

    def all(self) -> tuple[T, ...]:
        """Return the connections that have a place, the oldest first."""
        return tuple(self._held)


class BoundedServer(HTTPServer):
    """An HTTP server with at most MOST open connections. Websockets don't count, because they have their own limits."""

    def initialize(self, *arguments: Any, names: frozenset[str] = frozenset(), **options: Any) -> None:
        """Set up tornado's HTTPServer with limits for the connections, for example MOST and IDLE_S. `names`: the host
        names of the robot."""
        self._names = names
        self._places: Places[IOStream] = Places(MOST)
        options |= {
            "idle_connection_timeout": IDLE_S,
            "body_timeout": BODY_S,
            "max_header_size": MOST_HEAD,
            "max_body_size": MOST_BODY,
            "max_buffer_size": 2 * MOST_HEAD,
        }
        super().initialize(*arguments, **options)

    def handle_stream(self, stream: IOStream, address: Any) -> None:
        """Handle a new connection."""
        if len(self._places) >= MOST:
            for each in self._places.all():
                if each.closed():
                    self._places.leave(each)
        self._places.add(stream, str(address[0]) if address else "")
        if isinstance(stream, SSLIOStream):
            plain.attend(stream, self._names)
        super().handle_stream(stream, address)

    def let_in(self, stream: IOStream) -> None:
        """Free the place of a connection that has become a websocket. Otherwise a flood of connections could close the
        websocket."""
        self._places.leave(stream)
