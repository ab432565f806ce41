"""The frames that a driver (the vendor's Python SDK or ROS node) may write to Hiwonder's RRC, and the bytes that the
driver gets from the board.

Frames are read byte by byte, as the board's receiver reads them. The receiver waits forever for the rest of a frame,
and never goes back to an earlier byte. Motors that a motor frame does not name keep their speeds. The board's motor
handler checks nothing. So failstop refuses a whole motor frame and stops the wheels if the frame's number of motors
does not fit its length, a motor does not exist, or a speed is not a finite number.

A question without an answer would block the SDK forever. So every question for a servo is answered. If failstop itself
has asked the same servo the same question, the driver gets the board's newest answer. Otherwise failstop makes an
answer of the usual length. For a bus servo, this answer reports a failure. For a PWM servo, this answer reports the
value 0, because it has no room for a failure. Reports that the board sends unasked are passed on in whole frames.

Sources: the vendor's protocol description and SDK (2c12249; TurboPi's 73b850d), firmware source.
"""

from __future__ import annotations

from math import isfinite
from struct import Struct

from failstop.board.driver import DriverAnswer, DriverFrame, DriverMotion, DriverRefusal
from failstop.board.rrc import codec, framing
from failstop.board.rrc.decoder import Decoder
from failstop.board.rrc.framing import BUS_SERVO, BUZZER, LED, MOTOR, OLED, PWM_SERVO, RGB, SYS, WHEELS

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    Row = DriverMotion | DriverAnswer | DriverFrame | DriverRefusal

_FOREVER_NS = 60_000_000_000
"""For how long failstop assumes that a driver waits for an answer, in ns. In fact the SDK waits forever, so this time
is so long that failstop never drops an answer."""
_PAST_NS = 4_000_000_000
_START, _START_2, _FUNC, _LENGTH, _DATA, _CHECK = range(6)
_ONE, _SEVERAL, _STOP_ONE, _STOP_SEVERAL, _TYPE_OR_DUTY = 0, 1, 2, 3, 5
_ENTRY = Struct("<Bf")
_TYPE_LENGTH = 2
_STOPPED = "so the wheels were stopped"
_NOT_PASSED = "failstop passes only motion and the buzzer's tones on to this board so far"
_PASSED = (framing.SYS, framing.KEY_FUNC, framing.IMU_FUNC, framing.GAMEPAD, framing.SBUS)
_NAMES = {LED: "an LED (1)", BUZZER: "the buzzer (2)", OLED: "the display (10)", RGB: "RGB lights (11)"}
_PWM_READS = {0x05: 2, 0x09: 1}
_BUS_READS = {0x05: 2, 0x07: 2, 0x09: 1, 0x0D: 1, 0x12: 1, 0x22: 1, 0x32: 4, 0x36: 4, 0x3A: 1}
"""The questions to a bus servo, by sub-command, each with the size of the value in its answer, in bytes."""
_PWM_SET_OFFSET = 0x07
_BUS_SETS = (0x10, 0x20, 0x24, 0x30, 0x34, 0x38)
_FAILED = b"\xff"
_FOR_PROGRAMS = "failstop steers by itself, and moves servos only for programs that use Robot.arm"


