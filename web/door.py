"""Door: how many connections there may be. A flood must neither use up descriptors nor keep a STOP out."""

from __future__ import annotations

from collections import Counter

from tornado.httpserver import HTTPServer
from tornado.iostream import SSLIOStream

from failstop.web import plain

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from tornado.iostream import IOStream

MOST = 256
IDLE_S = 10.0
"""How long a connection may take to send the head of its next request."""
BODY_S = 5.0
MOST_HEAD = 16 * 1024
MOST_BODY = 4 * 1024


class Door(HTTPServer):
    """Of too many connections, the oldest idle one of whoever has most is closed: the newest may be a STOP."""

    def initialize(self, *arguments: Any, names: frozenset[str] = frozenset(), **options: Any) -> None:
        """As of tornado's HTTPServer; the limits are set here. `names`: what the robot answers to."""
        self._names = names
        self._streams: dict[IOStream, str] = {}
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
        if len(self._streams) >= MOST:
            self._make_room()
        self._streams[stream] = str(address[0]) if address else ""
        if isinstance(stream, SSLIOStream):
            plain.attend(stream, self._names)
        super().handle_stream(stream, address)

    def let_in(self, stream: IOStream) -> None:
        """It is a viewer now, and those are counted by themselves."""
        self._streams.pop(stream, None)

    def _make_room(self) -> None:
        self._streams = {stream: address for stream, address in self._streams.items() if not stream.closed()}
        while len(self._streams) >= MOST:
            most, _ = Counter(self._streams.values()).most_common(1)[0]
            oldest = next(stream for stream, address in self._streams.items() if address == most)
            del self._streams[oldest]
            oldest.close()
