"""The lines of JSON that a driver may write to Waveshare's ugv_base_ros (commit c967326), and the bytes that the driver
gets from the board.

T:1 sets the speeds of the wheels, and T:13 the speed and turn rate of the base. The values of T:13 may be numbers or
texts of numbers. T itself may be a text too, because the vendor's ROS 2 node sends it as a text. A line without T
counts as T:0, the board's emergency stop. failstop writes a plain stop instead, so an arm keeps its torque.

The board acknowledges nothing, so a refused line needs no answer. The board's reports are passed on. T:1001 comes
twenty times a second, but a driver can ask for fewer of these reports, or none. Answers to failstop's own questions are
kept, and given to a driver that asks the same question.
"""

from __future__ import annotations

import json
from math import isfinite

from failstop.board.driver import DriverAnswer, DriverFrame, DriverMotion, DriverRefusal
from failstop.board.ugv import codec, lenient

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping

    Row = DriverMotion | DriverAnswer | DriverFrame | DriverRefusal

OPENERS = 2
"""How many programs may have the port open. Of the vendor's two ROS 2 nodes, ugv_driver writes and ugv_bringup
reads."""
PATIENCE_NS = 1_000_000_000
"""How long a driver waits for an answer, in ns. If its questions are older than this, failstop answers only the newest
one."""
_TRACK_M = 0.172
"""The track of the widest base that this firmware knows, in m. The firmware uses the track to turn T:13's turn rate Z
into wheel speeds. The setting wheels.track_m may make it smaller, but not larger."""
_LONGEST = 4096
"""The longest line that is accepted from a driver, in bytes. The board itself has no limit, but no driver writes longer
lines."""
_REST = (0.0, 0.0)
_MS = 1_000_000
_SOON_NS = 5 * _MS
"""A driver may ask for only one report (T:1001) per interval. A report that comes too early by this time or less, in
ns, is still passed on, because the board does not send its reports at exact times."""

_STOP, _SPEEDS, _PWM, _BODY = 0, 1, 11, 13
_ANSWERED_BY = {126: 1002, 130: codec.REPORT, 139: 139}
"""The T of each question, with the T of the board's answer."""
_OWN = (1002, 139)
"""The answers to failstop's own questions. A driver gets these only if it asks for them."""
_FLOW, _INTERVAL, _ECHO, _RADIO = 131, 142, 143, 300
_KEEPS = {4: "the type of its module (T:4)", 900: "the type of the robot (T:900)"}
_ARM = (*range(100, 124), 144, 210, 1041)
_NO_ARM = "failstop can't move an arm on this board yet"
_WAITS = {135: "stopping the gimbal (T:135)", 141: "the gimbal (T:141)"}
_DEAF = "the board hears no stop for up to 0.8 s if a servo of the gimbal does not answer: use T:133 or T:134"
_ODD = "a field in it is not known, too long, or neither a number nor a text, so it was not passed on"


