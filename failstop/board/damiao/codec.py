"""The frames of Damiao's motors on a CAN of 1 Mbit/s.

Their firmware is closed. The sources are the vendor's manuals (DM-H3510 V1.0, DM-H6215 V1.0, DM-J4310P-2EC V1.3), the
vendor's Python host (cmjang/DM_Control_Python 7da9387), and two other hosts: damiao-motor 1.0.6 and enactic/openarm_can
9866604. Each number here is in at least two of these sources.

The CAN id of a frame shows what the frame does:

- 0x200 plus a motor's id sets the motor's speed, in rad/s of its output shaft, as a little-endian float.
- A motor's id, with `ff ff ff ff ff ff ff` and one more byte: fc enables the motor, fd disables it, fb clears a fault.
- 0x7ff names a motor and a command: 33 reads a register, 55 writes one, cc asks for a report. A written register keeps
  its value until the power goes off.

A motor answers a question for a register with the register's value, and confirms a register that was written. It
answers every other frame with a report of its status and id, position, speed, torque and temperatures.

A stop is a speed of zero: the motor brakes and holds. Disabling it would let it roll.

Register 9 is the motor's own watchdog, in steps of 50 us. A motor that hears nothing for that long switches itself off,
and rolls until somebody clears this fault. So each time motion is enabled, failstop clears the faults and enables the
motors before the first motion. If a motor switches itself off while it drives, failstop treats this as a restart of the
board, and stops the other motors.
"""

from __future__ import annotations

from struct import Struct

from failstop.board.checks import counted, integer, number
from failstop.board.damiao import slcan
from failstop.board.wire import (
    SERVO_CURRENT,
    SERVO_HEAT,
    SERVO_LOAD,
    SERVO_MISSING,
    SERVO_OTHER,
    SERVO_VOLTAGE,
    Answer,
    Health,
    Reader,
    Restarted,
    Sample,
    Wheels,
    beyond,
)

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

UNIT = "rad/s of the output shaft"
LIMIT = 280.0
"""The highest speed of the DM-H3510, in rad/s. It is the fastest of the motors in the sources of this module."""
MOST = 4
"""How many motors the largest base has. A stop is always for this many motors."""
STEPS = 64
"""How many steps of speed make 1 rad/s. Speeds are sent in whole steps, because a float can hold each whole step
exactly."""
SPEED_ID, REGISTERS_ID = 0x200, 0x7FF
READ, WRITE, REPORT = 0x33, 0x55, 0xCC
ENABLE, CLEAR = b"\xff" * 7 + b"\xfc", b"\xff" * 7 + b"\xfb"
MOST_REGISTER = 81
TIMEOUT, MODE, P_MAX, V_MAX = 9, 10, 21, 22
"""The numbers of four registers. TIMEOUT has the watchdog's time, and MODE says whether the motor is commanded by
speed, by position or by torque. P_MAX and V_MAX are the largest position and the largest speed that a report can
have."""
ASKED = (TIMEOUT, MODE, P_MAX, V_MAX)
"""The registers that failstop's questions read. Each question reads a different register, so an answer shows which
question it belongs to."""
SPEED_MODE = 3
TICK_NS = 50_000
MOST_TICKS = 0xFFFFFFFF
DISABLED, ENABLED = 0, 1
"""The status of a motor that does not obey, and of one that does. All other values are faults."""
FAULTS = {
    8: ("its voltage is too high", SERVO_VOLTAGE),
    9: ("its voltage is too low", SERVO_VOLTAGE),
    10: ("it takes too much current", SERVO_CURRENT),
    11: ("its driver is too hot", SERVO_HEAT),
    12: ("its winding is too hot", SERVO_HEAT),
    13: ("it heard nothing for too long", 0),
    14: ("it is overloaded", SERVO_LOAD),
}
OFF_AFTER = 3
"""How many reports in a row must say that an enabled motor is off before failstop believes it. One such report proves
nothing, because it may come while failstop is enabling the motor again."""
DIFFERS = 2
"""A register counts as changed if this many answers in a row show a different value than the one that was set."""
MISSES = 4
"""A motor counts as missing if it leaves this many questions in a row unanswered while another motor answers. A few
lost answers are normal. For example, while a CANable sends one answer to the computer, it drops the answers that come
from the motors."""
REPORT_EVERY = 20
"""The temperatures are reported once for this many answered questions, which is about once a second."""
_SPEED, _COUNT, _FLOAT = Struct("<f4x"), Struct("<I"), Struct("<f")
_MIDDLE, _NOISE = 2047.5, 1.5
"""A reported speed is a number from 0 to 4095. _MIDDLE means that the motor is at rest. It is halfway between two
numbers, so a motor at rest reports one of the numbers next to it. A number that differs from _MIDDLE by _NOISE or less
may be noise, so it also counts as rest."""


def register(motor: int, what: int, index: int = 0, value: int = 0) -> bytes:
    """Return the line that reads or writes a register of a motor, or asks for the motor's report."""
    return slcan.line(REGISTERS_ID, bytes((motor, 0, what, index)) + _COUNT.pack(value))


