"""The packets of Feetech's STS servos: `FF FF | id | length | instruction | data | check`, little-endian.

`length` counts the instruction, the data and the check. The check is the inverted sum of all bytes between FF FF and
the check. A servo's answer has the same form, with its error bits in the place of the instruction. These bits are
ERRBIT_* of feetech-servo-sdk 1.0.0, the same as the SERVO_ bits of failstop/board/wire.py. Speeds have their sign in
bit 15 (Feetech's memory table; feetech-servo-sdk 1.0.0 makes the same bytes).
"""

from __future__ import annotations

from struct import Struct

from failstop.board.checks import counted, number
from failstop.board.servos import POSITION, SUPPLY, TEMPERATURE, TORQUE, ServoAnswer
from failstop.board.wire import SERVO_MISSING, Answer, Battery, Health, Obeyed, Reader, Sample, Wheels, beyond

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

HEAD = b"\xff\xff"
EVERY_SERVO = 0xFE
READ, WRITE, SYNC_READ, SYNC_WRITE = 0x02, 0x03, 0x82, 0x83
TORQUE_SWITCH, GOAL_POSITION, GOAL_SPEED = 40, 42, 46
"""Addresses in a servo's memory."""

WHEELS = (7, 8, 9)
"""The ids of the wheels' servos, as LeKiwi has them: left, rear, right."""
LIMIT = 3000.0
"""The highest speed that LeKiwi commands for a wheel, in steps per second."""
TURN = 4096
"""How many steps make a turn."""
UNIT = "steps a second"
SIZES = (18, 19)
"""failstop has two questions to the wheels. They read this many bytes of each wheel's memory, beginning at the goal
speed. An answer does not name its question, but its length shows which question it was."""
READS = {TORQUE: (TORQUE_SWITCH, 1), POSITION: (56, 8), SUPPLY: (62, 3), TEMPERATURE: (63, 4)}
"""The questions to a servo of the arm, each with the address and the size that it reads. The size of an answer shows
which question it belongs to. The question for the position also reads the load and the temperature, which come after
the position in the servo's memory."""
REPORT_EVERY = 10
"""The supply and the servos' health are reported once for this many answered questions to the wheels, which is about
once a second."""

MISSES = 2
"""A wheel counts as missing if it leaves this many questions in a row unanswered while another wheel answers. One lost
answer is not enough, because it may have been garbled on the line."""

LONGEST_REPLY = 64
_SIGN = 0x8000
_LOAD_SIGN = 0x400
_SPEEDS = Struct("<BHBHBH")
_WHEEL = Struct("<H10xHxxB")
"""The format of a wheel's memory, beginning at the goal speed. It has the goal speed, the present speed, and the supply
in steps of 0.1 V."""
_HEALTH = Struct("<HxB")
"""The format of a servo's memory, beginning at the load. It has the load and the temperature."""


def packet(servo: int, instruction: int, data: bytes) -> bytes:
    """Return the packet with these parts. They are not checked."""
    body = bytes((servo, len(data) + 2, instruction)) + data
    return HEAD + body + bytes((~sum(body) & 0xFF,))


def sync_write(address: int, size: int, rows: bytes) -> bytes:
    """Return the packet that writes to this address of several servos. `rows`: each servo's id, followed by its bytes.
    No servo answers such a packet. To stop the wheels, write speed 0 only to the wheels' servos: a servo in position
    mode takes speed 0 as its fastest speed."""
    return packet(EVERY_SERVO, SYNC_WRITE, bytes((address, size)) + rows)


def _word(speed: float) -> int:
    """Return a speed as a signed word, truncated towards zero. Zero has no sign."""
    steps = int(speed)
    return steps if steps >= 0 else -steps | _SIGN


def signed(word: int) -> float:
    """Return a signed word as a speed in steps per second."""
    return -float(word & ~_SIGN) if word & _SIGN else float(word)


def _health(data: bytes) -> tuple[float, int]:
    """Return a servo's load as a share of its maximum, and its temperature."""
    word, temperature = _HEALTH.unpack(data)
    return (word & _LOAD_SIGN - 1) / (-1000 if word & _LOAD_SIGN else 1000), temperature


