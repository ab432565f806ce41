"""The packets of the VESC firmware. Source: vedderb/bldc b9d287b.

A packet is `02 | length | payload | CRC-16/XMODEM | 03`, big-endian. The payload begins with its command. The
controller at the port passes on packets to a controller on its CAN. The payload of such a packet is FORWARD, the CAN
id, and the payload for the other controller. The frame for several motors has one packet for each, in one write. The
packet for the motor at the port comes first. Otherwise this motor would wait for up to 5 ms if nothing on the CAN took
the other packet (comm_can.c).

The stop is a duty cycle of zero. The firmware brakes with as much current as the motor is configured for, and then
keeps the phases shorted. Other commands are worse (mcpwm_foc.c, foc_math.c). A current of zero lets the motor roll. A
speed of zero follows a ramp, by default 25,000 ERPM per second. A brake current would need a number that fits the
motor.

If a packet is invalid, the receiver looks for other packets in the bytes that it has received. So a stop among these
bytes is never lost, only late (packet.c, since firmware 3.48). After a cut packet of this module the delay is a few
bytes, or up to 260 if the speed in the packet looks like the head of another packet. After a garbled length, or a long
packet of another program, it is up to PENDING bytes.
"""

from __future__ import annotations

from binascii import crc_hqx
from struct import Struct

from failstop.board.checks import counted, integer, number
from failstop.board.steered import ServoSteering
from failstop.board.wire import (
    SERVO_CURRENT,
    SERVO_HEAT,
    SERVO_MISSING,
    SERVO_OTHER,
    SERVO_VOLTAGE,
    Answer,
    Battery,
    Health,
    Reader,
    Restarted,
    Sample,
    Wheels,
    beyond,
)
from failstop.data import Data

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence


SHORT, LONG, END = 2, 3, 3
"""The first byte of a packet is SHORT if its length is written in one byte, and LONG if it is written in two. The last
byte is END."""
DUTY, RPM, SERVO, FORWARD, SELECTED = 5, 8, 12, 34, 50
"""The commands that failstop uses: set a duty cycle, set a speed in ERPM, set the servo, pass a command on to the CAN,
and get some of a controller's values."""
LIMIT = 100_000.0
"""The highest speed to which a controller turns a motor by default, in ERPM (mcconf_default.h)."""
LEAST = 900.0
"""The lowest speed at which a controller turns a motor by default, in ERPM (MCCONF_S_PID_MIN_RPM). If a lower speed is
commanded, the controller brakes."""
STILL = 50
"""A reported speed below this, in ERPM, may be noise from a motor at rest. The tachometer shows whether the motor
turns."""
UNIT = "ERPM, the electrical revolutions a minute"
STEPS = 6
"""How many steps the tachometer counts in one electrical revolution."""
MOST_PAYLOAD = 512
PENDING = MOST_PAYLOAD + 6
"""How many more bytes of a packet a receiver may wait for, at most."""
BURST = 130
"""How many bytes a burst has. Each writer writes its burst four times, and four bursts are longer than PENDING. Bursts
are not longer than they must be, because a motion frame that follows them waits until they have been sent: 11 ms per
burst on a serial line."""
LOCAL, BEHIND = 1, 2
"""The ids of the controllers in reports: LOCAL is the one at the port, and BEHIND is the one on its CAN."""
MISSES = 2
"""The second controller counts as missing if it leaves this many questions in a row unanswered while the first
controller answers. A question does not count if garbled bytes came after it, because they may have been the answer."""
REPORT_EVERY = 20
"""The temperatures are reported once per this many answers, which is about once a second."""
WRONG = {0: 0, 1: SERVO_VOLTAGE, 2: SERVO_VOLTAGE, 4: SERVO_CURRENT, 5: SERVO_HEAT, 6: SERVO_HEAT}
"""The faults of a controller (FAULT_CODE_ of datatypes.h) that failstop can name, with the bit for each. All other
codes are SERVO_OTHER, for example 3 for the chip that drives the transistors. The controller releases its motor at any
fault."""
UNDER_VOLTAGE = 2
FIRST_US, WAY_US = 1000, 1000
"""The shortest pulse of the servo output, and how much longer the longest pulse is, in us (SERVO_OUT_PULSE_ of
conf_general.h). A position is sent in thousandths of the way from the shortest pulse to the longest."""
_PLACE = Struct(">Bh")
_SPEED = Struct(">Bi")
_ASK = Struct(">BI")
_HEAT, _MOTOR_HEAT, _SPEED_NOW, _VOLTS, _TACHOMETER, _FAULT, _ID, _STATUS = (
    1 << bit for bit in (0, 1, 7, 8, 13, 15, 17, 21)
)
_MASK = _SPEED_NOW | _VOLTS | _TACHOMETER | _FAULT | _ID | _STATUS
MASKS = (_MASK, _HEAT | _MASK, _MOTOR_HEAT | _MASK, _HEAT | _MOTOR_HEAT | _MASK)
"""The four questions, each as a mask of the values that it asks for. An answer repeats the mask of its question, so
failstop can match the two. With only two different questions, it would take longer after lost answers to find out which
question an answer belongs to. No byte of a mask may look like the head of a packet. Otherwise, after a question was cut
short, the receiver could take this byte for a head, and wait for the rest of a packet that never comes."""
_VALUES = {mask: Struct(f">BI{'h' * (mask & (_HEAT | _MOTOR_HEAT)).bit_count()}ihiBB") for mask in MASKS}
"""The form of the answer to each question, without the status at the end, which older firmware does not send."""
_LONGEST = 128
"""Any packet that a controller sends to failstop, or to a driver at the guard port, is shorter than this, in bytes."""