def _lines(speeds: Iterable[float]) -> bytes:
    """Return a line for each motor with its speed, truncated towards zero to whole steps."""
    whole = [int(speed * STEPS) / STEPS for speed in speeds]
    return b"".join([slcan.line(SPEED_ID + motor, _SPEED.pack(speed)) for motor, speed in enumerate(whole, 1)])


class Motors:
    """Makes and checks the frames for motors with the ids 1, 2 and so on."""

    def __init__(self, count: int) -> None:
        self.wheels = count
        self._ids = range(1, count + 1)
        self.rest = _lines((0.0,) * count)
        self.burst = slcan.FLUSH + slcan.OPEN + _lines((0.0,) * MOST)
        reports = [register(motor, REPORT) for motor in self._ids]
        self.questions = tuple(
            slcan.OPEN
            + b"".join(ask + register(motor, READ, at) for ask, motor in zip(reports, self._ids, strict=True))
            for at in ASKED
        )
        self.opening = b"".join(register(motor, WRITE, MODE, SPEED_MODE) for motor in self._ids)

    def arm(self, time_ns: int) -> bytes:
        """Return the frames that set the motors' watchdogs and enable the motors. Raises FrameError."""
        ticks = integer("time of the watchdog in steps of 50 us", time_ns // TICK_NS, 1, MOST_TICKS)
        lines: list[bytes] = []
        for motor in self._ids:
            lines += (
                register(motor, WRITE, MODE, SPEED_MODE),
                register(motor, WRITE, TIMEOUT, ticks),
                slcan.line(motor, CLEAR),
                slcan.line(motor, ENABLE),
                slcan.line(SPEED_ID + motor, _SPEED.pack(0.0)),
            )
        return b"".join(lines)

    def frame(self, speeds: Sequence[float], limit: float) -> bytes:
        """Return the frame that sets the speeds of all motors. Raises FrameError if a speed is not within plus or minus
        `limit`."""
        counted("speeds", speeds, self.wheels, self.wheels)
        number("limit", limit, 0.0, LIMIT, UNIT)
        return _lines([number("speed of a motor", speed, -limit, limit, UNIT) for speed in speeds])

    def speeds(self, frame: bytes) -> tuple[float, ...] | None:
        """Return the speed that a motion frame sets for each motor, or None for other bytes."""
        *lines, end = frame.split(slcan.CR)
        if end or len(lines) != self.wheels:
            return None
        found: list[float] = []
        for motor, text in zip(self._ids, lines, strict=True):
            parts = slcan.frame_of(text)
            if not parts or parts[0] != SPEED_ID + motor:
                return None
            (speed,) = _SPEED.unpack(parts[1])
            if not -LIMIT <= speed <= LIMIT:
                return None
            found.append(speed)
        return tuple(found)

    def check(self, frame: bytes, limit: float) -> str:
        """Say why these bytes must not be written as a motion frame. Returns "" if they may be written. Never raises,
        whatever the bytes are."""
        found = self.speeds(frame)
        if found is None:
            return "not a frame for every motor"
        if _lines(found) != frame:
            return "not as this board's motion frames are written"
        return beyond(found, limit, LIMIT)

    def check_aux(self, frame: bytes) -> str:
        """Say why these bytes must not be written as a frame that is not motion. Returns "" if the bytes ask a motor
        for one of the registers 0 to MOST_REGISTER. Higher numbers are refused: if such a question lost two characters,
        the motor could read the rest as a command to write a register."""
        found = slcan.frame_of(frame[:-1])
        if not found or found[0] != REGISTERS_ID or found[1][0] not in self._ids or found[1][3] > MOST_REGISTER:
            return "no question for a register of a motor"
        known = register(found[1][0], READ, found[1][3])
        return "" if frame == known else "no question for a register of a motor"

    def replies(self) -> Replies:
        """Make a reader for the answers of these motors."""
        return Replies(self.wheels)


class _Motor:
    """What one motor has reported."""

    def __init__(self) -> None:
        self.v_max = 0.0
        self.level: int | None = None
        """The speed in the motor's newest report, as a number from 0 to 4095. None if no report came since _wheels()
        last returned the speeds."""
        self.obeys = False
        """True if the motor counts as enabled, because it has reported this, or because failstop has enabled all motors
        (Motors.arm)."""
        self.off = 0
        """How many of the motor's reports in a row say that it does not obey."""
        self.set = False
        """True after Motors.arm has set the motor's registers, until the motor has lost one of these values or is
        off."""
        self.differs = {TIMEOUT: 0, MODE: 0}
        """How many answers in a row differ from the value that was set, for the registers TIMEOUT and MODE."""
        self.wrong = self.heat = self.misses = 0


def _fault(status: int) -> tuple[str, int]:
    """Return (what is wrong, in words; the SERVO_ bit for it) for a motor's status. A motor may have faults that are
    not in FAULTS."""
    known = ("", 0) if status in (DISABLED, ENABLED) else (f"it reports fault {status}", SERVO_OTHER)
    return FAULTS.get(status, known)


class Replies(Reader):
    """Decodes the motors' answers. A question counts as answered when every motor has answered it."""

    def __init__(self, count: int) -> None:
        self._lines = slcan.Lines()
        self._motors = {motor: _Motor() for motor in range(1, count + 1)}
        self._set = {MODE: _COUNT.pack(SPEED_MODE)}
        """The value that all motors should have in each register that failstop sets. TIMEOUT is added when a motor
        confirms the watchdog's time."""
        self._asked = 0
        """The register that the newest question asks for."""
        self._answered: set[int] = set()
        """The motors that have answered the newest question."""
        self._last_report: tuple[int, ...] = ()
        self._answers = 0

    def feed(self, chunk: bytes) -> list[Sample]:
        """Return the samples that these bytes complete."""
        found: list[Sample] = []
        for can_id, data in self._lines.frames(chunk):
            # CAN ids from SPEED_ID on are for motors. Another computer on the CAN sent such a frame.
            if can_id >= SPEED_ID:
                continue
            if data[0] in self._motors and not data[1] and data[2] == WRITE:
                self._written(data[3], data[4:])
            elif data[0] in self._motors and not data[1] and data[2] == READ:
                found += self._read(data[0], data[3], data[4:]) if data[3] in ASKED else []
            elif data[0] & 15 in self._motors:
                found += self._reported(data[0] & 15, data)
        return found

    def _written(self, index: int, value: bytes) -> None:
        """Handle a motor's confirmation that a register was written. Only Motors.arm sets the watchdog's time, and it
        also enables all motors. So when one motor confirms the time, every motor counts as enabled. A motor that has
        missed its enable frame will report that it is off."""
        if index == TIMEOUT:
            self._set[TIMEOUT] = value
            for motor in self._motors.values():
                motor.obeys = motor.set = True
                motor.off = 0
                motor.differs = dict.fromkeys(motor.differs, 0)

    def _reported(self, number_: int, data: bytes) -> list[Sample]:
        motor, status = self._motors[number_], data[0] >> 4
        motor.level, motor.heat = data[3] << 4 | data[4] >> 4, data[7]
        why, motor.wrong = _fault(status)
        if status == ENABLED:
            motor.obeys, motor.off = True, 0
            return []
        motor.off += 1
        if not motor.obeys or motor.off < OFF_AFTER:
            return []
        motor.obeys = motor.set = False
        off = f"switched itself off: {why}" if why else "is disabled, although it was enabled"
        return [Restarted(f"motor {number_} {off}"), *self._health()]

    def _forgotten(self, number_: int, index: int, value: bytes) -> list[Sample]:
        """Return a Restarted if a motor has lost a value that Motors.arm has set. Without the speed mode, the motor
        would misunderstand a speed command. Without its watchdog's time, it would not stop itself. Several answers in a
        row must differ (DIFFERS), because one may be garbled."""
        motor = self._motors[number_]
        if not motor.set or index not in motor.differs:
            return []
        motor.differs[index] = motor.differs[index] + 1 if value != self._set[index] else 0
        if motor.differs[index] < DIFFERS:
            return []
        motor.set = False
        what = "its watchdog's time" if index == TIMEOUT else "the mode in which it takes speeds"
        return [Restarted(f"motor {number_} has lost {what}")]

    def _read(self, number_: int, index: int, value: bytes) -> list[Sample]:
        if index != self._asked or number_ in self._answered:
            self._count_misses()
            self._asked, self._answered = index, set()
        motor = self._motors[number_]
        motor.misses = 0
        self._answered.add(number_)
        if index == V_MAX:
            motor.v_max = _FLOAT.unpack(value)[0]
        found = self._forgotten(number_, index, value)
        if len(self._answered) < len(self._motors):
            return [*found, *self._health()] if self._bits() != self._last_report else found
        self._answers += 1
        found += [*self._wheels(), Answer(str(ASKED.index(index)))]
        due = self._answers % REPORT_EVERY == 1 or self._bits() != self._last_report
        return [*found, *self._health()] if due else found

    def _count_misses(self) -> None:
        if self._answered:
            for number_, motor in self._motors.items():
                motor.misses += number_ not in self._answered

    def _wheels(self) -> list[Sample]:
        """Return the speeds of all motors. Returns an empty list until each motor has reported V_MAX, the scale of its
        speeds. Also returns an empty list until each motor has sent a new report since the speeds were last
        returned."""
        every = list(self._motors.values())
        speeds: list[float] = []
        for motor in every:
            if motor.level is None or not motor.v_max:
                return []
            away = motor.level - _MIDDLE
            speeds.append(away / _MIDDLE * motor.v_max if abs(away) > _NOISE else 0.0)
        for motor in every:
            motor.level = None
        return [Wheels(tuple(speeds), ())]

    def _bits(self) -> tuple[int, ...]:
        return tuple([m.wrong | (SERVO_MISSING if m.misses >= MISSES else 0) for m in self._motors.values()])

    def _health(self) -> list[Sample]:
        self._last_report = self._bits()
        rows = zip(self._motors.items(), self._last_report, strict=True)
        return [Health(tuple((number_, 0.0, motor.heat, bits) for (number_, motor), bits in rows))]
