"""Records: the payloads with a fixed shape, each declared once: its values, and how they become bytes and back.

Payloads with a variable shape (state, process table, the stop that people read) are msgpack maps made by their writers.
"""

from __future__ import annotations

import struct
from itertools import islice

from failstop.data import Data

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from typing import Any, Generic

    from typing_extensions import TypeVarTuple, Unpack

    Values = TypeVarTuple("Values")
    Rows = Sequence[tuple[float, Sequence[float]]]

MOTION, WRITE_BURST, OTHER, ARM = range(1, 5)
"""Kinds of frames. MOTION: a motor frame; only the newest counts, and it expires with its epoch and the lease.
WRITE_BURST: the stop burst, now. OTHER: any frame that is not motion, in order. ARM: a frame for the arm's servos, in
order; it expires as motion does."""
ASKED_BYTES = 180
"""How many bytes the reason of a stop request may take, in UTF-8. Together with the asker's name they fit a record."""
WHO_BYTES = 64
FLEET_PREFIX = "fleet:"
"""How the asker's name begins if somebody has stopped the whole fleet and this robot's publisher passed the request
on."""
CAUSE = "{cause}"
"""Stands for the text of the cause in the text of a reply."""
REPLY_BYTES = 290
LEFT_OUT = b" ..."
"""How a reason ends if it was cut."""

NOBODY = 0
"""A session number that no client has."""
SOURCE_BYTES = 16
HELD_BYTES = 200
PATH_BYTES = 300
SAID_BYTES = 190
WIRE_BYTES = 260
"""The longest frame on the wire."""
CAUSE_BYTES = 282
"""The size of a packed cause (failstop/policy/causes.py)."""

PORT_CLOSED, PORT_OPEN, PORT_LOST = range(3)
PORT_STATES = ("closed", "open", "lost")

ENABLE, DISABLE, RESET, ARM_MOVE, ARM_DRIVE, ARM_TUCK, ARM_HOLD, ARM_RELEASE, ARM_READ, LIMIT = range(1, 11)

REFUSED, DONE, UNDER_WAY = range(3)
"""The kinds of replies. After UNDER_WAY another reply follows."""
FOR_THE_LATCH, FOR_AN_INTERLOCK, FOR_THE_WHEELS = 1, 2, 3
"""The reasons of a refusal: a latched stop, whose cause is given; an interlock, whose text is given; or that the wheels
may turn."""
ARM_FOLLOW, ARM_JOG = 1, 2
MOST_JOINTS = 8
MOST_SERVOS = 16
MOST_ROWS = 200
MOST_REPORTED = 4
"""The most wheels of a board that reports the command it obeys."""

PAD_RESET, PAD_FRAME = 1, 2
PLUGGED = ("unknown", "plugged", "unplugged")
PAD_MODES = ("locked", "drive", "joint")


class Tail(Data):
    """The part after the numbers: how its values become bytes and back (ValueError if the bytes don't fit), and how
    many bytes it has at most and at least."""

    pack: Callable[..., bytes]
    unpack: Callable[[bytes], tuple[Any, ...]]
    most: int
    least: int = 0


NOTHING = Tail(bytes, lambda data: (), 0)


class Shape:
    """Numbers in the notation of `struct`, followed by the tail's values. `pack` takes what `unpack` returns. `unpack`
    raises ValueError for bytes of another shape, so that a reader treats them as damage. `most`: the largest size in
    bytes."""

    __slots__ = ("_count", "_numbers", "_tail", "most", "pack")

    def __init__(self, form: str, tail: Tail = NOTHING) -> None:
        self._numbers = struct.Struct(form)
        self._count = len(self._numbers.unpack(bytes(self._numbers.size)))
        self._tail = tail
        self.most = self._numbers.size + tail.most
        self.pack: Callable[..., bytes] = self._numbers.pack if tail is NOTHING else self._pack_with_tail

    @property
    def form(self) -> str:
        """Its numbers in the notation of `struct`."""
        return self._numbers.format

    def _pack_with_tail(self, *values: Any) -> bytes:
        return self._numbers.pack(*values[: self._count]) + self._tail.pack(*values[self._count :])

    def unpack(self, payload: bytes) -> tuple[Any, ...]:
        """The values of these bytes. Raises ValueError."""
        size, tail = self._numbers.size, self._tail
        if not size + tail.least <= len(payload) <= self.most:
            raise ValueError(f"payload of {len(payload)} bytes, {size + tail.least} to {self.most} expected")
        return (*self._numbers.unpack_from(payload), *tail.unpack(payload[size:]))