class RrcDriver:
    """Reads the frames that one driver program writes to the guard port, and answers them as the board would."""

    def __init__(self) -> None:
        self.openers, self.patience_ns, self.past_ns = 1, _FOREVER_NS, _PAST_NS
        self._state = _START
        self._func = self._length = 0
        self._data = bytearray()
        self._skipped = False
        """True if bytes that begin no frame were refused since the last whole frame. More such bytes then cause no new
        refusal."""
        self._speeds = [0.0] * WHEELS
        """The speed of each motor in turns per second, as the driver commanded it last."""
        self._decoder = Decoder()
        self._kept: dict[tuple[int, int, int], bytes] = {}
        """The board's newest answer to each question about each servo. The key is (function, servo, question)."""

    def wrote(self, chunk: bytes, now_ns: int) -> list[Row]:
        """Return the rows (see failstop/board/driver.py) that these bytes from the driver ask for."""
        rows: list[Row] = []
        for value in chunk:
            rows += self._byte(value)
        return rows

    def resume(self, before: RrcDriver) -> None:
        """Continue the conversation `before` with the same driver."""
        self._state, self._func, self._length = before._state, before._func, before._length
        self._data, self._skipped = bytearray(before._data), before._skipped
        self._kept = before._kept | self._kept

    def _byte(self, value: int) -> list[Row]:
        if self._state == _START:
            if value == framing.HEAD[0]:
                self._state = _START_2
                return []
            if self._skipped:
                return []
            self._skipped = True
            return self._refuse("bytes that are not a frame", "the board ignores them")
        if self._state == _START_2:
            self._state = _FUNC if value == framing.HEAD[1] else _START
        elif self._state == _FUNC:
            self._func = value
            self._state = _LENGTH if value <= RGB else _START
        elif self._state == _LENGTH:
            self._length, self._data = value, bytearray()
            self._state = _DATA if value else _CHECK
        elif self._state == _DATA:
            self._data.append(value)
            if len(self._data) == self._length:
                self._state = _CHECK
        else:
            self._state, self._skipped = _START, False
            if value != framing.crc8(self._data, framing.crc8((self._func, self._length))):
                return self._refuse("a frame with a wrong check", "the board ignores it")
            return self._accept(bytes(self._data))
        return []

    def _accept(self, data: bytes) -> list[Row]:
        if self._func == MOTOR:
            return self._motor(data)
        if self._func == BUZZER and not codec.check_aux(sound := framing.seal(BUZZER, data)):
            return [DriverFrame(sound, "buzzer")]
        if self._func in _NAMES:
            return [DriverRefusal(_NAMES[self._func], _NOT_PASSED)]
        if self._func in (PWM_SERVO, BUS_SERVO):
            return self._servo(data)
        what = "a setting of the board (0)" if self._func == SYS else f"a frame of function {self._func}"
        return [DriverRefusal(what, "end failstop, and send it to the board's own port")]

    def _refuse(self, what: str, why: str) -> list[Row]:
        self._speeds = [0.0] * WHEELS
        return [DriverRefusal(what, f"{why}, {_STOPPED}"), DriverMotion(tuple(self._speeds), refused=True)]

    def _motor(self, data: bytes) -> list[Row]:
        kind, rest = data[:1], data[1:]
        if kind == bytes((_ONE,)) and len(rest) == _ENTRY.size:
            return self._motion(_ENTRY.iter_unpack(rest))
        if kind == bytes((_SEVERAL,)) and rest and len(rest) == 1 + rest[0] * _ENTRY.size:
            return self._motion(_ENTRY.iter_unpack(rest[1:]))
        if kind == bytes((_STOP_ONE,)) and len(rest) == 1:
            return self._motion([(rest[0], 0.0)])
        if kind == bytes((_STOP_SEVERAL,)) and len(rest) == 1:
            return self._motion((wheel, 0.0) for wheel in range(WHEELS) if rest[0] >> wheel & 1)
        if kind == bytes((_TYPE_OR_DUTY,)) and len(data) == _TYPE_LENGTH:
            return [DriverRefusal("the type of the motors (3, 5)", "the board keeps the one that it has")]
        if kind == bytes((_TYPE_OR_DUTY,)):
            return self._refuse("a duty cycle (set_motor_duty)", "its speed can't be limited; TurboPi is not supported")
        return self._refuse(
            "a motor frame that does not fit its length", "the board would take what follows for speeds"
        )

    def _motion(self, entries: Iterable[tuple[int, float]]) -> list[Row]:
        """Handle a motor frame that sets these speeds, as (motor, speed). A frame that names no motor sets no speed, so
        it must not make the speeds newer."""
        speeds, named = self._speeds.copy(), False
        for motor, rps in entries:
            if motor >= WHEELS:
                return self._refuse(f"motor {motor + 1}", f"the board has {WHEELS}")
            if not isfinite(rps):
                return self._refuse("a speed that is not a number", "the board would take it")
            speeds[motor], named = rps, True
        self._speeds = speeds
        return [DriverMotion(tuple(speeds))] if named else []

    def _servo(self, data: bytes) -> list[Row]:
        func = self._func
        kind, reads = (data[0], _PWM_READS if func == PWM_SERVO else _BUS_READS) if data else (0, {})
        if kind in reads and len(data) > 1:
            return self._question(data[1], kind, reads[kind])
        name = f"{'a PWM' if func == PWM_SERVO else 'a bus'} servo"
        if func == PWM_SERVO and kind == _PWM_SET_OFFSET:
            if not any(data[2:]):
                return []  # the vendor's node sets it to 0 at its start
            return [DriverRefusal(f"the offset of {name} (4, 07)", "the board keeps the one that it has")]
        if func == BUS_SERVO and kind in _BUS_SETS:
            why = "to set up servos, end failstop and use the board's own port"
            return [DriverRefusal(f"a setting of {name} (5, {kind:02X})", why)]
        return [DriverRefusal(f"moving {name} ({func}, {kind:02X})", _FOR_PROGRAMS)]

    def _question(self, servo: int, kind: int, size: int) -> list[Row]:
        if kept := self._kept.get((self._func, servo, kind)):
            return [DriverAnswer(framing.seal(self._func, kept))]
        # A PWM servo's answer has no room for a failure.
        failed = (_FAILED if self._func == BUS_SERVO else b"") + bytes(size)
        why = "failstop has not read it from the board" + (
            ", so the answer is 0" if self._func == PWM_SERVO else ", so it failed"
        )
        name = "PWM" if self._func == PWM_SERVO else "bus"
        return [
            DriverRefusal(f"reading {name} servo {servo} ({self._func}, {kind:02X})", why),
            DriverAnswer(framing.seal(self._func, bytes((servo, kind)) + failed)),
        ]

    def heard(self, chunk: bytes, now_ns: int) -> list[bytes]:
        """Return the board's reports for the driver, in whole frames. Keeps the answers to failstop's own questions for
        wrote() instead."""
        found: list[bytes] = []
        for func, data in self._decoder.feed(chunk):
            if func in _PASSED:
                found.append(framing.seal(func, data))
            elif func in (PWM_SERVO, BUS_SERVO) and len(data) > 2:
                self._kept[func, data[0], data[1]] = data
        return found


def language(_settings: Mapping[str, float | str]) -> RrcDriver:
    """Make an RrcDriver for a program that has opened the guard port. It needs no settings."""
    return RrcDriver()
