"""Records: declares each payload in shared memory that has a fixed shape, with its values, and converts it to bytes and
back.

Payloads with a variable shape, such as the gate's state and the process table, are msgpack. The process that writes
such a payload also defines it.
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

MOTION, WRITE_BURST, OTHER, ARM, DROP_ARM = range(1, 6)
"""Kinds of frames from the gate. MOTION is a motor frame. If several motor frames wait, only the newest one is sent.
WRITE_BURST tells the port owner to write the stop burst now. OTHER is any frame that doesn't move anything. ARM is a
frame for the arm's servos. All waiting OTHER and ARM frames are sent, in order. DROP_ARM tells the port owner to drop
the waiting ARM frames. The port owner refuses a MOTION or ARM frame if the frame is from before the last stop (its
epoch is over), or if the gate has been silent for longer than its lease."""
ASKED_BYTES = 180
"""The longest reason of a stop request, in bytes of UTF-8. It is limited so that the reason and the name of the program
that asks fit into one record."""
WHO_BYTES = 64
FLEET_PREFIX = "fleet:"
"""If somebody stops the whole fleet, the fleet publisher on each robot requests a stop under the name of that person,
with this text before the name."""
CAUSE = "{cause}"
"""The placeholder for the text of the cause in the text of a reply."""
REPLY_BYTES = 290
LEFT_OUT = b" ..."
"""The end of a reason that was too long and was cut."""

NOBODY = 0
"""A session number that no client ever has."""
SOURCE_BYTES = 16
HELD_BYTES = 200
PATH_BYTES = 300
SAID_BYTES = 190
WIRE_BYTES = 260
"""The longest frame that can be written to the board, in bytes."""
CAUSE_BYTES = 282
"""The most bytes that a packed cause has (failstop/policy/causes.py)."""

PORT_CLOSED, PORT_OPEN, PORT_LOST = range(3)
PORT_STATES = ("closed", "open", "lost")

ENABLE, DISABLE, RESET, ARM_MOVE, ARM_DRIVE, ARM_TUCK, ARM_HOLD, ARM_RELEASE, ARM_READ, LIMIT = range(1, 11)

REFUSED, DONE, UNDER_WAY = range(3)
"""The kinds of replies to a request. UNDER_WAY is not the last reply, so the client waits for the next one."""
FOR_THE_LATCH, FOR_AN_INTERLOCK, FOR_THE_WHEELS = 1, 2, 3
"""Why a request was refused. FOR_THE_LATCH: a stop is latched; the reply has its cause. FOR_AN_INTERLOCK: an interlock
does not hold; the reply has its text. FOR_THE_WHEELS: the wheels may turn."""
ARM_FOLLOW, ARM_JOG = 1, 2
MOST_JOINTS = 8
MOST_SERVOS = 16
MOST_ROWS = 200
MOST_REPORTED = 4
"""The most wheels that a board can have if it reports which command it obeys."""

PAD_RESET, PAD_FRAME = 1, 2
PLUGGED = ("unknown", "plugged", "unplugged")
PAD_MODES = ("locked", "drive", "joint")


class Tail(Data):
    """The part of a payload that comes after its fixed numbers. `pack` turns the values into bytes. `unpack` turns
    bytes into the values, and raises ValueError if the bytes don't have this form. `most` and `least` say how many
    bytes the part can have."""

    pack: Callable[..., bytes]
    unpack: Callable[[bytes], tuple[Any, ...]]
    most: int
    least: int = 0


NOTHING = Tail(bytes, lambda data: (), 0)


class Shape:
    """The shape of a payload: fixed numbers in the notation of `struct`, and then a tail of variable length. `pack` and
    `unpack` use the same values in the same order. `unpack` raises ValueError for bytes of another shape. `most`: the
    largest size in bytes."""

    __slots__ = ("_count", "_numbers", "_tail", "most", "pack")

    def __init__(self, form: str, tail: Tail = NOTHING) -> None:
        self._numbers = struct.Struct(form)
        self._count = len(self._numbers.unpack(bytes(self._numbers.size)))
        self._tail = tail
        self.most = self._numbers.size + tail.most
        self.pack: Callable[..., bytes] = self._numbers.pack if tail is NOTHING else self._pack_with_tail

    @property
    def form(self) -> str:
        """The `struct` format of the fields that have a fixed size."""
        return self._numbers.format

    def _pack_with_tail(self, *values: Any) -> bytes:
        return self._numbers.pack(*values[: self._count]) + self._tail.pack(*values[self._count :])

    def unpack(self, payload: bytes) -> tuple[Any, ...]:
        """Return the values in these bytes. Raises ValueError if the bytes don't have this shape."""
        size, tail = self._numbers.size, self._tail
        if not size + tail.least <= len(payload) <= self.most:
            raise ValueError(f"payload of {len(payload)} bytes, {size + tail.least} to {self.most} expected")
        return (*self._numbers.unpack_from(payload), *tail.unpack(payload[size:]))


