"""Scraped: the HTTP server for the metrics. Whatever connects, it has few threads and little memory."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator
from socketserver import ThreadingMixIn
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer

MOST_CONNECTIONS = 8
"""One more closes the oldest: a scrape takes milliseconds, so that one is idle."""
REQUEST_S = 5.0
"""How long a request may take to come, or an answer to be taken."""


class Handler(WSGIRequestHandler):
    """One request, without a line on stderr."""

    timeout = REQUEST_S

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: a scrape comes every few seconds."""


class Server(ThreadingMixIn, WSGIServer):
    """A thread for each of the newest connections."""

    daemon_threads = True
    block_on_close = False

    def __init__(self, host: str, port: int) -> None:
        """Raises OSError, OverflowError."""
        self._open: dict[socket.socket, threading.Thread] = {}
        """In the order in which they came; the thread that accepts adds to it, each other takes its own away."""
        self.address_family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        super().__init__((host, port), Handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread of its own, after the oldest has ended where there are too many."""
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
        """Nothing: a connection has ended in the midst of a request."""


@contextlib.contextmanager
def running(server: Server) -> Iterator[int]:
    """Serve while the context lasts; gives the port."""
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield server.server_port
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
