"""The lines that a driver may write to a slcan adapter with Damiao's motors, and the answers that the driver gets.

A driver opens the adapter, enables the motors, and then sets their speeds. These drivers do so: damiao-motor 1.0.6
through the slcan of python-can 4.6.1, the vendor's DM_Control_Python (7da9387), and openarm_can behind slcand
(9866604). A speed frame may have four bytes or more, and its digits may be lower-case, because the adapters accept
both. failstop answers each speed, and each command to enable or disable a motor, with the motor's newest report. The
status in this answer is the motor's fault, if any. Otherwise it says whether the driver has enabled the motor. A
speed for one motor does not keep another motor turning, because a driver may have a thread for each motor, and one of
them may hang. A driver's question for a register is passed on to the motor, and the answer is passed back. Answers to
failstop's own questions are not passed on.

failstop itself opens the adapter and enables the motors. So it does not pass on the driver's commands to open, close,
enable or disable, and only remembers them. If the driver has closed the adapter, it moves no motor until it opens the
adapter again. If the driver has disabled a motor, this motor does not move until the driver enables it again. Commands
for a torque or a position are refused, and the wheels stop, because failstop can't limit their speed.

The wheels also stop after an incomplete line. A CANable would complete the line with digits of an older line, so the
line could mean anything. After that, nothing moves until the driver has opened the adapter again. For each motor, the
driver must also set the speed mode (or read that it is set), and enable the motor.
"""

from __future__ import annotations

from math import isfinite
from struct import Struct

from failstop.board.damiao import codec, slcan
from failstop.board.driver import DriverAnswer, DriverFrame, DriverMotion, DriverRefusal

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping

    Row = DriverMotion | DriverAnswer | DriverFrame | DriverRefusal

PATIENCE_NS = 1_000_000_000
"""How long damiao-motor waits for an answer about a register, in ns."""
PAST_NS = 1_000_000_000
"""A new DamiaoDriver first gets what the motors sent in the last PAST_NS ns before the driver opened the port. Every
motor sends at least one report in this time."""
MOTOR_NS = 500_000_000
"""A motor that the driver has not commanded for this long, in ns, gets speed zero, unless the setting guard.timeout_s
is longer. It is the time of the motors' watchdogs, as failstop sets them."""
_SPEED, _VALUE = Struct("<f"), Struct("<I")
_LEAST_SPEED = 4
"""The length of the shortest speed frame, in bytes."""
_LONGEST = 30
"""A CANable keeps at most this many characters of a line. If a line is longer, the CANable drops all these characters,
and reads the rest of the line as a new line."""
_PREFIX = b"\xff" * 7
_CLEAR, _ENABLE, _DISABLE, _ZERO = 0xFB, 0xFC, 0xFD, 0xFE
_MIT, _POSITION, _FORCE = 0, 1, 3
"""The modes of a motor. The CAN id of a command is 0x100 times the mode, plus the id of the motor."""
_NO_SPEED = {_MIT: "an MIT command", _POSITION: "a position", _FORCE: "a position with a force"}
_STORE = 0xAA
_USE_SPEEDS = "its speed can't be limited, so the wheels were stopped: use the speed mode (CAN id 0x200 + id)"
_NO_LINE = DriverRefusal(
    "bytes that are no line of slcan",
    "to the adapter they could mean anything, so the wheels stop until the driver sets up adapter and motors again",
)
_CLOSED = DriverRefusal("a frame while the adapter is closed", "the wheels stop: open the adapter first (O)")
_OTHER_FRAME = DriverRefusal("a frame with an extended id, or without data", "no motor takes such a frame")
_NO_NUMBER = DriverRefusal("a speed that is no number", "the wheels were stopped")
_SILENT_MOTOR = DriverRefusal(
    "the last speed of a motor",
    "the driver commands other motors, but has not commanded this one for too long, so it was stopped: does a thread "
    "hang?",
)
_BIT_RATE = DriverRefusal("another bit rate of the CAN", "the adapter stays at 1 Mbit/s (S8), which the motors have")


