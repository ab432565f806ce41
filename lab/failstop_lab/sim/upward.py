"""Frames as the controller board sends them: encoders for the simulated board and for tests."""

from __future__ import annotations

from struct import Struct, pack

from failstop.board.rrc.framing import BUS_SERVO, GAMEPAD, IMU_FUNC, KEY_FUNC, PWM_SERVO, SYS, seal

_BATTERY = Struct("<BH")
_IMU = Struct("<6f")
_GAMEPAD = Struct("<HB4b")
_PULSE = Struct("<BBH")
_DEVIATION = Struct("<BBb")


def battery(millivolts: int) -> bytes:
    """SYS: the battery voltage in mV."""
    return seal(SYS, _BATTERY.pack(0x04, millivolts))


def key_frame(key_id: int, event: int) -> bytes:
    """KEY_FUNC: a key's id and one of decoder.KEY_EVENTS."""
    return seal(KEY_FUNC, bytes((key_id, event)))


def imu_frame(ax: float, ay: float, az: float, gx: float, gy: float, gz: float) -> bytes:
    """IMU_FUNC: acceleration in g, gyro in deg/s. Anything a float32 holds goes, NaN too."""
    return seal(IMU_FUNC, _IMU.pack(ax, ay, az, gx, gy, gz))


def gamepad_frame(buttons: int, hat: int = 0, lx: int = 0, ly: int = 0, rx: int = 0, ry: int = 0) -> bytes:
    """GAMEPAD: buttons as in interface.BUTTONS, hat, axes -128 to 127."""
    return seal(GAMEPAD, _GAMEPAD.pack(buttons, hat, lx, ly, rx, ry))


def pwm_servo_position(servo: int, pulse_us: int) -> bytes:
    """PWM SERVO: the answer to a position read, which is the answer to the ping."""
    return seal(PWM_SERVO, _PULSE.pack(servo, 0x05, pulse_us))


def pwm_servo_deviation(servo: int, deviation_us: int) -> bytes:
    """PWM SERVO: the answer to a deviation read."""
    return seal(PWM_SERVO, _DEVIATION.pack(servo, 0x09, deviation_us))


def bus_servo(servo: int, what: int, value: int | None) -> bytes:
    """BUS SERVO: the answer to a question (servos.READS); None for a servo that does not answer."""
    form = {0x05: "h", 0x07: "H"}.get(what, "B")
    return seal(BUS_SERVO, pack(f"<BBb{form}", servo, what, 0 if value is not None else -1, value or 0))