_LEAST = {SHORT: 1, LONG: 255}
"""The shortest payload of a packet, by the first byte of the packet."""


def packet(payload: bytes) -> bytes:
    """Return the packet with this payload of at most MOST_PAYLOAD bytes."""
    head = SHORT if len(payload) < 256 else LONG
    length = len(payload).to_bytes(head - 1, "big")
    return bytes((head,)) + length + payload + crc_hqx(payload, 0).to_bytes(2, "big") + bytes((END,))


def payloads(data: bytes) -> tuple[list[bytes], bytes]:
    """Return the payloads of all whole packets, and the bytes of an incomplete packet at the end."""
    found = list(pieces(data))
    return [payload for payload, _ in found if payload], data[sum(size for _, size in found) :]


def pieces(data: bytes) -> Iterator[tuple[bytes, int]]:
    """Yield (payload, length) for each whole packet. Bytes that belong to no packet are skipped one at a time, as the
    firmware does. Each skipped byte gives an empty payload and the length 1."""
    at = 0
    while at < len(data):
        head = data[at]
        size = int.from_bytes(data[at + 1 : at + head], "big") if head in (SHORT, LONG) else 0
        begin, payload, length = at + head, b"", 1
        if head in (SHORT, LONG) and not (begin <= len(data) and not _LEAST[head] <= size <= MOST_PAYLOAD):
            end = begin + size + 3
            if begin > len(data) or end > len(data):
                return
            inside = data[begin : begin + size]
            if data[end - 1] == END and crc_hqx(inside, 0) == int.from_bytes(data[end - 3 : end - 1], "big"):
                payload, length = inside, end - at
        yield payload, length
        at += length


VALUES, FIRMWARE = packet(b"\x04"), packet(b"\0")
"""The two questions that a driver may ask: for all values, and for the version of the firmware."""


def check_aux(frame: bytes) -> str:
    """Return the reason to refuse these bytes as a frame that is not motion, or "" to accept them. It accepts only
    VALUES and FIRMWARE."""
    return "" if frame in (VALUES, FIRMWARE) else "no question for values or the firmware"


class Steering(ServoSteering):
    """Makes and checks the frames for the steering servo at a controller. The settings give the pulse for straight
    ahead and the change per radian, both in us. All pulses must be 1000 to 2000 us long."""

    __slots__ = ()

    def frame(self, angle_rad: float) -> bytes:
        """Return the packet that steers to this angle, positive to the left. Raises FrameError."""
        place = self._pulses(angle_rad) - FIRST_US
        return packet(_PLACE.pack(SERVO, integer("place of the servo", place, 0, WAY_US)))

    def check(self, frame: bytes) -> str:
        """Return the reason to refuse these bytes as a steering frame, or "" to accept them. Never raises."""
        payload = frame[2:-3]
        if len(payload) != _PLACE.size or payload[0] != SERVO or packet(payload) != frame:
            return "not a steering frame"
        _, place = _PLACE.unpack(payload)
        return self._beyond(place + FIRST_US)