if TYPE_CHECKING:

    class Payload(Shape, Generic[Unpack[Values]]):
        """A Shape whose values have these types. Only the type checker uses it."""

        pack: Callable[[Unpack[Values]], bytes]

        def unpack(self, payload: bytes) -> tuple[Unpack[Values]]: ...

else:
    Payload = Shape


def life(pid: int, block: int) -> int:
    """Combine a process's pid and the number of its block of futexes into one word. Other processes need both numbers
    to notice the death of the process."""
    return block << 32 | pid


def unpack_life(word: int) -> tuple[int, int]:
    """Return (pid, block) of a word that life() has made."""
    return word & 0xFFFFFFFF, word >> 32


def printable(text: str) -> str:
    """Another program's text, with unprintable characters replaced by question marks, so that it is safe to show."""
    return "".join(c if c.isprintable() else "?" for c in text)


def asking(words: str, who: str = "", pid: int = 0, row: str = "") -> bytes:
    """Make the line that requests a stop through the stop pipe: the reason, cut to ASKED_BYTES, then the requester's
    name and pid, and `row`, separated by tabs. `row`: the name of the cause, if the program knows it. Without `who`,
    the line has only the reason."""
    text, name = (" ".join(given.split()) for given in (words, who))
    kept = cut(text, ASKED_BYTES)
    if len(kept) < len(text.encode("utf-8", "replace")):
        kept = cut(text, ASKED_BYTES - len(LEFT_OUT)) + LEFT_OUT
    sender = b"\t%s\t%d" % (cut(name, WHO_BYTES), pid) if name else b""
    return kept + sender + (b"\t" + row.encode() if sender and row else b"") + b"\n"


def cut(text: str, room: int) -> bytes:
    """Return a text as at most `room` bytes of UTF-8. A longer text is cut between two characters."""
    return text.encode("utf-8", "replace")[:room].decode("utf-8", "ignore").encode()


def _whole(text: str, room: int) -> bytes:
    data = text.encode("utf-8", "replace")
    if len(data) > room:
        raise ValueError(f"{text!r} is longer than {room} bytes")
    return data


def rest(most: int) -> Tail:
    return Tail(bytes, lambda data: (data,), most)