class UgvDriver:
    """Reads the lines that one driver program writes to the guard port, and answers them as the board would."""

    def __init__(self, track_m: float) -> None:
        """`track_m` is the distance between the left and the right wheels. It turns T:13's turn rate into wheel speeds.
        More than _TRACK_M counts as _TRACK_M."""
        self.openers, self.patience_ns, self.past_ns = OPENERS, PATIENCE_NS, 0
        self._half_m = min(track_m, _TRACK_M) / 2.0
        self._line = b""
        self._too_long = False
        self._heard = b""
        self._kept: dict[int, bytes] = {}
        """The board's newest line for each T that answers a question."""
        self._flows = True
        self._every_ns = 0
        self._passed_ns = -60_000 * _MS

    def wrote(self, chunk: bytes, now_ns: int) -> list[Row]:
        """Return the rows (see failstop/board/driver.py) that these bytes from the driver ask for."""
        *lines, self._line = (self._line + chunk).split(b"\n")
        rows: list[Row] = []
        for line in lines:
            long, self._too_long = self._too_long or len(line) > _LONGEST, False
            rows += self._not_json() if long else self._run(line)
        if len(self._line) > _LONGEST:
            self._line, self._too_long = b"", True
        return rows

    def resume(self, before: UgvDriver) -> None:
        """Continue the conversation `before` with the same driver. It gets reports only as often as it has asked for
        them."""
        self._line, self._too_long = before._line, before._too_long
        self._flows, self._every_ns, self._passed_ns = before._flows, before._every_ns, before._passed_ns
        self._kept = before._kept | self._kept

    def _run(self, line: bytes) -> list[Row]:
        if not line.strip(b" \t\r"):
            return []
        try:
            said = lenient.loads(line)
        except lenient.NotTaken:
            return self._not_json()
        fields = said if isinstance(said, dict) else {}
        kind = _whole(fields.get(b"T"))
        if kind == _STOP:
            return [DriverMotion(_REST)]
        if kind in (_SPEEDS, _BODY):
            return self._motion(kind, fields)
        if kind == _PWM:
            why = "its speed can't be limited, so the wheels were stopped: use T:1"
            return [DriverRefusal("raw PWM (T:11)", why), DriverMotion(_REST, refused=True)]
        if kind in _ANSWERED_BY:
            kept = self._kept.get(_ANSWERED_BY[kind])
            return [DriverAnswer(kept + b"\r\n")] if kept else []
        if kind in codec.AUX:
            return self._aux(kind, fields)
        return self._setting(kind, fields)

    def _aux(self, kind: int, fields: dict[bytes, object]) -> list[Row]:
        """Return the rows for a driver's line for lights, gimbal or display. failstop does not pass on the driver's own
        line, but writes the same command itself."""
        others = {key.decode("latin-1"): value for key, value in fields.items() if key != b"T"}
        texts = {key: value.decode("latin-1") if isinstance(value, bytes) else value for key, value in others.items()}
        line = codec.aux(kind, texts)
        if not line:
            return [DriverRefusal(codec.AUX[kind], _ODD)]
        return [DriverFrame(line, f"{kind} {texts.get('lineNum', '')}")]

    def _not_json(self) -> list[Row]:
        why = "the board would ignore it and drive on, so the wheels were stopped: is the driver made for this board?"
        return [DriverRefusal("a line that is not JSON", why), DriverMotion(_REST, refused=True)]

    def _motion(self, kind: int, fields: dict[bytes, object]) -> list[Row]:
        if kind == _SPEEDS:
            left, right = fields.get(b"L"), fields.get(b"R")
            if not (_is_number(left) and _is_number(right)):
                return [DriverRefusal("T:1 without two numbers", "the board ignores it too")]
            speeds = _float(left), _float(right)
        else:
            forward, turn = _float(fields.get(b"X")), _float(fields.get(b"Z")) * self._half_m
            speeds = forward - turn, forward + turn
        if not all(isfinite(speed) and abs(speed) <= codec.LIMIT for speed in speeds):
            why = f"the board ignores it too, as it takes {codec.LIMIT:g} m/s at most"
            return [DriverRefusal(f"a speed of more than {codec.LIMIT:g} m/s (T:{kind})", why)]
        return [DriverMotion(speeds)]

    def _setting(self, kind: int, fields: dict[bytes, object]) -> list[Row]:
        value = _whole(fields.get(b"cmd"))
        if kind == _FLOW:
            self._flows = value != 0
            return []
        if kind == _INTERVAL:
            self._every_ns = min(max(0, value), 60_000) * _MS
            return []
        if kind == _ECHO and not value:
            return []
        if kind in _ARM:
            return [DriverRefusal(f"a command for an arm (T:{kind})", _NO_ARM)]
        if kind == _RADIO and not _whole(fields.get(b"mode")):
            return [DriverFrame(codec.RADIO_OFF, "radio")]
        if kind in _WAITS:
            return [DriverRefusal(_WAITS[kind], _DEAF)]
        if kind in _KEEPS:
            return [DriverRefusal(_KEEPS[kind], "the board keeps the one that it has")]
        if kind == _RADIO:
            return [DriverRefusal("obeying ESP-NOW radio (T:300)", "anybody near it could drive the robot")]
        why = "it may change the board's settings; end failstop, and send it to the board's own port"
        return [DriverRefusal(f"T:{kind}", why)]

    def heard(self, chunk: bytes, now_ns: int) -> list[bytes]:
        """Return the board's reports for the driver, in whole lines. Keeps the answers to failstop's own questions for
        wrote() instead."""
        *lines, rest = (self._heard + chunk).split(b"\n")
        self._heard = rest[-codec.LONGEST_LINE :]
        return [line.rstrip(b"\r") + b"\r\n" for line in lines if self._passes(line, now_ns)]

    def _passes(self, line: bytes, now_ns: int) -> bool:
        try:
            said = json.loads(line)
        except (ValueError, RecursionError):
            return False  # text that the board prints while it starts, or half a line
        kind = said.get("T") if isinstance(said, dict) else None
        if not isinstance(kind, int):
            return False  # an object without T would end the vendor's node
        if kind in _ANSWERED_BY.values():
            self._kept[kind] = line.rstrip(b"\r")
        if kind in _OWN or not self._flows:
            return False
        if kind == codec.REPORT:
            if now_ns - self._passed_ns < self._every_ns - _SOON_NS:
                return False
            self._passed_ns = now_ns
        return True


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _float(value: object) -> float:
    """Return the number that the board reads from a value: a number, a text that spells a number, or true (1). Anything
    else counts as 0."""
    if isinstance(value, bytes):
        try:
            value = lenient.number(value)
        except lenient.NotTaken:
            return 0.0
    try:
        return float(value) if isinstance(value, (int, float)) else 0.0
    except OverflowError:
        return float("inf")


def _whole(value: object) -> int:
    """Return the value rounded towards zero, or 0 if it does not fit into 32 bits."""
    found = _float(value)
    return int(found) if -(2**31) <= found < 2**31 else 0


def language(settings: Mapping[str, float | str]) -> UgvDriver:
    """Make a UgvDriver for a program that has opened the guard port. It uses the setting wheels.track_m."""
    return UgvDriver(float(settings.get("wheels.track_m", _TRACK_M)))