if TYPE_CHECKING:

    class Payload(Shape, Generic[Unpack[Values]]):
        """A shape with these value types, for the type checker."""

        pack: Callable[[Unpack[Values]], bytes]

        def unpack(self, payload: bytes) -> tuple[Unpack[Values]]: ...

else:
    Payload = Shape


def life(pid: int, block: int) -> int:
    """A word that names a process to watch: its pid, and the block of futexes that it holds."""
    return block << 32 | pid


def unpack_life(word: int) -> tuple[int, int]:
    """Return (pid, block)."""
    return word & 0xFFFFFFFF, word >> 32


def printable(text: str) -> str:
    """Another program's text in a form that is safe to show: unprintable characters become question marks."""
    return "".join(c if c.isprintable() else "?" for c in text)


def asking(words: str, who: str = "", pid: int = 0, row: str = "") -> bytes:
    """The line for the stop pipe: the reason, cut to ASKED_BYTES, the asker's name and pid, separated by tabs. `row`:
    the name of the cause that the reason belongs to, if the client knows one."""
    text, name = (" ".join(given.split()) for given in (words, who))
    kept = cut(text, ASKED_BYTES)
    if len(kept) < len(text.encode("utf-8", "replace")):
        kept = cut(text, ASKED_BYTES - len(LEFT_OUT)) + LEFT_OUT
    sender = b"\t%s\t%d" % (cut(name, WHO_BYTES), pid) if name else b""
    return kept + sender + (b"\t" + row.encode() if sender and row else b"") + b"\n"


def cut(text: str, room: int) -> bytes:
    """A text in at most `room` bytes of UTF-8. It is cut between characters."""
    return text.encode("utf-8", "replace")[:room].decode("utf-8", "ignore").encode()


def _whole(text: str, room: int) -> bytes:
    data = text.encode("utf-8", "replace")
    if len(data) > room:
        raise ValueError(f"{text!r} is longer than {room} bytes")
    return data


def rest(most: int) -> Tail:
    return Tail(bytes, lambda data: (data,), most)


def _text(room: int) -> Tail:
    """A text, cut to `room` bytes."""
    return Tail(lambda text: cut(text, room), lambda data: (data.decode("utf-8", "replace"),), room)


def _pack_lines(*texts: str) -> bytes:
    return b"\n".join(cut(text, SAID_BYTES).replace(b"\n", b" ") for text in texts)


def _unpack_lines(data: bytes) -> tuple[str, str]:
    first, _, second = data.decode("utf-8", "replace").partition("\n")
    return first, second.replace("\n", " ")


def _unpack_names(data: bytes) -> tuple[list[str]]:
    return (data.decode("utf-8", "replace").split("\n") if data else [],)


def _pack_reply(text: str, cause: bytes) -> bytes:
    said = cut(text, REPLY_BYTES)
    return _LENGTH.pack(len(said)) + said + cause


def _unpack_reply(data: bytes) -> tuple[str, bytes]:
    end = _LENGTH.size + _LENGTH.unpack_from(data)[0]
    return data[_LENGTH.size : end].decode("utf-8", "replace"), data[end:]


def _pack_goal(values: dict[int, float]) -> bytes:
    if not 0 < len(values) <= MOST_JOINTS:
        raise ValueError(f"{len(values)} joints, must be 1 to {MOST_JOINTS}")
    return bytes((len(values),)) + b"".join(map(_VALUE.pack, values, values.values()))


def _unpack_goal(data: bytes) -> tuple[dict[int, float]]:
    if not data or not 0 < data[0] <= MOST_JOINTS or len(data) != 1 + data[0] * _VALUE.size:
        raise ValueError(f"a goal of joints in {len(data)} bytes")
    return ({int(servo): value for servo, value in _VALUE.iter_unpack(data[1:])},)


