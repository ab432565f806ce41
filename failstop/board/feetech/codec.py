"""Packets of Feetech's STS servos: `FF FF | id | length | instruction | data | check`, little-endian.

`length` counts the instruction, the data and the check, which is the inverted sum of everything behind the head. A
servo answers with the same form, its error bits in the place of the instruction (ERRBIT_* of feetech-servo-sdk 1.0.0,
which wire.py has too). Speeds have their sign in bit 15
(Feetech's memory table; feetech-servo-sdk 1.0.0 makes the same bytes).
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
"""Ids of the wheels' servos, as LeKiwi has them: left, rear, right."""
LIMIT = 3000.0
"""The highest speed that LeKiwi commands for a wheel."""
TURN = 4096
"""How many steps make a turn."""
UNIT = "steps a second"
SIZES = (18, 19)
"""How much of each wheel's memory the questions read, beginning at the goal speed. An answer does not say which
question it belongs to, but its length does."""
READS = {TORQUE: (TORQUE_SWITCH, 1), POSITION: (56, 8), SUPPLY: (62, 3), TEMPERATURE: (63, 4)}
"""Address and size of each question to a servo of the arm. Here too the size of the answer shows the question. Load and
temperature follow the position."""
REPORT_EVERY = 10
"""After this many answers of the wheels, the supply and the servos' health are reported: about once a second."""

MISSES = 2
"""If a wheel leaves this many questions in a row unanswered while another one answers, it is missing. The answer of a
single question may be garbled on the line."""

LONGEST_REPLY = 64
_SIGN = 0x8000
_LOAD_SIGN = 0x400
_SPEEDS = Struct("<BHBHBH")
_WHEEL = Struct("<H10xHxxB")
"""A wheel's memory from the goal speed on: the goal speed, the present speed, the supply in 0.1 V."""
_HEALTH = Struct("<HxB")
"""A servo's memory from the load on: the load, the temperature."""


def packet(servo: int, instruction: int, data: bytes) -> bytes:
    """The packet with these parts, without checks."""
    body = bytes((servo, len(data) + 2, instruction)) + data
    return HEAD + body + bytes((~sum(body) & 0xFF,))


def sync_write(address: int, size: int, rows: bytes) -> bytes:
    """The packet that writes at this address of several servos. Each row has the id, then the bytes. No servo answers
    it. List the ids one by one, and never write a speed to all servos at once: for a servo in position mode, speed 0
    means its fastest speed."""
    return packet(EVERY_SERVO, SYNC_WRITE, bytes((address, size)) + rows)


def _word(speed: float) -> int:
    """A speed as a signed word, rounded towards zero; zero has no sign."""
    steps = int(speed)
    return steps if steps >= 0 else -steps | _SIGN


def signed(word: int) -> float:
    """A signed word as a speed in steps per second."""
    return -float(word & ~_SIGN) if word & _SIGN else float(word)


def _health(data: bytes) -> tuple[float, int]:
    """The load as a share of the servo's maximum, and the temperature."""
    word, temperature = _HEALTH.unpack(data)
    return (word & _LOAD_SIGN - 1) / (-1000 if word & _LOAD_SIGN else 1000), temperature


def _written(speeds: Sequence[float]) -> bytes:
    left, rear, right = map(_word, speeds)
    return sync_write(GOAL_SPEED, 2, _SPEEDS.pack(WHEELS[0], left, WHEELS[1], rear, WHEELS[2], right))


def motion(speeds: Sequence[float], limit: float) -> bytes:
    """The packet that sets all wheels, each within plus or minus `limit`. Raises FrameError."""
    counted("speeds", speeds, len(WHEELS), len(WHEELS))
    number("limit", limit, 0.0, LIMIT, UNIT)
    return _written([number("speed of a wheel", speed, -limit, limit, UNIT) for speed in speeds])


STOP = motion((0.0, 0.0, 0.0), 0.0)
_MOTION_HEAD = STOP[:7]