def _text(room: int) -> Tail:
    """A tail with one text, which is cut to `room` bytes."""
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
"""A frame in the gate's ring: epoch, kind, bytes. MOTION, OTHER and ARM contain a frame for the board; WRITE_BURST
and DROP_ARM contain nothing."""
WROTE: Payload[int, tuple[float, ...]] = Payload(
    "<B",
    Tail(
        lambda speeds: b"".join(map(_DOUBLE.pack, speeds)),
        _unpack_doubles,
        MOST_REPORTED * _DOUBLE.size,
    ),
)
"""Says what the port owner has just written to the board, if the board will answer or echo it. The values are an index
and speeds. For a ping, the index is the number of the ping, and there are no speeds. For a motion frame, the index is
COMMANDED (failstop/board/handled.py), and the speeds are those that the board will report."""
PROVED: Payload[int, int] = Payload("<QQ")
"""Proof that the board has handled everything that was written up to a certain time. The values are that time, and the
time at which the proof (an answer or a report of the board) arrived, both in ns."""
STOPPED: Payload[int, int, int, bytes] = Payload("<QQQ", rest(CAUSE_BYTES))
"""A stop: (epoch, when the cause was noticed, when the stop burst was passed to the kernel, packed cause). Times are in
ns. The third value is 0 if the burst could not be passed."""
LATCH: Payload[int, int, int, bytes] = Payload("<QQQ", rest(CAUSE_BYTES))
"""The latch: (epoch of the latched stop, when its cause was noticed, when the epoch was last raised, packed cause).
Times are in ns. If no stop is latched, the epoch is 0 and the cause is that of the last stop."""
PORT: Payload[int, int, int, str] = Payload("<QQB", _text(PATH_BYTES))
"""The board's port: (the port's number in this run, when its state began in ns, its state such as PORT_OPEN, its
path)."""
BY_HAND, STANDS_IN, GUARDED = 1, 2, 4
"""Flags of a velocity command. BY_HAND: a person drives. STANDS_IN: the velocity is zero in place of a motion that the
program wanted, and that was refused or withheld. So the program has not let go. GUARDED: it is from a driver at the
guard port. The guard repeats the driver's motion until it is as old as guard.timeout_s, so the time of the command says
when the motion expires, but not when the driver wrote it."""
COMMAND: Payload[int, float, float, float, int, str] = Payload(
    "<Q3dB",
    Tail(
        lambda source: _whole(source, SOURCE_BYTES).ljust(SOURCE_BYTES, b"\0"),
        lambda data: (data.rstrip(b"\0").decode("ascii", "replace"),),
        SOURCE_BYTES,
        least=SOURCE_BYTES,
    ),
)
"""A velocity command: the client's session, vx (m/s forward), vy (m/s left), wz (rad/s counter-clockwise), its flags,
and the source. The name of the source is never cut, because a shorter name could be another source."""
ASSERTED: Payload[int, list[str]] = Payload(
    "<Q", Tail(lambda names: _whole("\n".join(names), HELD_BYTES), _unpack_names, HELD_BYTES)
)
"""What a client asserts. The values are the client's session, and a list of names. In the record `interlocks`, the
names are the interlocks that hold. In `attended`, the name is the operator who is present. `sensed` has no names: it
asserts that the obstacle sensor has delivered a reading. A name is never cut."""
SAID: Payload[int, str, str] = Payload("<Q", Tail(_pack_lines, _unpack_lines, 2 * SAID_BYTES + 1))
"""What a client reports with say(). The values are the client's session, what the client sees, and what is wrong (may
be empty)."""
HELLO: Payload[int, int, int, str] = Payload("<QIQ", _text(64))
"""Which client holds a slot. The values are the client's random session number, pid, pid namespace and name."""
GOODBYES = 64
LEFT = Shape(f"<{GOODBYES}Q")
"""The newest sessions that have left a client slot (GOODBYES of them), the newest first. One would not be enough,
because many clients may come and go before the gate reads this record again."""


def goodbye(session: int, before: bytes) -> bytes:
    """Make the LEFT record of a client that leaves: its session, then the sessions of the old record `before`."""
    try:
        earlier = LEFT.unpack(before)
    except ValueError:
        earlier = (0,) * GOODBYES
    return LEFT.pack(session, *earlier[:-1])


