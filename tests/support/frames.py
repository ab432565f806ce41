"""Frames that the board understands and the service never sends."""

from __future__ import annotations

from collections.abc import Sequence
from struct import pack

from failstop.board.rrc.codec import pwm_servo_read
from failstop.board.rrc.framing import LED, MOTOR, OLED, PWM_SERVO, RGB, SYS, frame, seal

PING = pwm_servo_read(1)


def motor_some(pairs: Sequence[tuple[int, float]]) -> bytes:
    """Set the speed of some wheels: wire id and rps each."""
    return seal(MOTOR, bytes((1, len(pairs))) + b"".join(pack("<Bf", *pair) for pair in pairs))


def motor_one(wheel: int, rps: float) -> bytes:
    return seal(MOTOR, pack("<BBf", 0, wheel, rps))


def motor_stop_one(wheel: int) -> bytes:
    return seal(MOTOR, bytes((2, wheel)))


def motor_stop_mask(mask: int) -> bytes:
    """Stop the wheels whose bits are set: bit 0 is wire id 0."""
    return seal(MOTOR, bytes((3, mask)))


def motor_type(kind: int) -> bytes:
    return seal(MOTOR, bytes((5, kind)))


def pwm_servo_move(pulses: Sequence[tuple[int, int]], duration_ms: int) -> bytes:
    """Move PWM servos: id and pulse (us) each."""
    return frame(PWM_SERVO, pack("<BHB", 1, duration_ms, len(pulses)) + b"".join(pack("<BH", *each) for each in pulses))


def pwm_servo_move_one(servo: int, pulse_us: int, duration_ms: int) -> bytes:
    return frame(PWM_SERVO, pack("<BHBH", 3, duration_ms, servo, pulse_us))


def pwm_servo_deviation(servo: int, deviation_us: int) -> bytes:
    return frame(PWM_SERVO, bytes((7, servo, deviation_us & 0xFF)))


def pwm_servo_read_deviation(servo: int) -> bytes:
    return frame(PWM_SERVO, bytes((9, servo)))


def led(number: int, on_ms: int, off_ms: int, repeat: int) -> bytes:
    return frame(LED, pack("<B3H", number, on_ms, off_ms, repeat))


def oled(line: int, text: str) -> bytes:
    return frame(OLED, bytes((line, len(text))) + text.encode())


def rgb(pixels: Sequence[tuple[int, int, int, int]]) -> bytes:
    """Set pixels: number, red, green and blue each."""
    return frame(RGB, bytes((1, len(pixels))) + b"".join(map(bytes, pixels)))


def battery_alarm(millivolts: int) -> bytes:
    return frame(SYS, pack("<BH", 1, millivolts))
