"""Wire: splits the bytes from a broker into packets before paho-mqtt reads them. Pure.

A broker passes on messages of any size and at any rate. This module takes the messages out of the bytes, so that the
reader can handle the newest message first. The remaining packets are the broker's answers to this client, and paho-mqtt
reads them.
"""

from __future__ import annotations

Message = tuple[str, bytes, bool]
"""A published message: (topic, payload, True if the broker had stored it)."""
MOST_BYTES = 1 << 17
"""The longest allowed packet, bytes. A longer one is skipped while it arrives, and is never kept in memory."""
LONGEST_HEAD = 5
PUBLISH, KIND, QOS, RETAIN = 0x30, 0xF0, 0x06, 0x01
"""Bits of a packet's first byte."""


class Malformed(ConnectionError):
    """The bytes are not MQTT, so nothing after them can be read either."""


class MqttWire:
    """Sorts the bytes of one connection into messages and other packets."""

    def __init__(self) -> None:
        self.skipped = 0
        """How many packets were skipped, because they were too long or their topic could not be read."""
        self._bytes = bytearray()
        self._skip = 0
        """How many bytes of a skipped packet have not arrived yet."""
        self._rest = bytearray()
        self._messages: list[Message] = []

    def feed(self, data: bytes) -> None:
        """Add bytes that have arrived. Raises Malformed."""
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
        """Sort a complete packet. A message that needs no acknowledgement is kept here, unless its topic can't be read.
        Any other packet is left for paho-mqtt."""
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
        """Return True while there are bytes for paho-mqtt."""
        return bool(self._rest)

    def read(self, most: int) -> bytes:
        """Return at most `most` bytes for paho-mqtt."""
        taken = bytes(self._rest[:most])
        del self._rest[:most]
        return taken

    def messages(self) -> list[Message]:
        """Return the messages that have arrived since the last call, the oldest first."""
        taken, self._messages = self._messages, []
        return taken


def _head(data: bytearray, at: int) -> tuple[int, int] | None:
    """Return where the body of the packet at `at` begins and ends. None if too few bytes have arrived. Raises
    Malformed."""
    length = 0
    for place in range(at + 1, min(at + LONGEST_HEAD, len(data))):
        length |= (data[place] & 0x7F) << (7 * (place - at - 1))
        if data[place] < 0x80:
            return place + 1, place + 1 + length
    if len(data) >= at + LONGEST_HEAD:
        raise Malformed("no length of a packet")
    return None
