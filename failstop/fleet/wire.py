"""Wire: what a broker sends, cut into packets before paho-mqtt reads it. Pure.

A broker passes on whatever others publish: any size, any topic, at any rate. Messages are taken out here, all that have
come at once, so that their reader can begin with the newest. The rest, answers to what this client has said, is left
for paho-mqtt.
"""

from __future__ import annotations

Message = tuple[str, bytes, bool]
"""A published message: (topic, payload, whether the broker had kept it)."""
MOST_BYTES = 1 << 17
"""The longest packet, bytes. A longer one is skipped as it comes in, and never kept in memory."""
LONGEST_HEAD = 5
PUBLISH, KIND, QOS, RETAIN = 0x30, 0xF0, 0x06, 0x01
"""Bits of a packet's first byte."""


class Malformed(ConnectionError):
    """Bytes that are no MQTT: what comes after them can't be read either."""


class MqttWire:
    """One connection's."""

    def __init__(self) -> None:
        self.skipped = 0
        """Packets that were too long, or messages without a topic that can be read."""
        self._bytes = bytearray()
        self._skip = 0
        """Bytes still to come of a packet that was too long."""
        self._rest = bytearray()
        self._messages: list[Message] = []

    def feed(self, data: bytes) -> None:
        """Bytes have come. Raises Malformed."""
        self._bytes += data
        at, end = min(self._skip, len(self._bytes)), len(self._bytes)
        self._skip -= at
        while head := _head(self._bytes, at):
            body, after = head
            if after - at > MOST_BYTES:
                self.skipped += 1
                self._skip = max(0, after - end)
                at = min(after, end)
                continue
            if after > end:
                break
            self._sort(at, body, after)
            at = after
        del self._bytes[:at]

    def _sort(self, start: int, body: int, end: int) -> None:
        """One whole packet: a message that asks for no acknowledgement, or something for paho-mqtt."""
        first = self._bytes[start]
        if first & (KIND | QOS) != PUBLISH:
            self._rest += self._bytes[start:end]
            return
        payload = body + 2 + int.from_bytes(self._bytes[body : body + 2], "big")
        try:
            topic = self._bytes[body + 2 : payload].decode()
        except UnicodeDecodeError:
            topic = ""
        if not topic or payload > end:
            self.skipped += 1
            return
        self._messages.append((topic, bytes(self._bytes[payload:end]), bool(first & RETAIN)))

    def holds(self) -> bool:
        """True while there is something for paho-mqtt."""
        return bool(self._rest)

    def read(self, most: int) -> bytes:
        """Bytes for paho-mqtt, at most so many."""
        taken = bytes(self._rest[:most])
        del self._rest[:most]
        return taken

    def messages(self) -> list[Message]:
        """The messages that have arrived since the last call, the oldest first."""
        taken, self._messages = self._messages, []
        return taken


def _head(data: bytearray, at: int) -> tuple[int, int] | None:
    """Where the body of the packet that begins there is, and where it ends; None: too little of it has come."""
    length = 0
    for place in range(at + 1, min(at + LONGEST_HEAD, len(data))):
        length |= (data[place] & 0x7F) << (7 * (place - at - 1))
        if data[place] < 0x80:
            return place + 1, place + 1 + length
    if len(data) >= at + LONGEST_HEAD:
        raise Malformed("no length of a packet")
    return None