def _pack_rows(servos: list[int], rows: Rows) -> bytes:
    if not 0 < len(servos) <= MOST_JOINTS or not 0 < len(rows) <= MOST_ROWS:
        raise ValueError(f"{len(servos)} joints and {len(rows)} points: at most {MOST_JOINTS} and {MOST_ROWS} fit")
    form = struct.Struct(f"<d{len(servos)}f")
    head = _COUNTS.pack(len(servos), len(rows)) + bytes(servos)
    return head + b"".join(form.pack(t_s, *values) for t_s, values in rows)


def _unpack_rows(data: bytes) -> tuple[list[int], Rows]:
    count, length = _COUNTS.unpack_from(data) if len(data) >= _COUNTS.size else (0, 0)
    form = struct.Struct(f"<d{count}f")
    start = _COUNTS.size + count
    if not 0 < count <= MOST_JOINTS or len(data) != start + length * form.size:
        raise ValueError(f"a trajectory of {count} joints and {length} points in {len(data)} bytes")
    rows = [(row[0], tuple(row[1:])) for row in form.iter_unpack(data[start:])]
    return list(data[_COUNTS.size : start]), rows


def _pack_answer(value: int | None) -> bytes:
    return _ANSWER.pack(value is not None, value or 0)


def _unpack_answer(data: bytes) -> tuple[int | None]:
    answered, value = _ANSWER.unpack(data)
    return (value if answered else None,)


def _pack_health(*rows: tuple[int, float, int, int]) -> bytes:
    packed = (_SERVO_HEALTH.pack(servo, round(100 * load), at_c, wrong) for servo, load, at_c, wrong in rows)
    return b"".join(islice(packed, MOST_SERVOS))


def _unpack_health(data: bytes) -> tuple[tuple[int, float, int, int], ...]:
    if len(data) % _SERVO_HEALTH.size:
        raise ValueError(f"servos in {len(data)} bytes")
    return tuple((servo, percent / 100, *rest) for servo, percent, *rest in _SERVO_HEALTH.iter_unpack(data))


def _unpack_doubles(data: bytes) -> tuple[tuple[float, ...]]:
    if len(data) % _DOUBLE.size:
        raise ValueError(f"numbers in {len(data)} bytes")
    return (tuple([number for (number,) in _DOUBLE.iter_unpack(data)]),)


_SERVO_HEALTH = struct.Struct("<BbBB")
_LENGTH = struct.Struct("<H")
_ANSWER = struct.Struct("<?i")
_VALUE = struct.Struct("<Bd")
_COUNTS = struct.Struct("<BH")
_DOUBLE = struct.Struct("<d")

FRAME: Payload[int, int, bytes] = Payload("<QB", rest(WIRE_BYTES))
"""An entry of the gate's ring: epoch, kind, body. MOTION and OTHER carry a frame for the wire, WRITE_BURST nothing."""
WROTE: Payload[int, tuple[float, ...]] = Payload(
    "<B",
    Tail(
        lambda speeds: b"".join(map(_DOUBLE.pack, speeds)),
        _unpack_doubles,
        MOST_REPORTED * _DOUBLE.size,
    ),
)
"""Something written that the board answers or echoes: the index of a ping; or COMMANDED (failstop/board/handled.py) and
the speeds that the board will report."""
PROVED: Payload[int, int] = Payload("<QQ")
"""The board has handled everything that was written until the first time; it reported that at the second time (ns)."""
STOPPED: Payload[int, int, int, bytes] = Payload("<QQQ", rest(CAUSE_BYTES))
"""A stop: its epoch, when it was noticed, when its burst was handed to the kernel (0: it was not), and its cause,
packed."""
LATCH: Payload[int, int, int, bytes] = Payload("<QQQ", rest(CAUSE_BYTES))
"""The latch: the epoch raised for the latched stop (0: nothing is latched), when that stop was noticed, when the epoch
was last raised, and the latched cause, packed; if nothing is latched, the last stop's cause."""
PORT: Payload[int, int, int, str] = Payload("<QQB", _text(PATH_BYTES))
"""The port: its number in this run, since when it is in this state (ns), PORT_OPEN or another state, and its path."""
COMMAND: Payload[int, float, float, float, bool, str] = Payload(
    "<Q3d?",
    Tail(
        lambda source: _whole(source, SOURCE_BYTES).ljust(SOURCE_BYTES, b"\0"),
        lambda data: (data.rstrip(b"\0").decode("ascii", "replace"),),
        SOURCE_BYTES,
        least=SOURCE_BYTES,
    ),
)
"""A velocity command of the client session that wrote it: vx (m/s forward), vy (m/s left), wz (rad/s
counter-clockwise), whether a person drives, and the source. The source is never cut, because a cut name could be
another source."""
ASSERTED: Payload[int, list[str]] = Payload(
    "<Q", Tail(lambda names: _whole("\n".join(names), HELD_BYTES), _unpack_names, HELD_BYTES)
)
"""What a client session asserts: names of interlocks, never cut; or no names, for "the sensor delivered"."""
SAID: Payload[int, str, str] = Payload("<Q", Tail(_pack_lines, _unpack_lines, 2 * SAID_BYTES + 1))
"""A client's report about itself: what it sees, and what is wrong (may be empty)."""
HELLO: Payload[int, int, int, str] = Payload("<QIQ", _text(64))
"""The holder of a client slot: a random session number, its pid, its pid namespace, its name."""
GOODBYES = 64
LEFT = Shape(f"<{GOODBYES}Q")
"""The sessions that have left a client slot, the last one first, because many may come and go between two looks of the
gate."""


