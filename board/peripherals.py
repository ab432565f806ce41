"""Frames to the board that move no wheel and no servo of an arm: the ping and the buzzer, and the check of all kinds.

The ranges are those of the firmware's handlers, which rarely check them (firmware source): a PWM servo id of 0 or a
count beyond the data reaches outside a table, a long OLED text overruns its line.
"""

from __future__ import annotations

from struct import Struct

from failstop.board.framing import (
    AUX_FUNCS,
    BUS_SERVO,
    BUZZER,
    HEAD,
    LED,
    MOTOR,
    MOTOR_HEAD,
    OLED,
    PWM_SERVO,
    RGB,
    SYS,
    crc8,
    frame,
    integer,
)

PWM_SERVOS = 4
PIXELS = 2
# The firmware copies a text and a closing zero into 24 bytes, whatever its length.
OLED_TEXT = 23

_U16X4 = Struct("<4H")

# Handlers that go through a list: where the count stands in the data, and the size of an item.
_LISTS = {
    (PWM_SERVO, 0x01): (3, 3),
    (OLED, 0x01): (1, 1),
    (OLED, 0x02): (1, 1),
    (RGB, 0x01): (1, 4),
}
# PWM servo sub-commands for one servo: where its id stands.
_PWM_ID_AT = {0x03: 3, 0x05: 1, 0x07: 1, 0x09: 1}

FILLED = 31
"""Bytes of data that the burst's first zeros complete: no frame is longer."""


def pwm_id(servo: int) -> int:
    """The id of a PWM servo. Raises FrameError for another number."""
    return integer("servo id", servo, 1, PWM_SERVOS)


def pwm_servo_read(servo: int) -> bytes:
    """Ask for a PWM servo's pulse; the board answers from its memory, with no servo connected."""
    return frame(PWM_SERVO, bytes((0x05, pwm_id(servo))))


def buzzer(freq_hz: int, on_ms: int, off_ms: int, repeat: int) -> bytes:
    """Sound the buzzer `repeat` times. off_ms of 0 is refused: it left a buzzer sounding forever."""
    integer("freq_hz", freq_hz, 20, 20_000)
    integer("on_ms", on_ms, 1, 65_535)
    integer("off_ms", off_ms, 1, 65_535)
    integer("repeat", repeat, 1, 65_535)
    return frame(BUZZER, _U16X4.pack(freq_hz, on_ms, off_ms, repeat))


def check_aux(frame: bytes) -> str:
    """Why these bytes must not be written as a frame that is not motion, in a few words; "" when they may.

    Accepted is exactly one frame of a function in AUX_FUNCS but the bus servos', of the right length and CRC, without
    the start of a motor frame anywhere in it, and with nothing in it that makes the firmware's handler reach outside
    its tables (which could change a wheel's set point as well as anything), whole or cut and completed by the stop
    burst. Never raises on bytes.
    """
    size = len(frame)
    if size < 5 or frame[:2] != HEAD:
        return "not a frame"
    func = frame[2]
    if func == MOTOR:
        return "a motor frame"
    if func == BUS_SERVO:
        return "a bus servo's frame"
    if func not in AUX_FUNCS:
        return f"func {func} does not go to the board"
    if size != frame[3] + 5:
        return f"{size} bytes, its length byte says {frame[3] + 5}"
    if crc8(frame[2:]):
        return "bad crc"
    if MOTOR_HEAD in frame:
        return "the start of a motor frame inside"
    data = frame[4:-1]
    if len(data) > FILLED:
        return f"{len(data)} bytes of data, limit {FILLED}"
    return _reaches_outside(func, data) or zeros_complete(func, data)


def zeros_complete(func: int, data: bytes) -> str:
    """What is wrong with the frame that zeros make of this one where it was cut, as the burst's do where the CRC so far
    is zero; "" when nothing is."""
    crc = crc8((func, len(data)))
    for end in range(len(data)):
        if not crc and (fault := _reaches_outside(func, data[:end].ljust(len(data), b"\0"))):
            return f"{fault} if cut after {end} bytes of data"
        crc = crc8(data[end : end + 1], crc)
    return ""


def _reaches_outside(func: int, data: bytes) -> str:
    if func in (SYS, LED, BUZZER):
        return ""
    # Without data the handlers take the CRC for their sub-command.
    if not data:
        return "no sub-command"
    command = data[0]
    if func == RGB and command != 0x01:
        # The handler goes through the list whatever the sub-command is.
        return f"rgb sub-command {command}, must be 1"
    if func == PWM_SERVO and command in _PWM_ID_AT:
        at = _PWM_ID_AT[command]
        return "" if len(data) > at and data[at] else "pwm servo id 0"
    if (func, command) not in _LISTS:
        return ""
    at, item = _LISTS[func, command]
    if len(data) <= at or len(data) < at + 1 + data[at] * item:
        return "a count beyond its data"
    ids = data[at + 1 : at + 1 + data[at] * item : item]
    if func == PWM_SERVO and 0 in ids:
        return "pwm servo id 0"
    if func == OLED and data[at] > OLED_TEXT:
        return f"oled text of {data[at]}, limit {OLED_TEXT}"
    if func == RGB and any(index >= PIXELS for index in ids):
        return f"rgb index beyond {PIXELS - 1}"
    return ""