def _written(speeds: Sequence[float]) -> bytes:
    left, rear, right = map(_word, speeds)
    return sync_write(GOAL_SPEED, 2, _SPEEDS.pack(WHEELS[0], left, WHEELS[1], rear, WHEELS[2], right))


def motion(speeds: Sequence[float], limit: float) -> bytes:
    """Return the packet that sets the speeds of all wheels. Raises FrameError if a speed is not within plus or minus
    `limit`."""
    counted("speeds", speeds, len(WHEELS), len(WHEELS))
    number("limit", limit, 0.0, LIMIT, UNIT)
    return _written([number("speed of a wheel", speed, -limit, limit, UNIT) for speed in speeds])


STOP = motion((0.0, 0.0, 0.0), 0.0)
_MOTION_HEAD = STOP[:7]

FILLER = bytes(24)
"""Zeros that complete a packet of this module, or an answer, if it was cut short. They are longer than any missing
part, so a servo never reads the bytes after FILLER as a speed in the cut packet."""
STOPS = 7
BURST = (FILLER + STOP) * STOPS
"""The bytes with which failstop stops the wheels: seven stops, with FILLER before each. If a packet before the burst
was cut short, the servos still receive the first stop. If a servo is sending an answer, the answer garbles the first
stops, but the servos receive the stops after the answer. If a servo has read a garbled length, it takes up to 255 bytes
of the burst for the rest of that packet, and then receives a stop."""

BEFORE_QUESTION = FILLER * 2
"""Zeros that come before each question. A servo that has read a garbled length takes up to 255 bytes for the rest of
that packet, and answers no question meanwhile. Four questions with their zeros, and the zeros before the fifth
question, are more than 255 bytes. So the servo answers the fifth question at the latest."""

TORQUE_ON = sync_write(TORQUE_SWITCH, 1, b"".join(bytes((wheel, 1)) for wheel in WHEELS))
QUESTIONS = tuple(packet(EVERY_SERVO, SYNC_READ, bytes((GOAL_SPEED, size, *WHEELS))) for size in SIZES)


def speeds(frame: bytes) -> tuple[float, ...] | None:
    """Return the speeds of all wheels in a motion frame, in steps per second, or None for other bytes."""
    if len(frame) != len(STOP) or frame[:7] != _MOTION_HEAD or sum(frame[2:]) & 0xFF != 0xFF:
        return None
    fields = _SPEEDS.unpack(frame[7:-1])
    return tuple(map(signed, fields[1::2])) if fields[::2] == WHEELS else None


def check_motion(frame: bytes, limit: float) -> str:
    """Say why these bytes must not be written as a motion packet. Returns "" if they may be written. Never raises,
    whatever the bytes are."""
    found = speeds(frame)
    if found is None:
        return "not a whole packet of the wheels' speeds"
    if _written(found) != frame:
        return "not as this board's motion packets are written"
    return beyond(found, limit, LIMIT)


def _of_the_arm(servo: int, data: bytes) -> list[Sample]:
    """Return the report in an arm servo's answer to one of the questions in READS. Returns an empty list for other
    answers, for example to a write, which has no data."""
    found = [what for what, (_, size) in READS.items() if size == len(data)]
    if not found or servo in WHEELS:
        return []
    (what,) = found
    value = int.from_bytes(data[:2], "little") if what == POSITION else data[0] * (100 if what == SUPPLY else 1)
    # A value of 0 would mean that the servo was not read, except for the torque. So a 0 is reported as 1.
    return [ServoAnswer(servo, what, value if what == TORQUE else max(value, 1))]


