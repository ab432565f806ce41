"""The lines of JSON for Waveshare's ugv_base_ros: commands to the board, and reports from it. Firmware source: commit
c967326.

A line is a JSON object. Its field T names the command or the report. The stop begins with a line feed, which ends any
line that was cut short before it. The board ignores a cut line, because it is not JSON. But if only the line feed was
cut off, the board obeys the line, and the stop follows at once. failstop never writes `{}`, `null` or only the end of a
line: the board would take each of them for the command that stops the wheels and switches an arm's torque off. Only T:1
is used for motion. The vendor's ROS 2 driver sends T:13 instead, which does not feed the board's watchdog.

A line has no checksum, so speeds are written in a form that no lost byte can make larger. For example, 0.171 m/s is
`17100e-5`. If a digit is lost, the speed gets smaller. If the whole exponent is lost, the speed is more than 2, which
the board ignores. The older ugv_base_general ignores it only on its main type 3. On its types 1 and 2, which take a
share of the PWM, a lost minus sign or a lost 5 of the exponent means full speed. Shorter forms are not safe: `0.001`
without its point is 1. `1e-3` without its 3 is 1, because ArduinoJson accepts `1e-`.
"""

from __future__ import annotations

import json
import re
from math import inf, pi

from failstop.board.checks import integer
from failstop.board.lines import LineReader, MotionLine
from failstop.board.wire import Answer, Battery, Imu, Restarted, Sample, Wheels

STOP = b'\n{"T":1,"L":0,"R":0}\n'
SPEED_RATE = b'{"T":139}\n'
"""A question that changes nothing on the board. Never use T:128 as a question, because it overwrites a calibration."""
ATTITUDE = b'{"T":126}\n'
LIMIT = 2.0
"""The highest speed that the board accepts, in m/s. The board silently ignores a faster command and keeps its old
speed, but the command still feeds the board's watchdog."""
STEP = 0.001
UNIT = "m/s (on ugv_base_general's Rover and RaspRover a share of the PWM)"
WATCHDOG_MS = (100, 3000)
"""The shortest and the longest time to which failstop can set the board's watchdog, in ms. A time of 0 would end every
motion after 1 ms."""

REPORT = 1001
ANSWERS = (139, 1002)
"""The T of the board's answers: 139 for SPEED_RATE, and 1002 for ATTITUDE. A line with no field but T is no answer,
because a device that only sends back what it receives would send such a line."""
LONGEST_LINE = 1024
AUX = {3: "the display (T:3)", -3: "the display (T:-3)", 132: "lights (T:132)", 133: "the gimbal (T:133)",
       134: "the gimbal (T:134)", 137: "the gimbal (T:137)"}  # fmt: skip
"""The commands that move no wheel, such as those for lights, gimbal and display. The keys are the commands' numbers
(T), the values are their names in texts for people. T:135 and T:141 are not among them. For these, the firmware asks
each of the gimbal's servos and waits 100 ms for each answer (gimbal_module.h, SCSerial.cpp). If a servo does not
answer, the board hears no stop for up to 0.8 s."""
_AUX_T = {kind: f"{kind / 100}e2" if kind > 100 else str(kind) for kind in AUX}
"""How the T of each command in AUX is written. If `133` were written plainly, a byte lost on the cable could turn it
into T:13, which drives the wheels."""
_AUX_BYTES = 128
RADIO_OFF = b'{"T":3e2,"mode":0}\n'
"""The line that makes the board ignore ESP-NOW radio, by which anybody nearby could otherwise drive the robot."""

_BOOT = re.compile(rb"rst:0x[0-9a-f]+ \(")
"""Part of the line that the ESP32's ROM prints at every reset, at the same baud rate, for example rst:0xf
(BROWNOUT_RST),boot:0x13 (...)."""
_ABORT = b"[missionPlay abort.]"
ABORTED = "it broke off its boot mission: wheels may turn backwards"
"""The firmware plays its mission "boot" at its start, and breaks it off as soon as bytes wait (ugv_advance.h). It then
lacks what the mission sets, such as its main type."""
_SPEED = rb"(0|-?[1-9]\d{0,3}00e-5)"
_LINE = re.compile(rb'\{"T":1,"L":%b,"R":%b\}\n' % (_SPEED, _SPEED))
_ACCEL = 9.80665 / 8192
"""m/s^2 per unit of the IMU's accelerometer, whose range is 4 g."""
_GYRO = pi / 180 / 16.4
"""rad/s per unit of the IMU's gyro, whose range is 2000 degrees per second."""


