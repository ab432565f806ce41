"""Client: paho-mqtt's, with an MqttWire between it and its socket. Needs paho-mqtt."""

from __future__ import annotations

import ssl

from paho.mqtt import client

from failstop.fleet.wire import MqttWire

READ_BYTES = 1 << 16


class Client(client.Client):
    """Messages are taken from its wire, and come by no callback."""

    wire = MqttWire()

    def _sock_recv(self, bufsize: int) -> bytes:
        """Bytes that paho-mqtt asks for: of the connection, read once, what is no message."""
        if not self.wire.holds():
            data = super()._sock_recv(READ_BYTES)
            if not data:
                return b""
            self.wire.feed(data)
            if not self.wire.holds():
                raise BlockingIOError
        return self.wire.read(bufsize)

    def buffered(self) -> bool:
        """True while there are bytes that no poll tells of: sorted out, or read by TLS."""
        found = self.socket()
        return self.wire.holds() or (isinstance(found, ssl.SSLSocket) and found.pending() > 0)

    def waits(self) -> bool:
        """True while the broker has not acknowledged a message that asks for it."""
        return bool(self._out_messages)

    def drop(self) -> None:
        """Close the connection without MQTT's own end."""
        self._sock_close()
