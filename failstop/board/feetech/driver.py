"""The packets that a driver may write to Feetech's STS servos, and the answers that the driver gets. The driver is
LeRobot's LeKiwi host.

Packets are read byte by byte, as a servo reads them. A servo waits forever for the rest of a packet, and never goes
back to a byte that it has already read. Only the wheels' goal speeds move anything. The driver reads from a table for
each servo. At first the table has the ranges and offsets of the settings, and the values to which LeKiwi's servos are
set. It keeps a wheel's goal speed, a torque or the lock that the driver writes. Addresses 56 to 64 have what the servo
reported last.

To the driver, only the wheels and the joints of the settings are on the bus. All other servos seem to be unplugged.
Every write to one servo is answered, even a refused one, because LeRobot's host exits if an answer is missing. A
question gets no answer if it asks for a value that the servo has not reported yet, or for addresses beyond the table.

Sources: Feetech's memory table, feetech-servo-sdk 1.0.0, LeRobot 0.4.4 (8fff0fd).
"""

from __future__ import annotations

from failstop.board.driver import DriverAnswer, DriverFrame, DriverMotion, DriverRefusal
from failstop.board.feetech import codec

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    Row = DriverMotion | DriverAnswer | DriverFrame | DriverRefusal

PATIENCE_NS = 34_000_000
"""How long a host waits for an answer, in ns. This is the timeout of feetech-servo-sdk; LeRobot waits for 50 ms. From a
late answer on, the host would match every answer with the wrong question."""
PAST_NS = 4_000_000_000
"""A new FeetechDriver first gets what the servos sent in the last PAST_NS ns before the driver opened the port. In this
time every joint reports its position, because the service asks even a joint at rest about every two seconds. A host
asks for the positions as soon as it has opened the port."""
_PING, _REG_WRITE, _ACTION, _RECOVERY, _RESET = 0x01, 0x04, 0x05, 0x06, 0x0A
_MEMORY = 90
_MODEL = b"\x09\x03"
"""The model number of an STS3215."""
_FIRMWARE = b"\x03\x0a"
_ID_AT, _LOW_AT, _HIGH_AT, _OFFSET_AT, _MODE_AT, _LOCK = 5, 9, 11, 31, 33, 55
_OFFSET_SIGN = 0x800
_SENSORS = 56
"""The address in a servo's memory where the measured values begin, such as the position."""
_KNOWN_TO = 65
"""failstop asks the servos for measured values only below this address."""
_SET = {7: 0, 21: 16, 22: 32, 23: 0, 41: 254, 85: 254}
"""The values that LeRobot writes to every servo, by address. The gains (21 to 23) are those that LeRobot uses for the
arm."""
_SPEEDS = range(codec.GOAL_SPEED, codec.GOAL_SPEED + 2)
_BEFORE_SPEED = range(codec.GOAL_POSITION, codec.GOAL_SPEED)
"""The addresses of goal position and goal time (42 to 45). A servo in velocity mode ignores both while they are zero,
so only other values are refused."""
_STOPPED = "so the wheels were stopped"
_ARM = "failstop moves the arm only for programs that use its plugin or Robot.arm"
_BY_ID = "at the guard port, servos must be written one by one"


