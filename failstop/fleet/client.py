"""Client: a client of paho-mqtt that reads its messages through an MqttWire (wire.py). Needs paho-mqtt."""

from __future__ import annotations

import ssl

from paho.mqtt import client

from failstop.fleet.wire import MqttWire

READ_BYTES = 1 << 16


class Client(client.Client):
    """A client of paho-mqtt. Received messages wait in `wire` until somebody takes them from there. paho-mqtt does not
    see them, and calls no callback for them."""

    wire = MqttWire()

    def _sock_recv(self, bufsize: int) -> bytes:
        """Return the next received bytes for paho-mqtt. They contain no messages, because messages stay in `wire`. If
        no such bytes wait, read the connection once. Empty if the connection has ended. Raises BlockingIOError if no
        byte that was read is for paho-mqtt."""
        if not self.wire.holds():
            data = super()._sock_recv(READ_BYTES)
            if not data:
                return b""
            self.wire.feed(data)
            if not self.wire.holds():
                raise BlockingIOError
        return self.wire.read(bufsize)

    def buffered(self) -> bool:
        """Return True while received bytes wait in `wire` or in TLS, where poll() does not see them."""
        found = self.socket()
        return self.wire.holds() or (isinstance(found, ssl.SSLSocket) and found.pending() > 0)

    def waits(self) -> bool:
        """Return True until the broker has acknowledged every message of this client."""
        return bool(self._out_messages)

    def drop(self) -> None:
        """Close the connection without MQTT's goodbye."""
        self._sock_close()
