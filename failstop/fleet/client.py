"""Client: paho-mqtt's client, with an MqttWire between it and its socket. Needs paho-mqtt."""

from __future__ import annotations

import ssl

from paho.mqtt import client

from failstop.fleet.wire import MqttWire

READ_BYTES = 1 << 16


class Client(client.Client):
    """A client of paho-mqtt whose messages are taken from its wire; no callback delivers them."""

    wire = MqttWire()

    def _sock_recv(self, bufsize: int) -> bytes:
        """Give paho-mqtt the bytes that it asks for, without messages, after one read of the connection."""
        if not self.wire.holds():
            data = super()._sock_recv(READ_BYTES)
            if not data:
                return b""
            self.wire.feed(data)
            if not self.wire.holds():
                raise BlockingIOError
        return self.wire.read(bufsize)

    def buffered(self) -> bool:
        """True while bytes are left that poll() does not report, because they were sorted out already or TLS has read
        them."""
        found = self.socket()
        return self.wire.holds() or (isinstance(found, ssl.SSLSocket) and found.pending() > 0)

    def waits(self) -> bool:
        """True while the broker has not acknowledged a message that needs it."""
        return bool(self._out_messages)

    def drop(self) -> None:
        """Close the connection without MQTT's own goodbye."""
        self._sock_close()