ANSWER_WITHIN_NS = 1_000_000_000
"""How long a client waits for the answer to a request, in ns, unless the program chooses another time (`answer_s` of
Robot)."""
REQUEST: Payload[int, int, int] = Payload("<QQB")
"""A client's request. The values are the client's session; the number of the request, which the reply repeats; and what
the client asks for, such as ENABLE."""
AUX: Payload[int, bytes] = Payload("<Q", rest(WIRE_BYTES))
"""A client's frame for the board that moves nothing, such as a question. The values are the client's session and the
frame, which check_aux() of the board must allow."""
SPEED_LIMIT: Payload[int, int] = Payload("<QB")
"""The speed limit that a client asks for. The values are the client's session, and the limit in percent of the speeds
in the settings."""
SEEN: Payload[int, int] = Payload("<QQ")
"""A client's session, and the newest epoch that the person who asks for a reset has seen (0 if that is not known)."""
REPLY: Payload[int, int, int, int, str, bytes] = Payload(
    "<QQBB", Tail(_pack_reply, _unpack_reply, _LENGTH.size + REPLY_BYTES + CAUSE_BYTES, least=_LENGTH.size)
)
"""The reply to a client's request. Its values are the client's session; the number of the request; the kind of reply
(DONE, REFUSED or UNDER_WAY); the reason for a refusal (FOR_THE_LATCH, FOR_AN_INTERLOCK or FOR_THE_WHEELS; otherwise 0);
the text of the reply; and a packed cause. The text of the cause replaces the placeholder CAUSE in the text of the
reply."""
ARM_GOAL: Payload[int, int, dict[int, float]] = Payload(
    "<QB", Tail(_pack_goal, _unpack_goal, 1 + MOST_JOINTS * _VALUE.size)
)
"""What a client wants the arm to do at present. The client must write this record again and again. Its values are the
client's session, the mode (ARM_FOLLOW or ARM_JOG), and a number for each servo. With ARM_FOLLOW, the number is the
angle of the servo's joint (rad). With ARM_JOG, it is the rate of the servo's joint (rad/s)."""
ARM_PATH: Payload[int, float, list[int], Rows] = Payload(
    "<Qd", Tail(_pack_rows, _unpack_rows, _COUNTS.size + MOST_JOINTS + MOST_ROWS * (8 + 4 * MOST_JOINTS))
)
"""A client's trajectory for the arm: its session, the share of the joints' highest speeds that the trajectory may use,
the servos (at most MOST_JOINTS), and the rows (at most MOST_ROWS). Each row has a time (s) and the angles of these
servos' joints (rad). If the time in the first row is 0, the arm moves to that row's
angles as fast as allowed."""
OF_SESSION: dict[str, Shape] = {
    "command": COMMAND,
    "sensed": ASSERTED,  # written when the obstacle sensor has delivered; the time is the reading's
    "interlocks": ASSERTED,  # the interlocks that held at the time of the record
    "attended": ASSERTED,  # the operator present at the time of the record; time 0: the operator has left
    "request": REQUEST,
    "speed_limit": SPEED_LIMIT,  # the limit that a request asks for
    "seen": SEEN,  # the newest stop that the person who asks for a reset has seen
    "said": SAID,  # what the client sees, and what is wrong
    "arm_goal": ARM_GOAL,  # follow or jog, repeated again and again
    "arm_path": ARM_PATH,  # the trajectory that a request asks for
    "aux": AUX,  # a frame for the board that moves nothing
}
"""The records that a client writes into its slot after HELLO. The first value of each is the client's session."""
SERVO: Payload[int, int, int | None] = Payload("<BB", Tail(_pack_answer, _unpack_answer, _ANSWER.size, _ANSWER.size))
"""A bus servo's answer. Its values are the servo, the question (board/servos.py), and the number that the servo sent
(None if it did not answer)."""
IMU: Payload[float, float, float, float, float, float] = Payload("<6d")
"""A sample of the IMU: acceleration (m/s2) and then turn rate (rad/s), each x forward, y left, z up."""
RATE_VARIANCE = 0.0012**2
"""The variance that is published with a turn rate, (rad/s)^2. Measured at rest, the gyro's standard deviation is 0.0007
to 0.0011 rad/s."""
BIAS: Payload[float, float, float, bool, bool] = Payload("<3d??")
"""The gyro's bias (rad/s on x, y, z); True if the bias is being updated from the readings at present; and True if the
bias was found by a calibration."""
ODOMETRY_FROM = ("commands", "wheels")
BY_COMMANDS, BY_ROLLING = range(len(ODOMETRY_FROM))
ODOMETRY = Shape("<8dB6d")
"""The robot's pose since the start: x m, y m, th rad. Then its velocity in its own frame: vx m/s, vy m/s, wz rad/s.
Then the standard deviation of the velocity: m/s for vx and vy, rad/s for wz. Then where the pose and the velocity come
from, as an index of ODOMETRY_FROM. Last the covariance of the pose: xx, xy, x th, yy, y th, th th.

If the pose comes from the wheels, the record's time is the time of the board's last report about them. If the pose
comes from commands, the record's time is the time at which the record was written.
"""
POSE_VARIANCE = 1e3
"""The variance that is published with a pose that comes from commands: m^2 for x and y, rad^2 for th. It is huge,
because such a pose can't be trusted."""
MOST_WHEELS = 4
WHEELS_DO = ("unknown", "still", "turning")
WHEELS_BY = ("", "IMU", "wheels")
WHEELS_SEEN = Shape(f"<BB?BQQ{MOST_WHEELS}d{MOST_WHEELS}d")
"""What is known about the wheels. The values are: what the wheels do (an index of WHEELS_DO); what has observed them
(an index of WHEELS_BY); True if the wheels still turn although zero was commanded longer ago than the setting
still.after_s; how many wheels the board reports about; since when the wheels have been still or turning (ns; 0: not
known); the time of the newest reading (ns; 0: there was none); the measured speed of each wheel in turns per second;
and how many turns each wheel has made. Speeds and turns are by wire id (NaN: not reported)."""
OLD_READING_NS = 500_000_000
"""A reading of the wheels that is older than this, in ns, says nothing about the present."""
BATTERY: Payload[int, int] = Payload("<IB")
"""The battery's voltage in mV, and an index of PLUGGED, which says if a charger is plugged in."""
HEALTH = Shape("<", Tail(_pack_health, _unpack_health, MOST_SERVOS * _SERVO_HEALTH.size))
"""What the servos report about themselves. For each servo: its id, its load (-1 to 1, stored in percent), its
temperature (degrees Celsius; 0 if not reported yet) and its errors."""
PAD: Payload[int, int, int, int, int, int, int] = Payload("<HB4bB")
"""The newest frame of the gamepad: the buttons (one bit per button), the hat, the axes lx, ly, rx, ry from -128 to 127,
and an index of PAD_MODES."""
PAD_COMMAND: Payload[float, float, float] = Payload("<3d")
"""The velocity that the gamepad's sticks command: vx (m/s forward), vy (m/s left), wz (rad/s counter-clockwise)."""
PAD_ARM: Payload[int, float] = Payload("<Bd")
"""The gamepad's command for the arm: the index of a joint in the settings, and the share of its speed, -1 to 1."""
PAD_REQUEST: Payload[int, bytes] = Payload("<B", rest(WIRE_BYTES))
"""A request of the gamepad, which telemetry passes to the gate. The request is either PAD_RESET, or PAD_FRAME followed
by a frame for the board. The frame moves nothing."""


def port_state(entry: tuple[int, int, bytes] | None, number: int) -> int:
    """The state of the port `number`, such as PORT_OPEN, from the port owner's PORT record `entry`. PORT_CLOSED if
    there is no record, or if it is about another port."""
    if entry is None:
        return PORT_CLOSED
    told, _, state, _ = PORT.unpack(entry[2])
    return state if told == number else PORT_CLOSED