def _speed(speed: float) -> str:
    thousandths = int(round(speed / STEP, 6))  # 0.29 is 289.99999999999994 thousandths by floats
    return f"{thousandths}00e-5" if thousandths else "0"


def _written(left: float, right: float) -> bytes:
    return f'{{"T":1,"L":{_speed(left)},"R":{_speed(right)}}}\n'.encode()


MOTION = MotionLine(_LINE, _written, LIMIT, "m/s")
REST = MOTION.frame((0.0, 0.0), 0.0)


_KEY = r'"(?:IO4|IO5|X|Y|SPD|ACC|SX|SY|s|y|cmd|lineNum|Text)"'
_VALUE = r'(?:-?\d{1,6}(?:\.\d{1,6})?|"[ !#-\[\]-~]{0,32}")'
_AUX_LINE = re.compile(rf'\{{"T":(?:{"|".join(map(re.escape, _AUX_T.values()))})(?:,{_KEY}:{_VALUE}){{0,8}}\}}\n')


def aux(kind: int, fields: dict[str, object]) -> bytes:
    """Return the line for lights, gimbal or display. `kind` is one of AUX. The fields are numbers and short texts.
    Empty if the line would be too long, a field is not known, or a value is neither a number nor a text."""
    if not all(isinstance(value, (int, float, str)) for value in fields.values()):
        return b""
    rest = "".join(f",{json.dumps(key)}:{json.dumps(_short(value))}" for key, value in fields.items())
    line = f'{{"T":{_AUX_T[kind]}{rest}}}\n'.encode()
    return b"" if check_aux(line) else line


def _short(value: object) -> object:
    return round(value, 6) if isinstance(value, float) else value


def check_aux(frame: bytes) -> str:
    """Return the reason to refuse these bytes, or "" to accept them. It accepts a line for lights, gimbal or display,
    and RADIO_OFF."""
    if frame == RADIO_OFF:
        return ""
    if len(frame) > _AUX_BYTES or not _AUX_LINE.fullmatch(frame.decode("ascii", "replace")):
        return "no line for lights, gimbal or display"
    return ""


def watchdog(after_ns: int) -> bytes:
    """Return the line that makes the board stop its wheels this long after the last motion line. The board does not
    answer the line, and forgets the time when it loses power. Raises FrameError."""
    after_ms = integer("watchdog in ms", after_ns // 1_000_000, *WATCHDOG_MS)
    return f'\n{{"T":136,"cmd":{after_ms}}}\n'.encode()


def reports() -> LineReader:
    """Make a reader for the board's lines. The board's boot text becomes Restarted. Any other line that is not a known
    report or answer is dropped."""
    return LineReader(_samples, LONGEST_LINE)


def _samples(line: bytes) -> list[Sample]:
    if _BOOT.search(line):
        return [Restarted("it printed its boot text")]
    if _ABORT in line:
        return [Restarted(ABORTED)]
    try:
        said = json.loads(line)
    except (ValueError, RecursionError):
        return []
    if not isinstance(said, dict):
        return []
    kind = said.get("T")
    if kind == REPORT:
        return _report(said)
    return [Answer(str(kind))] if kind in ANSWERS and len(said) > 1 else []


def _numbers(said: dict[str, object], *names: str) -> tuple[float, ...]:
    """Return the values of these names, finite or not. Empty if one of them is missing or not a number."""
    found = [said.get(name) for name in names]
    numbers = [_float(value) for value in found if isinstance(value, (int, float)) and not isinstance(value, bool)]
    return tuple(numbers) if len(numbers) == len(names) else ()


def _float(value: float) -> float:
    try:
        return float(value)
    except OverflowError:  # an integer of more than 308 digits, which JSON may hold
        return inf


def _report(said: dict[str, object]) -> list[Sample]:
    found: list[Sample] = []
    # ugv_base_general's types 1 and 2 have no odometers. Their L and R are the commanded PWM.
    if positions := _numbers(said, "odl", "odr"):
        found.append(Wheels((), positions))
    # On a robot with an arm, ax, ay and az are the position of its hand.
    accel, gyro = _numbers(said, "ax", "ay", "az"), _numbers(said, "gx", "gy", "gz")
    if accel and gyro and "ab" not in said:
        ax, ay, az = accel
        gx, gy, gz = gyro
        found.append(Imu((ax * _ACCEL, ay * _ACCEL, az * _ACCEL), (gx * _GYRO, gy * _GYRO, gz * _GYRO)))
    if centivolts := _numbers(said, "v"):
        found.append(Battery(centivolts[0] / 100))
    return found