class Replies(Reader):
    """Decodes the servos' answers. A question to the wheels counts as answered when the answers of all three have come
    in the order of WHEELS."""

    def __init__(self) -> None:
        self._kept = b""
        self._wheels: list[bytes] = []
        self._health: dict[int, tuple[float, int]] = {}
        self._errors: dict[int, int] = {}
        """The error byte in the newest answer of each servo."""
        self._misses = dict.fromkeys(WHEELS, 0)
        self._last, self._size = len(WHEELS) - 1, 0
        """The place in WHEELS of the wheel that answered last, and the number of data bytes in that answer."""
        self._last_report: dict[int, int] = {}
        """What _wrong() returned for the last Health report."""
        self._answers = 0

    def feed(self, chunk: bytes) -> list[Sample]:
        """Return the samples that these bytes complete."""
        data, at = self._kept + chunk, 0
        found: list[Sample] = []
        while (at := data.find(HEAD, at)) >= 0 and at + 4 <= len(data):
            servo, length = data[at + 2 : at + 4]
            if servo >= EVERY_SERVO or not 2 <= length <= LONGEST_REPLY:
                at += 1
                continue
            end = at + 4 + length
            if end > len(data):
                break
            if sum(data[at + 2 : end]) & 0xFF != 0xFF:
                at += 1
                continue
            found += self._heard(servo, data[at + 4], data[at + 5 : end - 1])
            at = end
        # If no head was found, the last byte may still be the first byte of one.
        self._kept = data[at:] if at >= 0 else data[-1:]
        return found

    def _heard(self, servo: int, error: int, data: bytes) -> list[Sample]:
        wheel = servo in WHEELS and len(data) in SIZES
        if wheel or _of_the_arm(servo, data):
            self._errors[servo] = error & ~SERVO_MISSING
        missed = wheel and self._count_misses(WHEELS.index(servo), len(data))
        found = self._wheel(servo, data) if wheel else _of_the_arm(servo, data)
        if not wheel and len(data) == READS[POSITION][1]:
            self._health[servo] = _health(data[4:])
        due = any(isinstance(sample, Answer) for sample in found) and self._answers % REPORT_EVERY == 1
        # While a wheel's answer is missing, no question counts as answered, so nothing is due. Health is reported
        # anyway.
        if due or missed or self._wrong() != self._last_report:
            self._last_report = self._wrong()
            found.append(Health(self._rows()))
        return found

    def _count_misses(self, at: int, size: int) -> bool:
        """Count the missed answers after the wheel at place `at` of WHEELS has answered with `size` bytes. Wheels
        answer in this order, so each wheel between the previous answer and this one has missed its question. Returns
        True if such a wheel now counts as missing."""
        same = at > self._last and size == self._size
        passed = range(self._last + 1, at) if same else (*range(self._last + 1, len(WHEELS)), *range(at))
        for other in passed:
            self._misses[WHEELS[other]] += 1
        self._misses[WHEELS[at]] = 0
        self._last, self._size = at, size
        return any(self._misses[WHEELS[other]] >= MISSES for other in passed)

    def _wrong(self) -> dict[int, int]:
        """Return what is wrong with each servo that reports an error or is missing."""
        missing = {wheel: SERVO_MISSING for wheel, misses in self._misses.items() if misses >= MISSES}
        return {servo: error for servo, error in self._errors.items() if error} | missing

    def _rows(self) -> tuple[tuple[int, float, int, int], ...]:
        known = {servo: self._health.get(servo, (0.0, 0)) for servo in (*self._health, *self._last_report)}
        return tuple((servo, *told, self._last_report.get(servo, 0)) for servo, told in known.items())

    def _wheel(self, servo: int, data: bytes) -> list[Sample]:
        due = WHEELS[len(self._wheels)]
        if servo != due or any(len(data) != len(other) for other in self._wheels):
            self._wheels = []
        if servo != WHEELS[len(self._wheels)]:
            return []
        self._wheels.append(data)
        if len(self._wheels) < len(WHEELS):
            return []
        goals, now, decivolts = zip(*(_WHEEL.unpack_from(each) for each in self._wheels), strict=True)
        self._health |= {wheel: _health(each[14:18]) for wheel, each in zip(WHEELS, self._wheels, strict=True)}
        self._wheels = []
        found = [Wheels(tuple(map(signed, now)), ()), Obeyed(tuple(map(signed, goals))), Answer(str(len(data)))]
        if self._answers % REPORT_EVERY == 0:
            found.append(Battery(min(decivolts) / 10))
        self._answers += 1
        return found
