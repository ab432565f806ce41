"""Connections: how many connections there may be. A flood must neither use up descriptors nor keep a STOP out."""

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
    """A connection of any kind."""

    def close(self) -> None:
        """End it."""


T = TypeVar("T", bound=Closes)

MOST = 256
"""Connections that are no websocket, or not yet."""
IDLE_S = 10.0
"""How long a connection may take to send the head of its next request."""
BODY_S = 5.0
MOST_HEAD = 16 * 1024
MOST_BODY = 4 * 1024


class Places(Generic[T]):
    """Connections of one kind, so many at most. When all places are taken, the address that has most of them gives its
    oldest to the newcomer, which may be a STOP."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._held: dict[T, str] = {}

    def __len__(self) -> int:
        return len(self._held)

    def add(self, one: T, address: str) -> None:
        """A newcomer."""
        while len(self._held) >= self._most:
            fullest, _ = Counter(self._held.values()).most_common(1)[0]
            oldest = next(each for each, whose in self._held.items() if whose == fullest)
            del self._held[oldest]
            oldest.close()
        self._held[one] = address

    def leave(self, one: T) -> None:
        """Give a place back."""
        self._held.pop(one, None)

    def all(self) -> tuple[T, ...]:
        """The connections that have a place, the oldest first."""
        return tuple(self._held)


class BoundedServer(HTTPServer):
    """Every new connection has one of MOST places until it becomes a websocket, of which there are limits of their
    own."""

    def initialize(self, *arguments: Any, names: frozenset[str] = frozenset(), **options: Any) -> None:
        """As of tornado's HTTPServer; the limits are set here. `names`: what the robot answers to."""
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
        """A new connection."""
        if len(self._places) >= MOST:
            for each in self._places.all():
                if each.closed():
                    self._places.leave(each)
        self._places.add(stream, str(address[0]) if address else "")
        if isinstance(stream, SSLIOStream):
            plain.attend(stream, self._names)
        super().handle_stream(stream, address)

    def let_in(self, stream: IOStream) -> None:
        """A connection that has become a websocket: floods of others can't close it."""
        self._places.leave(stream)
