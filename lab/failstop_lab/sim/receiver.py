"""The receiver in the board's firmware, as a pure state machine: what the board makes of any bytes.

Facts from the firmware source, the same in every build read: the states below, one byte at a time; START2 and FUNC
fall back to START1 without looking at the byte again; LEN takes any value and 0 goes straight to CRC; DATA takes LEN
bytes whatever they are; a wrong CRC drops the frame silently and nothing consumed is looked at again; there is no
timeout between bytes.
"""

from __future__ import annotations

from failstop.board.rrc.framing import crc8

START1 = 0
START2 = 1
FUNC = 2
LEN = 3
DATA = 4
CRC = 5


class Receiver:
    """The board's parser. `first_invalid_func` is 10, 11 or 12 by firmware version.

    Every attribute may be read and set, so that any state the board can be in can be built: `state`, and where it
    applies `func`, `length` and `data` (what has been received of the frame's data).
    """

    __slots__ = ("crc_errors", "data", "first_invalid_func", "frames", "func", "length", "state")

    def __init__(self, first_invalid_func: int = 12) -> None:
        self.first_invalid_func = first_invalid_func
        self.state = START1
        self.func = 0
        self.length = 0
        self.data = bytearray()
        self.frames = 0
        self.crc_errors = 0

    @property
    def remaining(self) -> int:
        """Bytes of data still to come in state DATA."""
        return self.length - len(self.data)

    def copy(self) -> Receiver:
        """An independent receiver in the same state, with the same counters."""
        other = Receiver(self.first_invalid_func)
        other.state = self.state
        other.func = self.func
        other.length = self.length
        other.data = bytearray(self.data)
        other.frames = self.frames
        other.crc_errors = self.crc_errors
        return other

    def feed(self, chunk: bytes) -> list[tuple[int, int, bytes]]:
        """Take in bytes; return (offset in `chunk` of the frame's last byte, func, data) of each frame accepted."""
        accepted: list[tuple[int, int, bytes]] = []
        at = 0
        end = len(chunk)
        while at < end:
            if self.state == START1:
                found = chunk.find(0xAA, at)
                if found < 0:
                    break
                at = found + 1
                self.state = START2
            elif self.state == DATA:
                part = chunk[at : at + self.remaining]
                self.data += part
                at += len(part)
                if self.remaining <= 0:
                    self.state = CRC
            else:
                if self._byte(chunk[at]):
                    accepted.append((at, self.func, bytes(self.data)))
                at += 1
        return accepted

    def _byte(self, byte: int) -> bool:
        """One byte in START2, FUNC, LEN or CRC; true when it completes a frame."""
        if self.state == START2:
            self.state = FUNC if byte == 0x55 else START1
        elif self.state == FUNC:
            self.func = byte
            self.state = LEN if byte < self.first_invalid_func else START1
        elif self.state == LEN:
            self.length = byte
            self.data = bytearray()
            self.state = DATA if byte else CRC
        else:
            self.state = START1
            if byte == crc8(self.data, crc8((self.func, self.length))):
                self.frames += 1
                return True
            self.crc_errors += 1
        return False