class FeetechDriver:
    """Reads the packets that one driver program writes to the guard port, and answers them as the servos would."""

    def __init__(self, joints: Mapping[int, tuple[int, int, int]]) -> None:
        """`joints` has (lowest position, highest position, homing offset) for each servo of the arm, in steps."""
        self.openers, self.patience_ns, self.past_ns = 1, PATIENCE_NS, PAST_NS
        self._memory = {wheel: _memory(wheel, 0, codec.TURN - 1, 0, mode=1) for wheel in codec.WHEELS}
        self._memory |= {servo: _memory(servo, *told, mode=0) for servo, told in joints.items()}
        self._heard_of: dict[int, set[int]] = {servo: set() for servo in self._memory}
        """The addresses of the measured values that each servo has reported so far."""
        self._error = dict.fromkeys(self._memory, 0)
        self._speeds = dict.fromkeys(codec.WHEELS, 0.0)
        """The wheels' goal speeds, as the driver wrote them."""
        self._packet = bytearray()
        self._heard = b""

    def wrote(self, chunk: bytes, now_ns: int) -> list[Row]:
        """Return the rows (see failstop/board/driver.py) that these bytes from the driver ask for."""
        rows: list[Row] = []
        for value in chunk:
            if packet := self._byte(value):
                rows += self._accept(packet)
        return rows

    def resume(self, before: FeetechDriver) -> None:
        """Continue the conversation `before` with the same driver: with what it has written to the servos, and with
        the values that they have reported, because a host exits if an answer is missing."""
        self._packet = bytearray(before._packet)
        for servo in self._memory.keys() & before._memory.keys():
            measured = before._heard_of[servo] - self._heard_of[servo]
            if not self._heard_of[servo]:
                self._error[servo] = before._error[servo]
            for at in (codec.TORQUE_SWITCH, _LOCK, *_SPEEDS, *measured):
                self._memory[servo][at] = before._memory[servo][at]
            self._heard_of[servo] |= measured

    def _byte(self, value: int) -> bytes:
        """Return the packet that this byte completes. Empty if it completes none."""
        packet = self._packet
        size = len(packet)
        if (size < 2 and value != 0xFF) or (size == 3 and value < 2):
            packet.clear()
        elif size != 2 or value != 0xFF:
            packet.append(value)
            if size > 3 and size == packet[3] + 3:
                whole = bytes(packet)
                packet.clear()
                return whole
        return b""

    def _accept(self, packet: bytes) -> list[Row]:
        to, kind, data = packet[2], packet[4], packet[5:-1]
        if sum(packet[2:]) & 0xFF != 0xFF:
            return [DriverRefusal("a packet with a wrong check", "the servos ignore it too")]
        if kind == codec.SYNC_WRITE and to == codec.EVERY_SERVO and len(data) > 2:
            address, size = data[:2]
            found = range(2, len(data) - size, size + 1)
            return self._write([(data[at], data[at + 1 : at + 1 + size]) for at in found], address)
        if kind == codec.WRITE and data:
            if to == codec.EVERY_SERVO:
                return self._broadcast(data[0], data[1:])
            if to not in self._memory:
                return []
            return [*self._write([(to, data[1:])], data[0]), self._answer(to, b"")]
        if kind == _PING and to in self._memory:
            return [self._answer(to, b"")]
        if kind == codec.READ and len(data) > 1:
            return self._read([to], data[0], data[1])
        if kind == codec.SYNC_READ and to == codec.EVERY_SERVO and len(data) > 2:
            return self._read(data[2:], data[0], data[1])
        if kind in (_REG_WRITE, _ACTION, _RECOVERY, _RESET):
            refusal = DriverRefusal(f"the instruction {kind:#04x}", "it changes a servo, or moves it later: use WRITE")
            return [refusal, self._answer(to, b"")] if to in self._memory else [refusal]
        return []

    # What the driver reads.

    def _read(self, servos: Iterable[int], address: int, size: int) -> list[Row]:
        rows: list[Row] = []
        wanted = range(address, address + size)
        answers = b""
        for servo in servos:
            if servo not in self._memory:
                if servo < codec.EVERY_SERVO:
                    what = f"servo {servo}"
                    rows.append(DriverRefusal(what, "it is not a wheel, and no joint in the settings has this servo"))
            elif wanted.stop <= _MEMORY and self._knows(servo, wanted):
                if wanted.stop > _KNOWN_TO and wanted.start < _SENSORS + 15:
                    why = "failstop does not ask the servos for it, so the answer is 0"
                    rows.append(DriverRefusal("reading status or current (65 to 70)", why))
                answers += self._packet_of(servo, bytes(self._memory[servo][address : wanted.stop]))
        return [*rows, DriverAnswer(answers)] if answers else rows

    def _knows(self, servo: int, wanted: range) -> bool:
        """True if failstop knows the values at all these addresses, so it can answer the driver. A measured value is
        known once the servo has reported it."""
        return all(at in self._heard_of[servo] for at in wanted if _SENSORS <= at < _KNOWN_TO)

    def _packet_of(self, servo: int, data: bytes) -> bytes:
        return codec.packet(servo, self._error[servo], data)

    def _answer(self, servo: int, data: bytes) -> DriverAnswer:
        return DriverAnswer(self._packet_of(servo, data))

    # What the driver writes.

    def _broadcast(self, address: int, data: bytes) -> list[Row]:
        if address == codec.GOAL_SPEED and len(data) == len(_SPEEDS) and not any(data):
            return [self._stop()]
        refusal = DriverRefusal(f"a write to every servo (address {address})", f"{_BY_ID}, {_STOPPED}")
        return [refusal, self._stop(refused=True)]

    def _stop(self, *, refused: bool = False) -> DriverMotion:
        self._speeds = dict.fromkeys(codec.WHEELS, 0.0)
        return DriverMotion(tuple(self._speeds.values()), refused=refused)

    def _write(self, written: Iterable[tuple[int, bytes]], address: int) -> list[Row]:
        """Handle one packet that writes bytes to these servos. The last row is a stop if the wheels must stop.
        Otherwise, if the packet sets a wheel's speed, it is a motion that leaves the other wheels' speeds unchanged."""
        rows: list[Row] = []
        told = stopped = False
        for servo, data in written:
            if servo in codec.WHEELS:
                moved, found = self._wheel(servo, address, data)
                told |= moved
                stopped |= any(isinstance(row, DriverMotion) for row in found)
                rows += [row for row in found if not isinstance(row, DriverMotion)]
            elif servo in self._memory:
                rows += self._joint(servo, address, data)
        if stopped:
            rows.append(self._stop(refused=any(isinstance(row, DriverRefusal) for row in rows)))
        elif told:
            rows.append(DriverMotion(tuple(self._speeds.values())))
        return rows

    def _wheel(self, wheel: int, address: int, data: bytes) -> tuple[bool, list[Row]]:
        """Handle what a packet writes to a wheel. Returns (moved, rows). `moved`: True if the packet sets the wheel's
        speed. `rows`: the refusals, and a stop if the wheels must stop."""
        rows: list[Row] = []
        speed = bytearray()
        for at, value in enumerate(data, address):
            if at in _SPEEDS:
                speed.append(value)
            elif at in _BEFORE_SPEED or at == _MODE_AT:
                if value != (at == _MODE_AT):
                    what = "a wheel's position, PWM or mode (33, 42 to 45)"
                    rows += [DriverRefusal(what, f"it would turn without a speed, {_STOPPED}: use 46"), self._stop()]
            elif at == codec.TORQUE_SWITCH and value <= 1:
                self._memory[wheel][at] = value
                if not value:
                    rows.append(self._stop())
            else:
                rows += self._setting(wheel, at, value)
        if not speed:
            return False, rows
        if len(speed) < len(_SPEEDS):
            return False, [*rows, DriverRefusal("half of a wheel's speed (46 or 47)", f"{_STOPPED}"), self._stop()]
        # Without torque a wheel does not turn, whatever its speed.
        torque = self._memory[wheel][codec.TORQUE_SWITCH]
        self._speeds[wheel] = codec.signed(int.from_bytes(speed, "little")) if torque else 0.0
        self._memory[wheel][_SPEEDS.start : _SPEEDS.stop] = speed
        return True, rows

    def _joint(self, servo: int, address: int, data: bytes) -> list[Row]:
        rows: list[Row] = []
        for at, value in enumerate(data, address):
            if at == codec.TORQUE_SWITCH and value <= 1:
                rows.append(DriverRefusal("torque of the arm (40)", "the service decides whether the arm holds"))
                self._memory[servo][at] = value
            elif at != 41 and codec.GOAL_POSITION <= at < 50:
                rows.append(DriverRefusal("moving the arm (42 to 49)", _ARM))
            else:
                rows += self._setting(servo, at, value)
        return rows

    def _setting(self, servo: int, at: int, value: int) -> list[Row]:
        """Handle one byte that the driver writes to a servo's settings. The lock is only stored in the driver's table.
        A new value for any other setting is refused."""
        if at == _LOCK:
            self._memory[servo][at] = value
            return []
        if at < _MEMORY and self._memory[servo][at] == value:
            return []
        why = "the servo keeps its own; to set up servos, end failstop and use the board's own port"
        return [DriverRefusal(f"a setting of a servo (address {at})", why)]

    # What the servos report.

    def heard(self, chunk: bytes, now_ns: int) -> list[bytes]:
        """Store what the servos measure. Always returns an empty list: the servos send only answers, and failstop
        answers the driver itself."""
        data, at = self._heard + chunk, 0
        while (at := data.find(codec.HEAD, at)) >= 0 and at + 4 <= len(data):
            servo, length = data[at + 2 : at + 4]
            end = at + 4 + length
            if servo >= codec.EVERY_SERVO or not 2 <= length <= codec.LONGEST_REPLY:
                at += 1
            elif end > len(data):
                break
            elif sum(data[at + 2 : end]) & 0xFF != 0xFF:
                at += 1
            else:
                self._measured(servo, data[at + 4], data[at + 5 : end - 1])
                at = end
        # If no head was found, the last byte may still be the first byte of one.
        self._heard = data[at:] if at >= 0 else data[-1:]
        return []

    def _measured(self, servo: int, error: int, data: bytes) -> None:
        """Store the measured values in an answer. The answer's length shows which question it answers."""
        if servo not in self._memory:
            return
        self._error[servo] = error
        if servo in codec.WHEELS:
            begin = codec.GOAL_SPEED if len(data) in codec.SIZES else _MEMORY
        else:
            begin = next((begin for begin, size in codec.READS.values() if size == len(data)), _MEMORY)
        for at, value in enumerate(data, begin):
            if _SENSORS <= at < _KNOWN_TO:
                self._memory[servo][at] = value
                self._heard_of[servo].add(at)


