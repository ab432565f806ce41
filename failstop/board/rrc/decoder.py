"""Frames from the controller board: the incremental decoder, and a parser for each kind (vendor protocol description).

A parser takes the data of one frame and returns None for data of the wrong length or content, so that telemetry goes on
and nonsense is not passed on.
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
    """Turns bytes, in pieces of any size, into frames; keeps at most one frame's worth between calls.

    After a wrong CRC or an impossible head it looks for the next head inside the rejected bytes, so that garbage does
    not cost the whole frame after it (the board's own receiver does not do that).
    """

    __slots__ = ("_pending",)

    def __init__(self) -> None:
        self._pending = b""

    def reset(self) -> None:
        """Forget an incomplete frame, for example after the port was reopened."""
        self._pending = b""

    def feed(self, chunk: bytes) -> list[tuple[int, bytes]]:
        """Add bytes; returns (func, data) for each frame that they complete, in order."""
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
            # Over a good frame with its CRC, the CRC is zero.
            if crc8(stream[at + 2 : after]):
                at += len(HEAD)
                continue
            found.append((func, stream[at + 4 : after - 1]))
            at = after
        self._pending = stream[at:]
        return found


def battery_mv(data: bytes) -> int | None:
    """SYS: the battery's voltage in mV."""
    if len(data) != _BATTERY.size or data[0] != 0x04:
        return None
    millivolts: int = _BATTERY.unpack(data)[1]
    return millivolts


def key(data: bytes) -> tuple[int, int] | None:
    """KEY: (key id, event), the event one of KEY_EVENTS."""
    if len(data) != 2 or data[1] not in KEY_EVENTS:
        return None
    return data[0], data[1]


def imu(data: bytes) -> tuple[float, float, float, float, float, float] | None:
    """IMU: acceleration x y z in g, then gyro x y z in deg/s, finite or not."""
    if len(data) != _IMU.size:
        return None
    ax, ay, az, gx, gy, gz = _IMU.unpack(data)
    return ax, ay, az, gx, gy, gz


def gamepad(data: bytes) -> tuple[int, int, int, int, int, int] | None:
    """GAMEPAD: (buttons as in interface.BUTTONS, hat, lx, ly, rx, ry), the axes -128 to 127."""
    if len(data) != _GAMEPAD.size:
        return None
    buttons, hat, lx, ly, rx, ry = _GAMEPAD.unpack(data)
    return buttons, hat, lx, ly, rx, ry


def servo_reply(func: int, data: bytes) -> tuple[int, int, int | None] | None:
    """PWM SERVO and BUS SERVO: (servo id, sub-command, value), the value None when a bus servo did not answer.

    The sub-command is that of the request. PWM: 05 pulse in us, 09 deviation in us. Bus: 05 position, 07 supply in mV,
    09 degrees Celsius, 0D torque on.
    """
    form = _VALUES.get((func, data[1])) if len(data) > 2 else None
    at = 3 if func == BUS_SERVO else 2
    if form is None or len(data) != at + form.size:
        return None
    answered = func == PWM_SERVO or data[2] == 0
    return data[0], data[1], form.unpack_from(data, at)[0] if answered else None


def pong(data: bytes) -> int | None:
    """PWM SERVO: the index, 0 to 3, of the ping that it answers (the position of servo 1 to 4), or None if it answers
    none."""
    reply = servo_reply(PWM_SERVO, data)
    if reply and reply[1] == _READ_POSITION and 1 <= reply[0] <= _PINGED_SERVOS:
        return reply[0] - 1
    return None
