"""CAN frames as lines of text, as a Lawicel (slcan) adapter takes and sends them.

`tIIILDD...\\r` is a frame with an id of three digits, a length of one, and two for each byte, all hexadecimal. Sources:
python-can 4.6.1 (interfaces/slcan.py), and the firmware of the two CANables, normaldotcom/canable-fw 8ca5d39 and
canable2-fw b158aa7 (slcan.c, usbd_cdc_if.c).

Such a line has no checksum, and those adapters run whatever stands before a carriage return: a line that was cut takes
its missing digits from the line before, and an empty one is the last command again. So FLUSH is before each stop: it is
longer than any line that they keep, so they drop what was cut. For an adapter that keeps more its zeros complete the
line: a speed that was cut then becomes no faster and does not change its direction, because its last digits are the
ones that count most.
"""

from __future__ import annotations

CR = b"\r"
MOST_LINE = 21
"""Characters of the longest line that failstop writes, without its end."""
FLUSH = b"0" * 160 + CR
"""A CANable drops its line after 30 characters, and a CANable 2 after 155. FLUSH is longer, and is not a command
itself."""
OPEN = b"S8\rO\r"
"""Set 1 Mbit/s, and open the channel. An open CANable ignores both, so it loses nothing that waits in it."""
_HEAD = 5
"""How many characters of a line come before its data."""
_DIGITS = frozenset(b"0123456789abcdefABCDEF")
_KEPT = 64
"""How many characters of an incomplete line are kept. No line from an adapter is longer."""


def line(can_id: int, data: bytes) -> bytes:
    """The line that sends a frame of 8 bytes with this standard id."""
    return b"t%03X8%s\r" % (can_id, data.hex().upper().encode())


def frame_of(text: bytes, least: int = 8) -> tuple[int, bytes] | None:
    """The id and the data of a frame of `least` to 8 bytes, from a line without its end; None if there is none. A time
    stamp of four digits may follow."""
    if len(text) < _HEAD or not text.startswith(b"t") or not _DIGITS.issuperset(text[1:]):
        return None
    size = int(text[4:_HEAD], 16)
    end = _HEAD + 2 * size
    if not least <= size <= 8 or len(text) not in (end, end + 4):
        return None
    return int(text[1:4], 16) & 0x7FF, bytes.fromhex(text[_HEAD:end].decode("ascii"))


class Lines:
    """Decodes the bytes of an adapter into frames."""

    def __init__(self) -> None:
        self._kept = b""

    def frames(self, chunk: bytes) -> list[tuple[int, bytes]]:
        """The frames that these bytes complete, with their ids. Other lines, such as the adapter's own answers, are
        skipped."""
        # An adapter answers a line that it refused with a bell (7), and no end of line.
        *whole, kept = (self._kept + chunk).replace(b"\a", CR).split(CR)
        self._kept = kept[-_KEPT:]
        return [found for text in whole if (found := frame_of(text))]