class DamiaoDriver:
    """Reads the lines that one driver program writes to the guard port, and answers them as the motors would."""

    def __init__(self, motors: int, motor_ns: int = MOTOR_NS) -> None:
        """`motors` is the number of motors. Their CAN ids are counted from 1. `motor_ns`: how long a motor keeps its
        speed while the driver commands only other motors, in ns."""
        self.openers, self.patience_ns, self.past_ns = 1, PATIENCE_NS, PAST_NS
        self._motor_ns = motor_ns
        self._speeds = [0.0] * motors
        self._commanded_ns = [0] * motors
        """The time of the driver's newest speed for each motor, in ns."""
        self._silent: set[int] = set()
        """The motors that were stopped because the driver had not commanded them. It has not ended driving, so if it
        dies, that counts as the death of a driver."""
        self._enabled = [True] * motors
        self._takes_speeds = [True] * motors
        """True for each motor that the driver has in speed mode. It becomes False if the driver asks for another mode,
        or writes a line that could mean anything. It becomes True again when the driver sets the speed mode, or finds
        it set when it reads the mode from the motor."""
        self._open = True
        self._line = b""
        self._heard = slcan.Lines()
        self._reports: dict[int, tuple[int, bytes]] = {}
        """The newest report of each motor, with the CAN id under which the report came."""
        self._asked: set[tuple[int, int]] = set()
        """The driver's questions for registers that have no answer yet, by motor and register."""

    def wrote(self, chunk: bytes, now_ns: int) -> list[Row]:
        """Return the rows (see failstop/board/driver.py) that these bytes from the driver ask for."""
        *lines, rest = (self._line + chunk).split(slcan.CR)
        self._line = rest[: _LONGEST + 1]
        return [row for line in lines for row in self._run(line, now_ns)]

    def heard(self, chunk: bytes, now_ns: int) -> list[bytes]:
        """Store the motors' reports. The driver's next frames are answered from this store. Returns the motors' answers
        about registers that the driver has asked for."""
        found: list[bytes] = []
        for can_id, data in self._heard.frames(chunk):
            if can_id >= codec.SPEED_ID:
                continue
            if 0 < data[0] <= len(self._speeds) and not data[1] and data[2] in (codec.READ, codec.WRITE):
                if data[2] == codec.READ and (data[0], data[3]) in self._asked:
                    self._asked.discard((data[0], data[3]))
                    if data[3] == codec.MODE:
                        self._takes_speeds[data[0] - 1] = _VALUE.unpack_from(data, 4) == (codec.SPEED_MODE,)
                    found.append(slcan.line(can_id, data))
            elif 0 < data[0] & 15 <= len(self._speeds):
                self._reports[data[0] & 15] = can_id, data
        return found

    def resume(self, before: DamiaoDriver) -> None:
        """Continue the conversation `before` with the same driver. Without this, a motor would obey the driver again
        that the driver has disabled."""
        self._open, self._line, self._asked = before._open, before._line, set(before._asked)
        self._reports = before._reports | self._reports
        known = slice(min(len(self._speeds), len(before._speeds)))
        self._enabled[known] = before._enabled[known]
        self._takes_speeds[known] = before._takes_speeds[known]

    def _run(self, line: bytes, now_ns: int) -> list[Row]:
        """Handle one line, without its carriage return. An empty line does nothing here, although it makes a CANable
        repeat its newest command. A line of zeros does nothing either. The adapter may split a long line of zeros into
        several lines, but no line of zeros is a command."""
        command, rest = line[:1], line[1:]
        if not line.strip(b"0"):
            return []
        if len(line) > _LONGEST:
            return self._unknown(_NO_LINE)
        # For these commands an adapter looks only at the first character.
        if command in (b"O", b"C"):
            self._open = command == b"O"
            return []
        if command == b"S":
            return [] if rest == b"8" else [_BIT_RATE]
        if command in (b"T", b"r", b"R"):
            return [_OTHER_FRAME]
        if command != b"t" and command.isalpha():
            return [DriverRefusal(f"the adapter's command {command.decode()}", "the adapter is set up, and not asked")]
        frame = slcan.frame_of(line, least=0)
        if frame is None:
            return self._unknown(_NO_LINE)
        # A closed adapter would keep the frame and send it when it is opened.
        return self._frame(*frame, now_ns) if self._open else self._unknown(_CLOSED)

    def _unknown(self, why: DriverRefusal) -> list[Row]:
        """Stop the wheels after a line that could mean anything. Nobody knows what the bare adapter and its motors
        would do after that, so the driver must set them up again."""
        self._open = False
        self._enabled = [False] * len(self._speeds)
        self._takes_speeds = [False] * len(self._speeds)
        return [why, *self._stop()]

    def _frame(self, can_id: int, data: bytes, now_ns: int) -> list[Row]:
        if can_id == codec.REGISTERS_ID:
            return self._register(data)
        mode, motor = can_id >> 8, can_id & 0xFF
        if not 0 < motor <= len(self._speeds):
            return [self._nobody(motor)]
        if mode == codec.SPEED_ID >> 8:
            return self._speed(motor, data, now_ns)
        if mode == _MIT and len(data) == len(codec.ENABLE) and data.startswith(_PREFIX) and data[7] >= _CLEAR:
            return self._switch(motor, data[7])
        return [DriverRefusal(_NO_SPEED.get(mode, f"a frame with the CAN id {can_id:#x}"), _USE_SPEEDS), *self._stop()]

    def _speed(self, motor: int, data: bytes, now_ns: int) -> list[Row]:
        if len(data) < _LEAST_SPEED:
            return self._unknown(_NO_LINE)
        (speed,) = _SPEED.unpack_from(data)
        if not isfinite(speed):
            return [_NO_NUMBER, *self._stop()]
        if not (self._enabled[motor - 1] and self._takes_speeds[motor - 1]):
            state = "disabled" if self._takes_speeds[motor - 1] else "put into another mode"
            refused = DriverRefusal(f"a speed for motor {motor}, which the driver has {state}", "it would not turn")
            return [refused, *self._report(motor)]
        self._speeds[motor - 1], self._commanded_ns[motor - 1] = speed, now_ns
        self._silent.discard(motor - 1)
        for other, commanded_ns in enumerate(self._commanded_ns):
            if self._speeds[other] and now_ns - commanded_ns >= self._motor_ns:
                self._speeds[other] = 0.0
                self._silent.add(other)
        return [*([_SILENT_MOTOR] if self._silent else []), self._motion(), *self._report(motor)]

    def _switch(self, motor: int, what: int) -> list[Row]:
        """Handle the driver's command to enable a motor, to disable it, or to clear its fault. A motor that becomes
        enabled or disabled gets speed zero. A command to make the motor's present position its new zero position is
        refused."""
        if what == _ZERO:
            return [
                DriverRefusal(f"the zero of motor {motor}'s position", "it stays where it is"),
                *self._report(motor),
            ]
        if what == _CLEAR:
            return self._report(motor)
        was, self._enabled[motor - 1] = self._enabled[motor - 1], what == _ENABLE
        if what == _ENABLE and was:
            return self._report(motor)
        was_told, self._speeds[motor - 1] = self._speeds[motor - 1], 0.0
        self._silent.discard(motor - 1)
        return [*([self._motion()] if was_told else []), *self._report(motor)]

    def _register(self, data: bytes) -> list[Row]:
        motor, what, index = (int.from_bytes(data[:2], "little"), *data[2:4]) if len(data) >= 4 else (0, 0, 0)
        if not 0 < motor <= len(self._speeds):
            return [self._nobody(motor)]
        if what == codec.REPORT:
            return self._report(motor)
        if what == codec.READ and index <= codec.MOST_REGISTER:
            self._asked.add((motor, index))
            return [DriverFrame(codec.register(motor, codec.READ, index), f"{motor} {index}", asks=True)]
        if what == codec.WRITE and len(data) == 8:
            return self._written(motor, index, data)
        what_for = "to store registers" if what == _STORE else "another frame about registers"
        return [DriverRefusal(what_for, "it was not passed on")]

    def _written(self, motor: int, index: int, data: bytes) -> list[Row]:
        """Handle the driver's command to write a register. failstop itself has set the speed mode and the watchdog's
        time. So a command to set either of them is not passed on, but answered as if the motor had accepted it. A
        command for any other mode or register is refused. Another mode also stops the wheels."""
        if index == codec.TIMEOUT:
            refused = DriverRefusal(
                "the time of the motors' watchdog", "failstop sets it itself: this was only answered"
            )
            return [refused, *self._taken(motor, data)]
        if index != codec.MODE:
            return [DriverRefusal(f"a value for register {index} of motor {motor}", "failstop passes on no settings")]
        self._takes_speeds[motor - 1] = _VALUE.unpack_from(data, 4) == (codec.SPEED_MODE,)
        if self._takes_speeds[motor - 1]:
            return self._taken(motor, data)
        return [DriverRefusal(f"another mode for motor {motor}", _USE_SPEEDS), *self._stop()]

    def _taken(self, motor: int, data: bytes) -> list[Row]:
        """Return the answer that a motor gives when it has accepted a value for a register."""
        can_id, _ = self._reports.get(motor, (0, b""))
        return [DriverAnswer(slcan.line(can_id, data))]

    def _nobody(self, motor: int) -> DriverRefusal:
        return DriverRefusal(f"a frame for motor {motor}", f"failstop's settings have motors 1 to {len(self._speeds)}")

    def _report(self, motor: int) -> list[Row]:
        if motor not in self._reports:
            return []
        can_id, data = self._reports[motor]
        status = data[0] >> 4
        if status not in codec.FAULTS:
            status = codec.ENABLED if self._enabled[motor - 1] else 0
        return [DriverAnswer(slcan.line(can_id, bytes((status << 4 | motor,)) + data[1:]))]

    def _motion(self) -> DriverMotion:
        return DriverMotion(tuple(self._speeds), refused=bool(self._silent))

    def _stop(self) -> list[Row]:
        self._speeds = [0.0] * len(self._speeds)
        self._silent.clear()
        return [DriverMotion(tuple(self._speeds), refused=True)]


def language(settings: Mapping[str, float | str]) -> DamiaoDriver:
    """Make a DamiaoDriver for a program that has opened the guard port. The number of motors is one more than the
    highest wheel id in the settings. A motor keeps its speed for no less time than the setting guard.timeout_s."""
    ids = [int(value) for key, value in settings.items() if key.startswith("wheels.id_")]
    timeout_ns = round(float(settings.get("guard.timeout_s", 0.0)) * 1e9)
    return DamiaoDriver(1 + max(ids, default=1), max(MOTOR_NS, timeout_ns))
