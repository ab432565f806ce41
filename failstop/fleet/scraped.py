"""Scraped: the HTTP server for the metrics. Its threads and its memory stay limited, however many programs connect."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator
from socketserver import ThreadingMixIn
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer

MOST_CONNECTIONS = 8
"""How many connections may be open. If a new connection would exceed this number, the oldest connection is closed. This
does no harm, because a scrape takes only milliseconds, so the oldest connection must be idle."""
REQUEST_S = 5.0
"""The longest time that the server waits until it can read or send the next bytes, s."""


class Handler(WSGIRequestHandler):
    """Answers one request, without logging it."""

    timeout = REQUEST_S

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing, because a scrape comes every few seconds."""


class Server(ThreadingMixIn, WSGIServer):
    """An HTTP server with a thread for each connection. The oldest connection is closed if there are too many."""

    daemon_threads = True
    block_on_close = False

    def __init__(self, host: str, port: int) -> None:
        """Raises OSError, OverflowError."""
        self._open: dict[socket.socket, threading.Thread] = {}
        """The open connections, the oldest first, each with its thread. The thread that accepts connections adds them,
        and each connection's thread removes its own."""
        self.address_family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        super().__init__((host, port), Handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a new thread. If too many connections are open, close the oldest first."""
        known = list(self._open)
        for oldest in known[: max(0, len(known) - MOST_CONNECTIONS + 1)]:
            self._end(oldest)
        thread = threading.Thread(target=self._answer, args=(request, client_address), daemon=True)
        self._open[request] = thread
        thread.start()

    def _answer(self, request: Any, client_address: Any) -> None:
        try:
            self.process_request_thread(request, client_address)
        finally:
            self._open.pop(request, None)

    def _end(self, request: socket.socket) -> None:
        thread = self._open.get(request)
        with contextlib.suppress(OSError):
            request.shutdown(socket.SHUT_RDWR)
        if thread:
            thread.join(REQUEST_S)
        self._open.pop(request, None)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Report nothing, because an error only means that a connection ended in the middle of a request."""


@contextlib.contextmanager
def running(server: Server) -> Iterator[int]:
    """Make a context in which the server runs. Yields the server's port."""
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield server.server_port
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