class Motors:
    """Makes and checks the frames for one or two motors. The controller at the port has the only motor, or the left
    motor. The controller on the CAN has the right motor."""

    def __init__(self, can_ids: tuple[int, ...] = ()) -> None:
        """`can_ids` are the CAN ids of the controllers that are not at the port."""
        self._heads = [b"", *(bytes((FORWARD, can_id)) for can_id in can_ids)]
        self.wheels = len(self._heads)
        self.rest = self.frame((0.0,) * self.wheels, 0.0)
        self.burst = self.rest + bytes(BURST - 2 * len(self.rest)) + self.rest
        self.questions = tuple(self._packets([_ASK.pack(SELECTED, mask)] * self.wheels) for mask in MASKS)

    def _packets(self, every: Sequence[bytes]) -> bytes:
        return b"".join(packet(head + payload) for head, payload in zip(self._heads, every, strict=True))

    def _written(self, speeds: Sequence[float]) -> bytes:
        """Return the frame for these speeds, truncated towards zero. A motor with the speed zero is braked."""
        whole = [int(speed) for speed in speeds]
        return self._packets([_SPEED.pack(RPM if speed else DUTY, speed) for speed in whole])

    def frame(self, speeds: Sequence[float], limit: float) -> bytes:
        """Return the frame that sets the speeds of all motors. Raises FrameError if a speed is not within plus or minus
        `limit`."""
        counted("speeds", speeds, self.wheels, self.wheels)
        number("limit", limit, 0.0, LIMIT, "ERPM")
        return self._written([number("speed of a motor", speed, -limit, limit, "ERPM") for speed in speeds])

    def speeds(self, frame: bytes) -> tuple[float, ...] | None:
        """Return the speed that a motion frame sets for each motor, or None for other bytes."""
        if len(frame) != len(self.rest):
            return None
        found: list[float] = []
        for payload, head in zip(payloads(frame)[0], self._heads, strict=False):
            if not payload.startswith(head) or len(payload) != len(head) + _SPEED.size:
                return None
            command, speed = _SPEED.unpack(payload[len(head) :])
            if command != (RPM if speed else DUTY):
                return None
            found.append(float(speed))
        return tuple(found) if len(found) == self.wheels else None

    def check(self, frame: bytes, limit: float) -> str:
        """Return the reason to refuse these bytes as a motion frame, or "" to accept them. Never raises."""
        found = self.speeds(frame)
        if found is None:
            return "not a frame for every motor"
        if self._written(found) != frame:
            return "not as this board's motion frames are written"
        return beyond(found, limit, LIMIT)

    def replies(self) -> Replies:
        """Make a reader for the answers of these controllers."""
        return Replies(self._heads[-1][-1:])


class Values(Data):
    """The values that one controller reports about its motor and its supply."""

    speed: float
    """The motor's speed in ERPM. A speed below STILL is reported as 0."""
    position: float
    """The count of the motor's tachometer."""
    volts: float


