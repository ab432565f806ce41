"""Datagram: bytes for a Unix socket that somebody else keeps, never waited for."""

from __future__ import annotations

import _socket


class Outbox:
    """The sending end, made with the first datagram."""

    __slots__ = ("_address", "_socket")

    def __init__(self, address: str | bytes) -> None:
        self._address = address
        self._socket: _socket.socket | None = None

    def send(self, data: bytes) -> bool:
        """Send one datagram; False when it could not be handed over at once: nobody is there, or the queue is full."""
        try:
            if self._socket is None:
                kind = _socket.SOCK_DGRAM | _socket.SOCK_CLOEXEC | _socket.SOCK_NONBLOCK
                self._socket = _socket.socket(_socket.AF_UNIX, kind)
            # By its address each time: whoever was restarted may have another socket there.
            self._socket.sendto(data, self._address)
        except (OSError, ValueError):
            return False
        return True

    def close(self) -> None:
        """Let the socket go."""
        if self._socket:
            self._socket.close()
            self._socket = None