def goodbye(session: int, before: bytes) -> bytes:
    """The goodbye of a session, put before the earlier ones."""
    try:
        earlier = LEFT.unpack(before)
    except ValueError:
        earlier = (0,) * GOODBYES
    return LEFT.pack(session, *earlier[:-1])


ANSWER_WITHIN_NS = 1_000_000_000
"""How long a client waits for the answer to a request, unless it sets another time (Robot, `answer_s`)."""
REQUEST: Payload[int, int, int] = Payload("<QQB")
"""A client session's request: its number, which the reply repeats, and its verb, ENABLE or another."""
AUX: Payload[int, bytes] = Payload("<Q", rest(WIRE_BYTES))
"""A client's frame for the wire that is not motion: one of the board's questions, or a frame that the board's
check_aux() allows."""
SPEED_LIMIT: Payload[int, int] = Payload("<QB")
"""The speed limit of a session's request, in percent of the settings' speeds."""
SEEN: Payload[int, int] = Payload("<QQ")
"""The newest epoch that the person who asks for a reset has seen; 0: that is not known."""
REPLY: Payload[int, int, int, int, str, bytes] = Payload(
    "<QQBB", Tail(_pack_reply, _unpack_reply, _LENGTH.size + REPLY_BYTES + CAUSE_BYTES, least=_LENGTH.size)
)
"""The reply to a session's request: its number; DONE, REFUSED or UNDER_WAY; FOR_THE_LATCH, FOR_AN_INTERLOCK,
FOR_THE_WHEELS or 0 (refused for another reason, or not refused); the text; and the packed cause that CAUSE in the text
stands for."""
ARM_GOAL: Payload[int, int, dict[int, float]] = Payload(
    "<QB", Tail(_pack_goal, _unpack_goal, 1 + MOST_JOINTS * _VALUE.size)
)
"""A session's goal for the arm, renewed again and again: ARM_FOLLOW with the angle (rad) of each servo's joint, or
ARM_JOG with its rate (rad/s)."""
ARM_PATH: Payload[int, float, list[int], Rows] = Payload(
    "<Qd", Tail(_pack_rows, _unpack_rows, _COUNTS.size + MOST_JOINTS + MOST_ROWS * (8 + 4 * MOST_JOINTS))
)
"""A session's trajectory: the share of the joints' speeds it may use, the servos (MOST_JOINTS at most), and the rows
(MOST_ROWS at most), each with a time (s; 0 in the first row: as fast as allowed) and the angles (rad) of these servos'
joints."""
OF_SESSION: dict[str, Shape] = {
    "command": COMMAND,
    "sensed": ASSERTED,  # its time is that of the obstacle sensor's last delivery
    "interlocks": ASSERTED,  # the conditions that this client says hold, at its time
    "attended": ASSERTED,  # the operator who was present at its time; 0: that operator has left
    "request": REQUEST,
    "speed_limit": SPEED_LIMIT,  # the limit that a request is about
    "seen": SEEN,  # the newest stop known to the person who asks for a reset
    "said": SAID,  # one line: what the client sees and what is wrong
    "arm_goal": ARM_GOAL,  # follow or jog, renewed
    "arm_path": ARM_PATH,  # the trajectory that a request is about
    "aux": AUX,  # a frame for the wire that is not motion
}
"""The records that a client writes into its slot after its hello. Each begins with its session."""
SERVO: Payload[int, int, int | None] = Payload("<BB", Tail(_pack_answer, _unpack_answer, _ANSWER.size, _ANSWER.size))
"""A bus servo's answer: the servo, the question (board/servos.py), and the value; None: it did not answer."""
IMU: Payload[float, float, float, float, float, float] = Payload("<6d")
"""A sample of the IMU: acceleration (m/s2), then turn rate (rad/s), each x forward, y left, z up."""
RATE_VARIANCE = 0.0012**2
"""The variance that is published with a turn rate, (rad/s)^2. At rest the gyro's standard deviation is 0.0007 to 0.0011
rad/s (measured)."""
BIAS: Payload[float, float, float, bool, bool] = Payload("<3d??")
"""The gyro's bias (rad/s on x, y, z), whether it follows the reading now, whether a calibration ever found it."""
ODOMETRY_FROM = ("commands", "wheels")
BY_COMMANDS, BY_ROLLING = range(len(ODOMETRY_FROM))
ODOMETRY = Shape("<8dB6d")
"""Pose: x m, y m, th rad since the start; twist in the robot's frame: vx m/s, vy m/s, wz rad/s; the twist's standard
deviation: m/s for vx and vy, rad/s for wz; the source of both, an index of ODOMETRY_FROM; the covariance of the pose:
xx, xy, x th, yy, y th, th th. Its time is that of the wheels' newest report, or now if it comes from commands."""
POSE_VARIANCE = 1e3
"""The variance that is published with a pose from commands, m^2 for x and y, rad^2 for th. It is huge, because dead
reckoning can't be trusted."""
MOST_WHEELS = 4
WHEELS_DO = ("unknown", "still", "turning")
WHEELS_BY = ("", "IMU", "wheels")
WHEELS_SEEN = Shape(f"<BB?BQQ{MOST_WHEELS}d{MOST_WHEELS}d")
"""What is known about the wheels: an index of WHEELS_DO, and of WHEELS_BY (the observer); whether they turn although
they were told zero for longer than still.after_s; how many wheels are reported; since when it is so, and the newest
reading (both ns, 0: never); then the measured speed of each wheel in turns per second, by wire id, and how far each has
turned (NaN: not reported)."""
OLD_READING_NS = 500_000_000
"""A reading of the wheels that is older than this says nothing about now."""
BATTERY: Payload[int, int] = Payload("<IB")
"""The battery's voltage in mV, and whether the charger is plugged in: an index of PLUGGED."""
HEALTH = Shape("<", Tail(_pack_health, _unpack_health, MOST_SERVOS * _SERVO_HEALTH.size))
"""What servos report about themselves: the id, load (-1 to 1, sent in percent), temperature (degrees Celsius; 0: not
reported yet) and errors of each."""
PAD: Payload[int, int, int, int, int, int, int] = Payload("<HB4bB")
"""The gamepad's last frame: a bit per button, the hat, axes lx, ly, rx, ry from -128 to 127; an index of PAD_MODES."""
PAD_COMMAND: Payload[float, float, float] = Payload("<3d")
"""The velocity commanded by the gamepad's sticks: vx (m/s forward), vy (m/s left), wz (rad/s counter-clockwise)."""
PAD_ARM: Payload[int, float] = Payload("<Bd")
"""The gamepad's command for the arm: a joint, by its place in the settings, and a share of its speed, -1 to 1."""
PAD_REQUEST: Payload[int, bytes] = Payload("<B", rest(WIRE_BYTES))
"""A request of telemetry to the gate: PAD_RESET, or PAD_FRAME with a frame for the wire that is not motion."""


def port_state(entry: tuple[int, int, bytes] | None, number: int) -> int:
    """The state of the port with this number, from the port owner's record; PORT_CLOSED if the record is about another
    port."""
    if entry is None:
        return PORT_CLOSED
    told, _, state, _ = PORT.unpack(entry[2])
    return state if told == number else PORT_CLOSED