class Replies(Reader):
    """Decodes the controllers' answers. A question counts as answered when all controllers have answered it. The
    controller at the port answers first. An answer of the second controller counts only for the question that the first
    controller has just answered."""

    def __init__(self, other: bytes) -> None:
        """`other` is the CAN id of the second controller, as one byte. Empty if there is no second controller."""
        self._kept = b""
        self._other = other
        self._first: tuple[int, Values] | None = None
        """The newest answer of the controller at the port, as (mask, values). It waits here for the second controller's
        answer to the same question. None if no answer waits."""
        self._misses = 0
        self._first_heard = False
        """True once the controller at the port has answered."""
        self._alone = 0
        """How many answers with the second controller's id came before that."""
        self._garbled = False
        """True if bytes that belong to no packet came since the last answer of the controller at the port. They may
        have been the second controller's answer."""
        self._heat = {LOCAL: 0}
        self._wrong = {LOCAL: 0}
        """What is wrong with each controller, as a sum of SERVO_ bits (wire.py), by the controller's id in reports."""
        self._faults: dict[int, int] = {}
        """The fault code of each controller. For 0.5 s after a fault, a controller ignores all commands for its motor,
        but still answers questions (mc_interface.c, mc_interface_fault_stop). So such an answer is no sign that it has
        executed a stop. UNDER_VOLTAGE is left out: a controller without a battery has it all the time."""
        self._last_report: dict[int, int] = {}
        """The value of _wrong in the last report."""
        self._answers = 0

    def feed(self, chunk: bytes) -> list[Sample]:
        """Return the samples that these bytes complete."""
        self._kept += chunk
        found: list[Sample] = []
        while True:
            done = 0
            for payload, size in pieces(self._kept):
                done += size
                if payload:
                    found += self._heard(payload)
                else:
                    self._garbled = True
            self._kept = self._kept[done:]
            # If an incomplete packet is longer than any answer, it is not a packet: its head was garbled.
            if len(self._kept) <= _LONGEST:
                return found
            self._kept, self._garbled = self._kept[1:], True

    def _heard(self, payload: bytes) -> list[Sample]:
        mask = int.from_bytes(payload[1:5], "big")
        form = _VALUES.get(mask)
        if payload[0] != SELECTED or not form or len(payload) - form.size not in (0, 1):
            return []
        _, _, *heat, speed, decivolts, tachometer, fault, can_id = form.unpack_from(payload)
        values = Values(float(speed) if abs(speed) >= STILL else 0.0, float(tachometer), decivolts / 10)
        one = BEHIND if bytes((can_id,)) == self._other else LOCAL
        self._wrong[one] = WRONG.get(fault, SERVO_OTHER)
        before, self._faults[one] = self._faults.get(one, 0), fault
        released = [Restarted(f"controller {one} released its motor (fault {fault})")] if fault and not before else []
        if mask & _HEAT:
            self._heat[one] = max(0, min(heat[0] // 10, 255))
        found = released + self._paired(mask, values, one)
        due = any(isinstance(sample, Answer) for sample in found) and self._answers % REPORT_EVERY == 1
        if due or self._wrong != self._last_report:
            self._last_report = dict(self._wrong)
            rows = self._last_report.items()
            found.append(Health(tuple((each, 0.0, self._heat.get(each, 0), bits) for each, bits in rows)))
        return found

    def _paired(self, mask: int, values: Values, one: int) -> list[Sample]:
        """Add the answer of controller `one` (LOCAL or BEHIND) to the question with this `mask`. Returns the samples if
        every controller has now answered that question, otherwise an empty list."""
        if not self._other:
            return self._answered(mask, values)
        first, self._first = self._first, None
        if one == BEHIND:
            self._misses = 0
            if not self._first_heard:
                self._wonder()
            return self._answered(mask, first[1], values) if first and first[0] == mask else []
        self._first_heard = True
        self._misses += first is not None and not self._garbled
        self._garbled = False
        if self._misses >= MISSES:
            self._wrong[BEHIND] = SERVO_MISSING
        self._first = mask, values
        return []

    def _wonder(self) -> None:
        """Count an answer of the second controller before the first answer of the controller at the port. The one at
        the port passes the other's answers on, so it answers too. If it seems not to, all answers are its own: it has
        the id that the settings give to the second controller, so the second one does not answer."""
        self._alone += not self._garbled
        self._garbled = False
        if self._alone >= MISSES:
            self._wrong[BEHIND] = SERVO_MISSING

    def _answered(self, mask: int, *every: Values) -> list[Sample]:
        self._answers += 1
        volts = min(values.volts for values in every)
        speeds, positions = tuple([values.speed for values in every]), tuple([values.position for values in every])
        told: list[Sample] = [Wheels(speeds, positions), Battery(volts)]
        if any(fault not in (0, UNDER_VOLTAGE) for fault in self._faults.values()):
            return told
        return [*told, Answer(str(MASKS.index(mask)))]