def _memory(servo: int, low: int, high: int, offset: int, *, mode: int) -> bytearray:
    memory = bytearray(_MEMORY)
    memory[:2], memory[3:5], memory[_ID_AT], memory[_MODE_AT] = _FIRMWARE, _MODEL, servo, mode
    for at, value in ((_LOW_AT, low), (_HIGH_AT, high), (_OFFSET_AT, abs(offset) | (_OFFSET_SIGN * (offset < 0)))):
        memory[at : at + 2] = value.to_bytes(2, "little")
    for at, value in _SET.items():
        memory[at] = value
    memory[codec.TORQUE_SWITCH] = memory[_LOCK] = 1
    return memory


def language(settings: Mapping[str, float | str]) -> FeetechDriver:
    """Make a FeetechDriver for a program that has opened the guard port. The program can read the wheels, and the
    joints that are in the settings."""
    names = [key.split(".")[1] for key in settings if key.startswith("joints.") and key.endswith(".servo")]
    tables = [f"joints.{name}" for name in names]
    return FeetechDriver(
        {
            int(settings[f"{table}.servo"]): (
                int(settings.get(f"{table}.low", 0)),
                int(settings.get(f"{table}.high", codec.TURN - 1)),
                int(settings.get(f"{table}.offset", 0)),
            )
            for table in tables
        }
    )
