"""Frames that the board understands and the service never sends: what the simulated board and the proofs are given."""

from __future__ import annotations

from struct import Struct

from failstop.board.codec import PWM_SERVOS, pwm_servo_read, speed_limit, wheel_speed
from failstop.board.framing import (
    LED,
    MOTOR,
    OLED,
    PWM_SERVO,
    RGB,
    SYS,
    WHEELS,
    FrameError,
    counted,
    distinct,
    frame,
    group,
    integer,
    seal,
)

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

LEDS = 2
PIXELS = 2
# The firmware copies a text and a closing zero into 24 bytes, whatever its length.
OLED_TEXT = 23
LONGEST_MS = 30_000

_ID_SPEED = Struct("<Bf")
_U16 = Struct("<H")
_ID_U16 = Struct("<BH")
_LED = Struct("<B3H")


def _wheel(wheel: int) -> int:
    return integer("wheel id", wheel, 0, WHEELS - 1)


def motor_some(pairs: Sequence[tuple[int, float]], max_rps: float) -> bytes:
    """The "many" motor frame for one to four distinct wheels: (wire id, speed in rps) each."""
    limit = speed_limit(max_rps)
    data = bytes((0x01, counted("pairs", pairs, 1, WHEELS)))
    for pair in pairs:
        group("pair", pair, 2)
        data += _ID_SPEED.pack(_wheel(pair[0]), wheel_speed(pair[0], pair[1], limit))
    distinct("wheel id", [pair[0] for pair in pairs])
    return seal(MOTOR, data)


def motor_one(wheel: int, rps: float, max_rps: float) -> bytes:
    """Set the speed of one wheel (wire id 0 to 3) in rps."""
    limit = speed_limit(max_rps)
    return seal(MOTOR, b"\x00" + _ID_SPEED.pack(_wheel(wheel), wheel_speed(wheel, rps, limit)))


def motor_stop_one(wheel: int) -> bytes:
    """Stop one wheel (wire id 0 to 3)."""
    return seal(MOTOR, bytes((0x02, _wheel(wheel))))


def motor_stop_mask(mask: int) -> bytes:
    """Stop the wheels whose bits are set: bit 0 is wire id 0, 1 to 15."""
    return seal(MOTOR, bytes((0x03, integer("mask", mask, 1, (1 << WHEELS) - 1))))


def motor_type(kind: int) -> bytes:
    """Select the motor type: 0 JGB520, 1 JGB37, 2 JGA27, 3 JGB528 (newer firmware only)."""
    return seal(MOTOR, bytes((0x05, integer("motor type", kind, 0, 3))))


def _milliseconds(field: str, value: int) -> int:
    return integer(field, value, 0, 65_535)


def _pwm_id(servo: int) -> int:
    return integer("servo id", servo, 1, PWM_SERVOS)


def pwm_servo_move(pulses: Sequence[tuple[int, int]], duration_ms: int) -> bytes:
    """Move PWM servos: (id 1 to 4, pulse 500 to 2500 us) each, within duration_ms (0 to 30000)."""
    data = b"\x01" + _U16.pack(integer("duration_ms", duration_ms, 0, LONGEST_MS))
    data += bytes((counted("moves", pulses, 1, PWM_SERVOS),))
    for move in pulses:
        group("move", move, 2)
        data += _ID_U16.pack(_pwm_id(move[0]), integer("pulse_us", move[1], 500, 2500))
    distinct("servo id", [move[0] for move in pulses])
    return frame(PWM_SERVO, data)


def pwm_servo_move_one(servo: int, pulse_us: int, duration_ms: int) -> bytes:
    """Move one PWM servo (id 1 to 4) to pulse_us (500 to 2500) within duration_ms (0 to 30000)."""
    data = b"\x03" + _U16.pack(integer("duration_ms", duration_ms, 0, LONGEST_MS))
    data += _ID_U16.pack(_pwm_id(servo), integer("pulse_us", pulse_us, 500, 2500))
    return frame(PWM_SERVO, data)


def pwm_servo_deviation(servo: int, deviation_us: int) -> bytes:
    """Set a PWM servo's deviation, -100 to 100 us."""
    return frame(PWM_SERVO, bytes((0x07, _pwm_id(servo), integer("deviation_us", deviation_us, -100, 100) & 0xFF)))


def pwm_servo_read_deviation(servo: int) -> bytes:
    """Ask for a PWM servo's deviation."""
    return frame(PWM_SERVO, bytes((0x09, _pwm_id(servo))))


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


PING = pwm_servo_read(1)
