"""Framing: the parts that all frames to and from the RRC share, which are the functions, the head and the CRC.

A frame is `AA 55 | func u8 | len u8 | data[len] | crc8`, little-endian. `len` counts only the data, and the CRC covers
func, len and data (vendor protocol description).
"""

from __future__ import annotations

from failstop.board.checks import FrameError, integer

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterable

SYS, LED, BUZZER, MOTOR, PWM_SERVO, BUS_SERVO, KEY_FUNC, IMU_FUNC, GAMEPAD, SBUS, OLED, RGB = range(12)

HEAD = b"\xaa\x55"
WHEELS = 4
MAX_DATA = 255

# Functions that the host sends to the board, except motion.
AUX_FUNCS = (SYS, LED, BUZZER, PWM_SERVO, BUS_SERVO, OLED, RGB)

# A receiver that has lost its place in the bytes takes this for the start of a motor frame, wherever it appears.
MOTOR_HEAD = b"\xaa\x55\x03"


def _crc_table() -> bytes:
    table = bytearray()
    for value in range(256):
        crc = value
        for _ in range(8):
            crc = (crc >> 1) ^ 0x8C if crc & 1 else crc >> 1
        table.append(crc)
    return bytes(table)


CRC_TABLE = _crc_table()


def crc8(data: Iterable[int], crc: int = 0) -> int:
    """Return the CRC-8/MAXIM of bytes-like data (reflected polynomial 0x8C, initial 0, no final xor). `crc` is the CRC
    of the bytes before the data, if there are any."""
    table = CRC_TABLE
    for byte in data:
        crc = table[crc ^ byte]
    return crc


def seal(func: int, data: bytes) -> bytes:
    """Put head, function, length and CRC around data. Checks nothing, so only this folder's own encoders may use it."""
    body = bytes((func, len(data))) + data
    return HEAD + body + bytes((crc8(body),))


def zeros_complete(func: int, data: bytes, least: int = 1) -> int:
    """Return how many bytes of data come before the first dangerous cut in this frame, or 0 if no cut is dangerous. A
    cut is a place where the frame breaks off, and zeros follow. It is dangerous if the CRC of the bytes before it is
    zero. The CRC then stays zero over the zeros, so the board takes one of them for the right CRC, and obeys the
    frame. Cuts with fewer than `least` bytes of data before them are ignored. `least` must be 1 or more."""
    crc = crc8((func, len(data)))
    for end, byte in enumerate(data):
        if not crc and end >= least:
            return end
        crc = CRC_TABLE[crc ^ byte]
    return 0


def frame(func: int, data: bytes | bytearray | memoryview) -> bytes:
    """Make the frame for any function except MOTOR from bytes-like data, up to 255 bytes. Raises FrameError.

    Motor frames come only from the checked motor encoders. A frame for the board must not contain `AA 55 03` either. A
    receiver that missed the frame's head would take these bytes for the start of a motor frame.
    """
    integer("func", func, SYS, RGB)
    if func == MOTOR:
        raise FrameError(f"func is {MOTOR} (MOTOR), must be any other: motor frames come from the motor encoders")
    if not isinstance(data, (bytes, bytearray, memoryview)):
        raise FrameError(f"data is a {type(data).__name__}, must be bytes")
    raw = bytes(data)
    if len(raw) > MAX_DATA:
        raise FrameError(f"data has {len(raw)} bytes, must have 0 to {MAX_DATA}")
    sealed = seal(func, raw)
    if func in AUX_FUNCS and MOTOR_HEAD in sealed:
        raise FrameError(f"data {raw.hex()} puts aa5503 on the wire, must not: it can be taken for a motor frame")
    return sealed
