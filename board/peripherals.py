"""Frames to the board that move no wheel: PWM servos, buzzer, LEDs, display and the battery alarm, and their check.

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
    FrameError,
    counted,
    crc8,
    distinct,
    frame,
    group,
    integer,
)

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

PWM_SERVOS = 4
LEDS = 2
PIXELS = 2
# The firmware copies a text and a closing zero into 24 bytes, whatever its length.
OLED_TEXT = 23

_U16 = Struct("<H")
_U16X4 = Struct("<4H")
_ID_U16 = Struct("<BH")
_LED = Struct("<B3H")

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
LONGEST_MS = 30_000


def _milliseconds(field: str, value: int) -> int:
    return integer(field, value, 0, 65_535)


def _moves(
    moves: Sequence[tuple[int, int]], duration_ms: int, most: int, ids: int, target: tuple[str, int, int]
) -> bytes:
    data = b"\x01" + _U16.pack(integer("duration_ms", duration_ms, 0, LONGEST_MS))
    data += bytes((counted("moves", moves, 1, most),))
    for move in moves:
        group("move", move, 2)
        field, low, high = target
        data += _ID_U16.pack(integer("servo id", move[0], 1, ids), integer(field, move[1], low, high))
    distinct("servo id", [move[0] for move in moves])
    return data


def _timed(data: bytes, duration_ms: int) -> bytes:
    """A PWM servo's frame that moves in as many milliseconds, or in one or two more or less: one whose CRC is zero
    where it may be cut would be completed by the stop burst's zeros, and executed for the servo 0."""
    step = 1 if duration_ms < LONGEST_MS // 2 else -1
    for duration in range(duration_ms, duration_ms + 256 * step, step):
        made = data[:1] + _U16.pack(duration) + data[3:]
        if not _zeros_complete(PWM_SERVO, made):
            break
    return frame(PWM_SERVO, made)


def _pwm_id(servo: int) -> int:
    return integer("servo id", servo, 1, PWM_SERVOS)


def pwm_servo_move(pulses: Sequence[tuple[int, int]], duration_ms: int) -> bytes:
    """Move PWM servos: (id 1 to 4, pulse 500 to 2500 us) each, within duration_ms (0 to 30000)."""
    return _timed(_moves(pulses, duration_ms, PWM_SERVOS, PWM_SERVOS, ("pulse_us", 500, 2500)), duration_ms)


def pwm_servo_move_one(servo: int, pulse_us: int, duration_ms: int) -> bytes:
    """Move one PWM servo (id 1 to 4) to pulse_us (500 to 2500) within duration_ms (0 to 30000)."""
    data = b"\x03" + _U16.pack(integer("duration_ms", duration_ms, 0, LONGEST_MS))
    data += _ID_U16.pack(_pwm_id(servo), integer("pulse_us", pulse_us, 500, 2500))
    return _timed(data, duration_ms)


def pwm_servo_read(servo: int) -> bytes:
    """Ask for a PWM servo's pulse; the board answers from its memory, with no servo connected."""
    return frame(PWM_SERVO, bytes((0x05, _pwm_id(servo))))


def pwm_servo_deviation(servo: int, deviation_us: int) -> bytes:
    """Set a PWM servo's deviation, -100 to 100 us."""
    return frame(PWM_SERVO, bytes((0x07, _pwm_id(servo), integer("deviation_us", deviation_us, -100, 100) & 0xFF)))


def pwm_servo_read_deviation(servo: int) -> bytes:
    """Ask for a PWM servo's deviation."""
    return frame(PWM_SERVO, bytes((0x09, _pwm_id(servo))))


def buzzer(freq_hz: int, on_ms: int, off_ms: int, repeat: int) -> bytes:
    """Sound the buzzer `repeat` times. off_ms of 0 is refused: it left a buzzer sounding forever."""
    integer("freq_hz", freq_hz, 20, 20_000)
    integer("on_ms", on_ms, 1, 65_535)
    integer("off_ms", off_ms, 1, 65_535)
    integer("repeat", repeat, 1, 65_535)
    return frame(BUZZER, _U16X4.pack(freq_hz, on_ms, off_ms, repeat))


def led(led_id: int, on_ms: int, off_ms: int, repeat: int) -> bytes:
    """Blink LED 1 or 2: on and off times 0 to 65535 ms, repeat 0 to 65535."""
    integer("led id", led_id, 1, LEDS)
    times = _milliseconds("on_ms", on_ms), _milliseconds("off_ms", off_ms)
    return frame(LED, _LED.pack(led_id, *times, integer("repeat", repeat, 0, 65_535)))


def oled(line: int, text: str) -> bytes:
    """Show text on line 1 or 2 of the display: up to 23 printable ASCII characters."""
    integer("line", line, 1, 2)
    if not isinstance(text, str) or not text.isascii() or not text.isprintable():
        raise FrameError(f"text is {text!r}, must be printable ASCII")
    return frame(OLED, bytes((line, counted("text", text, 0, OLED_TEXT))) + text.encode("ascii"))


def rgb(pixels: Sequence[tuple[int, int, int, int]]) -> bytes:
    """Set the RGB pixels: (index 0 or 1; red, green, blue 0 to 255) each."""
    data = bytes((0x01, counted("pixels", pixels, 1, PIXELS)))
    for pixel in pixels:
        group("pixel", pixel, 4)
        integer("pixel index", pixel[0], 0, PIXELS - 1)
        for colour, value in zip(("red", "green", "blue"), pixel[1:], strict=True):
            integer(colour, value, 0, 255)
        data += bytes(pixel)
    distinct("pixel index", [pixel[0] for pixel in pixels])
    return frame(RGB, data)


def battery_alarm(millivolts: int) -> bytes:
    """Set the board's low-battery alarm, 1000 to 30000 mV."""
    return frame(SYS, b"\x01" + _U16.pack(integer("millivolts", millivolts, 1000, 30_000)))


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
    return _reaches_outside(func, data) or _zeros_complete(func, data)


def _zeros_complete(func: int, data: bytes) -> str:
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
