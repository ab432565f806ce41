"""Frames from the RRC: the decoder, and a parser for the data of each kind of frame (vendor protocol description).

A parser takes the data of one frame. It returns None if the data has the wrong length or content. So telemetry ignores
a wrong frame, and reads the next one.
"""

from __future__ import annotations

from struct import Struct

from failstop.board.rrc.framing import BUS_SERVO, HEAD, PWM_SERVO, RGB, crc8

KEY_EVENTS = {
    0x01: "pressed",
    0x02: "long",
    0x04: "long-repeat",
    0x08: "release after long",
    0x10: "release after short",
    0x20: "click",
    0x40: "double",
    0x80: "triple",
}

# The longest data that the board is known to send is 36 bytes (SBUS). A longer length is noise: waiting for 255 bytes
# would hold telemetry back for 80 ms.
LONGEST = 64


_BATTERY = Struct("<BH")
_IMU = Struct("<6f")
_GAMEPAD = Struct("<HB4b")
_U16 = Struct("<H")
_I16 = Struct("<h")
_U8 = Struct("<B")
_I8 = Struct("<b")

_READ_POSITION = 0x05
_PINGED_SERVOS = 4

# The format of the value in a servo's reply, by function and sub-command.
_VALUES = {
    (PWM_SERVO, _READ_POSITION): _U16,
    (PWM_SERVO, 0x09): _I8,
    (BUS_SERVO, 0x05): _I16,
    (BUS_SERVO, 0x07): _U16,
    (BUS_SERVO, 0x09): _U8,
    (BUS_SERVO, 0x0D): _U8,
}


class Decoder:
    """Turns bytes, in pieces of any size, into frames. Between calls it keeps at most the bytes of one frame.

    After a wrong CRC or an impossible head it looks for the next head inside the rejected bytes. So it finds a good
    frame that follows garbage. The board's own receiver would lose this frame.
    """

    __slots__ = ("_pending",)

    def __init__(self) -> None:
        self._pending = b""

    def reset(self) -> None:
        """Forget an incomplete frame, for example after the port was reopened."""
        self._pending = b""

    def feed(self, chunk: bytes) -> list[tuple[int, bytes]]:
        """Add bytes. Returns (func, data) for each frame that they complete, in order."""
        stream = self._pending + chunk
        end = len(stream)
        found: list[tuple[int, bytes]] = []
        at = 0
        while True:
            head = stream.find(HEAD, at)
            if head < 0:
                # The last byte may be the first half of a head.
                head = end - 1 if end > at and stream[-1] == HEAD[0] else end
            at = head
            if end - at < 4:
                break
            func, length = stream[at + 2], stream[at + 3]
            if func > RGB or length > LONGEST:
                at += len(HEAD)
                continue
            after = at + 5 + length
            if after > end:
                break
            # Computed over a good frame with its own CRC, the CRC is zero.
            if crc8(stream[at + 2 : after]):
                at += len(HEAD)
                continue
            found.append((func, stream[at + 4 : after - 1]))
            at = after
        self._pending = stream[at:]
        return found


def battery_mv(data: bytes) -> int | None:
    """Return the battery's voltage in mV, from the data of a SYS frame. None if the data has another form."""
    if len(data) != _BATTERY.size or data[0] != 0x04:
        return None
    millivolts: int = _BATTERY.unpack(data)[1]
    return millivolts


def key(data: bytes) -> tuple[int, int] | None:
    """Return (key id, event) from the data of a KEY frame. The event is one of KEY_EVENTS. None if the data has another
    form."""
    if len(data) != 2 or data[1] not in KEY_EVENTS:
        return None
    return data[0], data[1]


def imu(data: bytes) -> tuple[float, float, float, float, float, float] | None:
    """Return acceleration x y z in g, then gyro x y z in deg/s, from the data of an IMU frame. The values may be
    infinite or NaN. None if the data has another length."""
    if len(data) != _IMU.size:
        return None
    ax, ay, az, gx, gy, gz = _IMU.unpack(data)
    return ax, ay, az, gx, gy, gz


def gamepad(data: bytes) -> tuple[int, int, int, int, int, int] | None:
    """Return (buttons, hat, lx, ly, rx, ry) from the data of a GAMEPAD frame. The buttons are the bits of
    interface.BUTTONS, and the axes are -128 to 127. None if the data has another length."""
    if len(data) != _GAMEPAD.size:
        return None
    buttons, hat, lx, ly, rx, ry = _GAMEPAD.unpack(data)
    return buttons, hat, lx, ly, rx, ry


def servo_reply(func: int, data: bytes) -> tuple[int, int, int | None] | None:
    """Return (servo id, sub-command, value) from the data of a PWM SERVO or BUS SERVO frame. The value is None if a bus
    servo did not answer. The result is None if the data has another form.

    The sub-command is the same as in the question, and it says what the value means. A PWM servo answers 05 with the
    pulse in us, and 09 with the deviation in us. A bus servo answers 05 with the position, 07 with the supply in mV, 09
    with the temperature in degrees Celsius, and 0D with 1 if the torque is on.
    """
    form = _VALUES.get((func, data[1])) if len(data) > 2 else None
    at = 3 if func == BUS_SERVO else 2
    if form is None or len(data) != at + form.size:
        return None
    answered = func == PWM_SERVO or data[2] == 0
    return data[0], data[1], form.unpack_from(data, at)[0] if answered else None


def pong(data: bytes) -> int | None:
    """Return the index (0 to 3) of the ping that the data of a PWM SERVO frame answers. The pings ask for the positions
    of servos 1 to 4. None if the frame answers no ping."""
    reply = servo_reply(PWM_SERVO, data)
    if reply and reply[1] == _READ_POSITION and 1 <= reply[0] <= _PINGED_SERVOS:
        return reply[0] - 1
    return None
