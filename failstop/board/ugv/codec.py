"""Lines of JSON for Waveshare's ugv_base_ros: the commands down and the reports up. Firmware source, commit c967326.

The stop begins with a line feed, which ends whatever was cut before: a cut line is no JSON and is ignored. Braces are
never left out or emptied: `{}`, `null` or the tail of a line stop the wheels and switch an arm's torque off. Motion is
T:1 alone: T:13, which the vendor's ROS 2 driver sends, does not feed the board's watchdog.

A line has no check, so a speed is written such that a byte lost on the cable can't make it larger: 0.171 m/s is
`17100e-5`. A lost digit makes it smaller; without all of its exponent it is more than 2, which the board ignores. In
0.171 a lost point would make 171 of it, and in 1e-3 a lost 3 makes 1, which ArduinoJson takes.
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
"""A question that changes nothing. Never use T:128 for this, because it overwrites a calibration."""
ATTITUDE = b'{"T":126}\n'
LIMIT = 2.0
"""The board ignores a faster command without a word, keeps the old speed, and feeds its watchdog."""
STEP = 0.001
UNIT = "m/s (on ugv_base_general's Rover and RaspRover a share of the PWM)"
WATCHDOG_MS = (100, 3000)
"""The range that failstop sets. 0 would end every motion after 1 ms."""

REPORT = 1001
ANSWERS = (139, 1002)
"""The answer to each question. An answer has more fields than its T, because a line that only sends the question back
is not from a board."""
LONGEST_LINE = 1024
AUX = {3: "the display (T:3)", -3: "the display (T:-3)", 132: "lights (T:132)", 133: "the gimbal (T:133)",
       134: "the gimbal (T:134)", 135: "the gimbal (T:135)", 137: "the gimbal (T:137)",
       141: "the gimbal (T:141)"}  # fmt: skip
"""The commands that move no wheel, by their T, with a name for people."""
_AUX_T = {kind: f"{kind / 100}e2" if kind > 100 else str(kind) for kind in AUX}
"""How a T is written. If it were `133`, the loss of one byte on the cable would make it T:13, which drives."""
_AUX_BYTES = 128
RADIO_OFF = b'{"T":3e2,"mode":0}\n'
"""Makes the board ignore ESP-NOW, because anybody nearby could drive it that way."""

_BOOT = re.compile(rb"rst:0x[0-9a-f]+ \(")
"""Part of the line that the ESP32's ROM prints at every reset, at the same baud rate: rst:0xf (BROWNOUT_RST),boot:0x13
(...)."""
_SPEED = rb"(0|-?[1-9]\d{0,3}00e-5)"
_LINE = re.compile(rb'\{"T":1,"L":%b,"R":%b\}\n' % (_SPEED, _SPEED))
_ACCEL = 9.80665 / 8192
"""m/s^2 per unit: the IMU's range is 4 g."""
_GYRO = pi / 180 / 16.4
"""rad/s per unit: the IMU's range is 2000 degrees per second."""


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
    """The line for lights, gimbal or display, with numbers and short texts; empty if it does not fit. `kind`: one of
    AUX."""
    rest = "".join(f",{json.dumps(key)}:{json.dumps(_short(value))}" for key, value in fields.items())
    line = f'{{"T":{_AUX_T[kind]}{rest}}}\n'.encode()
    return b"" if check_aux(line) else line


def _short(value: object) -> object:
    return round(value, 6) if isinstance(value, float) else value


def check_aux(frame: bytes) -> str:
    """Why these bytes must not be written as a line for lights, gimbal or display; "" if they may."""
    if frame == RADIO_OFF:
        return ""
    if len(frame) > _AUX_BYTES or not _AUX_LINE.fullmatch(frame.decode("ascii", "replace")):
        return "no line for lights, gimbal or display"
    return ""


def watchdog(after_ns: int) -> bytes:
    """The line that makes the board stop its wheels this long after the last motion line. The board forgets it when it
    loses power, and does not answer it. Raises FrameError."""
    after_ms = integer("watchdog in ms", after_ns // 1_000_000, *WATCHDOG_MS)
    return f'\n{{"T":136,"cmd":{after_ms}}}\n'.encode()


def reports() -> LineReader:
    """The reader of lines, each of which is a report. A line that is not a JSON object is dropped, because the board
    prints text while it starts."""
    return LineReader(_samples, LONGEST_LINE)


def _samples(line: bytes) -> list[Sample]:
    if _BOOT.search(line):
        return [Restarted("it printed its boot text")]
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
    """The values of these names, finite or not; empty if one is missing or not a number."""
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
    speeds, positions = _numbers(said, "L", "R"), _numbers(said, "odl", "odr")
    if speeds or positions:
        found.append(Wheels(speeds, positions))
    # With an arm, ax to az are where its hand is.
    accel, gyro = _numbers(said, "ax", "ay", "az"), _numbers(said, "gx", "gy", "gz")
    if accel and gyro and "ab" not in said:
        ax, ay, az = accel
        gx, gy, gz = gyro
        found.append(Imu((ax * _ACCEL, ay * _ACCEL, az * _ACCEL), (gx * _GYRO, gy * _GYRO, gz * _GYRO)))
    if centivolts := _numbers(said, "v"):
        found.append(Battery(centivolts[0] / 100))
    return found
