"""Plain: answers a browser that speaks HTTP on the HTTPS port. This happens if somebody leaves out `https://` in the
address."""

from __future__ import annotations

import contextlib
import re
import socket
import ssl

from failstop.web import guard

TYPE_CHECKING = False
if TYPE_CHECKING:
    from tornado.iostream import IOStream

HOST = re.compile(rb"\r\nHost:[ \t]*([A-Za-z0-9.:\[\]-]{1,255})[ \t]*\r\n", re.IGNORECASE)
SENTENCE = "This port speaks HTTPS: use an address that begins with https://"
MOST = 16 * 1024


def answer(request: bytes, known: frozenset[str]) -> bytes:
    """Return the answer to a plain HTTP request on the HTTPS port, with a sentence for the person. A request to one of
    this robot's hosts is also redirected to HTTPS. `request`: the request, perhaps without its first bytes, because the
    TLS library has read them already."""
    found = HOST.search(request)
    host = found[1].decode("ascii") if found else ""
    name = guard.host_of(host)
    own = guard.is_address(name) or name in known
    rows = [
        "HTTP/1.1 307 Temporary Redirect" if own else "HTTP/1.1 400 Bad Request",
        *([f"Location: https://{host}/"] if own else []),
        "Content-Type: text/plain; charset=utf-8",
        f"Content-Length: {len(SENTENCE) + 1}",
        "Connection: close",
    ]
    return ("\r\n".join(rows) + f"\r\n\r\n{SENTENCE}\n").encode()


def attend(stream: IOStream, known: frozenset[str]) -> None:
    """Make a TLS connection answer a browser that speaks plain HTTP. The answer is sent just before the connection is
    closed. `known`: the robot's host names."""
    close_fd = stream.close_fd

    def answered() -> None:
        if isinstance(stream.error, ssl.SSLError) and stream.error.reason == "HTTP_REQUEST":
            with contextlib.suppress(OSError):
                _send_answer(stream.socket, known)
        close_fd()

    stream.close_fd = answered  # type: ignore[method-assign]


def _send_answer(connection: socket.socket, known: frozenset[str]) -> None:
    """Send the answer without TLS. The rest of the request must be read first. Otherwise the kernel would reset the
    connection, and the answer would be lost."""
    request = socket.socket.recv(connection, MOST)
    socket.socket.send(connection, answer(request, known))
    socket.socket.shutdown(connection, socket.SHUT_WR)