FILLER = bytes(24)
"""Longer than the rest of any packet of this module that was cut, or of an answer. It turns no bytes after it into a
speed."""
STOPS = 7
BURST = (FILLER + STOP) * STOPS
"""After a cut packet a stop is received at once. If it hits an answer, it is received when the answer is over. If a
length was garbled, the servo first waits for up to 255 bytes."""

BEFORE_QUESTION = FILLER * 2
"""A servo that took a garbled length waits through up to 255 bytes and answers nothing meanwhile. With these it answers
the fifth question after the noise at the latest."""

TORQUE_ON = sync_write(TORQUE_SWITCH, 1, b"".join(bytes((wheel, 1)) for wheel in WHEELS))
QUESTIONS = tuple(packet(EVERY_SERVO, SYNC_READ, bytes((GOAL_SPEED, size, *WHEELS))) for size in SIZES)


def speeds(frame: bytes) -> tuple[float, ...] | None:
    """The speeds of all wheels in a motion frame, in steps per second; None if the bytes are not a motion frame."""
    if len(frame) != len(STOP) or frame[:7] != _MOTION_HEAD or sum(frame[2:]) & 0xFF != 0xFF:
        return None
    fields = _SPEEDS.unpack(frame[7:-1])
    return tuple(map(signed, fields[1::2])) if fields[::2] == WHEELS else None


def check_motion(frame: bytes, limit: float) -> str:
    """Why these bytes must not be written as a motion packet; "" when they may. Never raises on bytes."""
    found = speeds(frame)
    if found is None:
        return "not a whole packet of the wheels' speeds"
    if _written(found) != frame:
        return "not as this board's motion packets are written"
    return beyond(found, limit, LIMIT)


def _of_the_arm(servo: int, data: bytes) -> list[Sample]:
    """The answer to one of READS. A write to a single id is answered without data."""
    found = [what for what, (_, size) in READS.items() if size == len(data)]
    if not found or servo in WHEELS:
        return []
    (what,) = found
    value = int.from_bytes(data[:2], "little") if what == POSITION else data[0] * (100 if what == SUPPLY else 1)
    # To who asks, a 0 is no reading, but for the torque: the first pulse is told as the one beside it.
    return [ServoAnswer(servo, what, value if what == TORQUE else max(value, 1))]


class Replies(Reader):
    """Decodes the servos' answers. The wheels' answers count when all three have come, in their order."""

    def __init__(self) -> None:
        self._kept = b""
        self._wheels: list[bytes] = []
        self._health: dict[int, tuple[float, int]] = {}
        self._errors: dict[int, int] = {}
        """The error byte of the newest answer of each servo."""
        self._misses = dict.fromkeys(WHEELS, 0)
        self._last, self._size = len(WHEELS) - 1, 0
        """Which wheel answered last, by its place in WHEELS, and how many bytes."""
        self._last_report: dict[int, int] = {}
        """What was wrong with each servo in the newest report."""
        self._answers = 0

    def feed(self, chunk: bytes) -> list[Sample]:
        """The samples that these bytes complete."""
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
        # Without a head, its first byte may still be the last that came.
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
        # Where a wheel's answer is missing nothing else is reported, and the others are heard all the same.
        if due or missed or self._wrong() != self._last_report:
            self._last_report = self._wrong()
            found.append(Health(self._rows()))
        return found

    def _count_misses(self, at: int, size: int) -> bool:
        """A wheel has answered. The wheels between it and the last one that answered have missed the question, because
        they answer in the order of WHEELS. Returns True if one of these is now missing."""
        same = at > self._last and size == self._size
        passed = range(self._last + 1, at) if same else (*range(self._last + 1, len(WHEELS)), *range(at))
        for other in passed:
            self._misses[WHEELS[other]] += 1
        self._misses[WHEELS[at]] = 0
        self._last, self._size = at, size
        return any(self._misses[WHEELS[other]] >= MISSES for other in passed)

    def _wrong(self) -> dict[int, int]:
        """What is wrong with each servo that reports an error."""
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
