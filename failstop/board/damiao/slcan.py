"""CAN frames as lines of text, as a Lawicel (slcan) adapter takes and sends them.

A frame is a line `tIIILDD...\\r`. After the t come hexadecimal digits: three for the CAN id, one for the length, and
two for each byte. Sources: python-can 4.6.1 (interfaces/slcan.py), and the firmware of the two CANables,
normaldotcom/canable-fw 8ca5d39 and canable2-fw b158aa7 (slcan.c, usbd_cdc_if.c).

A line has no checksum, and the two CANables execute whatever comes before a carriage return. They complete a cut line
with digits of the line before it. An empty line makes them repeat the last command. So FLUSH comes before each stop.
FLUSH is longer than any line that these adapters keep, so they drop a cut line before it. An adapter that keeps longer
lines completes the cut line with the zeros of FLUSH instead. Even then, a cut speed gets no faster. In a little-endian
float the sign and the exponent come last, so they are the first to become 0. If the sign becomes 0, the exponent does
too, and the speed is almost 0.
"""

from __future__ import annotations

CR = b"\r"
MOST_LINE = 21
"""The most characters in a line that failstop writes, not counting the carriage return."""
FLUSH = b"0" * 160 + CR
"""A line that makes the adapters drop a cut line that comes before it. FLUSH itself is not a command. It is long
enough, because a CANable drops a line of more than 30 characters, and a CANable 2 a line of more than 155."""
OPEN = b"S8\rO\r"
"""The commands that set 1 Mbit/s and open the channel. A CANable whose channel is already open ignores both commands,
so it loses none of the frames that it still has to send."""
_HEAD = 5
"""How many characters of a line come before its data."""
_DIGITS = frozenset(b"0123456789abcdefABCDEF")
_KEPT = 64
"""How many characters of an incomplete line are kept. Every line that an adapter sends is shorter than this."""


def line(can_id: int, data: bytes) -> bytes:
    """Return the line that sends a frame of 8 bytes under this standard CAN id."""
    return b"t%03X8%s\r" % (can_id, data.hex().upper().encode())


def frame_of(text: bytes, least: int = 8) -> tuple[int, bytes] | None:
    """Return the CAN id and the data of a line. None if the line is not a frame of `least` to 8 bytes. `text` is the
    line without its carriage return, and may have a time stamp of four digits after the data."""
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
        """Return the frames that these bytes complete, with their CAN ids. Other lines are skipped, for example the
        adapter's own answers."""
        # If an adapter refuses a line, it answers with a bell (7) and no end of line.
        *whole, kept = (self._kept + chunk).replace(b"\a", CR).split(CR)
        self._kept = kept[-_KEPT:]
        return [found for text in whole if (found := frame_of(text))]
