"""Records: the payloads of fixed shape, packed and unpacked in one place.

Every unpack function raises ValueError on a payload of the wrong shape, so that a reader treats it as damage.
Payloads of variable shape (state, process table, the stop that people read) are msgpack maps made by their writers.
"""

from __future__ import annotations

import struct

MOTION = 1
"""Frame kind: a motor frame; the newest wins and it dies with its epoch and the lease."""
STOP = 2
"""Frame kind: write the stop burst now (latched or not)."""
OTHER = 3
"""Frame kind: a frame that is not motion (buzzer, LEDs), in order."""
ARM = 4
"""Frame kind: a frame for the arm's servos, in order; it dies with its epoch and the lease as motion does."""
ASKED_BYTES = 180
"""Of the words in which a client asks for a stop, in UTF-8: with who asks they fit a record."""
WHO_BYTES = 64
CAUSE = "{cause}"
"""In the text of a reply: the place of the cause's own."""
REPLY_BYTES = 290
LEFT_OUT = b" ..."
"""What such words end with where they were cut."""

_FRAME = struct.Struct("<QB")
_STOP = struct.Struct("<QQQ")
_LATCH = struct.Struct("<QQQ")
_PORT = struct.Struct("<QQB")
_COMMAND = struct.Struct("<QdddB16s")
_SESSION = struct.Struct("<Q")
_HELLO = struct.Struct("<QIQ")
_REQUEST = struct.Struct("<QQB")
_REPLY = struct.Struct("<QQBH")
_IMU = struct.Struct("<6d")
_PAD = struct.Struct("<HB4bB")
_BATTERY = struct.Struct("<IB")
_BIAS = struct.Struct("<3dBB")
_ODOMETRY = struct.Struct("<8d")
_PAD_COMMAND = struct.Struct("<3d")
_WISH = struct.Struct("<B")
_ARM_GOAL = struct.Struct("<QBB")
_ARM_VALUE = struct.Struct("<Bd")
_ARM_PATH = struct.Struct("<QdBH")
_SERVO = struct.Struct("<BBBi")
_PAD_ARM = struct.Struct("<Bd")

NOBODY = 0
"""No client's session. In a whole hello: who held the slot has left it in order."""
SOURCE_BYTES = 16
HELD_BYTES = 200
PATH_BYTES = 300

PORT_CLOSED = 0
PORT_OPEN = 1
PORT_LOST = 2
PORT_STATES = ("closed", "open", "lost")

ENABLE = 1
DISABLE = 2
RESET = 3
ARM_MOVE = 4
ARM_DRIVE = 5
ARM_TUCK = 6
ARM_HOLD = 7
ARM_RELEASE = 8
ARM_READ = 9

REFUSED = 0
DONE = 1
UNDER_WAY = 2
"""An answer: not the last one, which follows."""
ARM_FOLLOW = 1
ARM_JOG = 2
MOST_JOINTS = 8
MOST_ROWS = 200

PAD_RESET = 1
PAD_FRAME = 2
PLUGGED = ("unknown", "plugged", "unplugged")
PAD_MODES = ("locked", "drive", "joint")


def life(pid: int, block: int) -> int:
    """A word that says whom to watch: the pid, and the block of futexes that it holds."""
    return block << 32 | pid


def unpack_life(word: int) -> tuple[int, int]:
    """Return (pid, block)."""
    return word & 0xFFFFFFFF, word >> 32


def pong(arrival_ns: int, index: int) -> int:
    """A word that says when the board answered a ping, and the ping of which index."""
    return arrival_ns << 2 | index


def unpack_pong(word: int) -> tuple[int, int]:
    """Return (arrival_ns, index); (0, 0) before the first answer."""
    return word >> 2, word & 3


def printable(text: str) -> str:
    """A text of somebody else's, safe to show: what cannot be printed becomes a question mark."""
    return "".join(c if c.isprintable() else "?" for c in text)


def asking(words: str, who: str = "", pid: int = 0) -> bytes:
    """The line for the stop pipe: why, in words that are cut to ASKED_BYTES, and who asks, with tabs between them."""
    text, name = (" ".join(given.split()) for given in (words, who))
    kept = cut(text, ASKED_BYTES)
    if len(kept) < len(text.encode("utf-8", "replace")):
        kept = cut(text, ASKED_BYTES - len(LEFT_OUT)) + LEFT_OUT
    return kept + (b"\t%s\t%d" % (cut(name, WHO_BYTES), pid) if name else b"") + b"\n"


def cut(text: str, room: int) -> bytes:
    """UTF-8 of at most `room` bytes, cut between characters."""
    return text.encode("utf-8", "replace")[:room].decode("utf-8", "ignore").encode()


def _whole(text: str, room: int) -> bytes:
    data = text.encode("utf-8", "replace")
    if len(data) > room:
        raise ValueError(f"{text!r} is longer than {room} bytes")
    return data


def _head(form: struct.Struct, payload: bytes) -> tuple[tuple[int, ...], bytes]:
    if len(payload) < form.size:
        raise ValueError(f"payload of {len(payload)} bytes, at least {form.size} expected")
    return form.unpack_from(payload), payload[form.size :]


def _exact(form: struct.Struct, payload: bytes) -> tuple[float, ...]:
    if len(payload) != form.size:
        raise ValueError(f"payload of {len(payload)} bytes, {form.size} expected")
    return form.unpack(payload)


def pack_frame(epoch: int, kind: int, body: bytes) -> bytes:
    """An entry of the gate's ring: MOTION and OTHER carry a wire frame, STOP nothing."""
    return _FRAME.pack(epoch, kind) + body


def unpack_frame(payload: bytes) -> tuple[int, int, bytes]:
    """Return (epoch, kind, body)."""
    (epoch, kind), body = _head(_FRAME, payload)
    return epoch, kind, body


def pack_stop(epoch: int, cause_ns: int, written_ns: int, cause: bytes) -> bytes:
    """A stop: the epoch it stopped, when it was noticed, when its burst was handed to the kernel (0: it was not), and
    its cause, packed."""
    return _STOP.pack(epoch, cause_ns, written_ns) + cause


def unpack_stop(payload: bytes) -> tuple[int, int, int, bytes]:
    """Return (epoch, cause_ns, written_ns, cause)."""
    (epoch, cause_ns, written_ns), cause = _head(_STOP, payload)
    return epoch, cause_ns, written_ns, cause


def pack_latch(since: int, noticed_ns: int, raised_ns: int, cause: bytes) -> bytes:
    """The latch: the epoch that was raised for what is latched (0: nothing is), when that was noticed, when the epoch
    was raised last; the cause that is latched, else that of the last stop, packed."""
    return _LATCH.pack(since, noticed_ns, raised_ns) + cause


def unpack_latch(payload: bytes) -> tuple[int, int, int, bytes]:
    """Return (since, noticed_ns, raised_ns, cause)."""
    (since, noticed_ns, raised_ns), cause = _head(_LATCH, payload)
    return since, noticed_ns, raised_ns, cause


def pack_port(number: int, since_ns: int, state: int, path: str) -> bytes:
    """The port: its number in this run, since when it is in this state, PORT_OPEN or another, its path."""
    return _PORT.pack(number, since_ns, state) + cut(path, PATH_BYTES)


def unpack_port(payload: bytes) -> tuple[int, int, int, str]:
    """Return (number, since_ns, state, path)."""
    (number, since_ns, state), path = _head(_PORT, payload)
    return number, since_ns, state, path.decode("utf-8", "replace")


def port_state(entry: tuple[int, int, bytes] | None, number: int) -> int:
    """What the port owner's record says of the port with this number; PORT_CLOSED when it is not about that one."""
    if entry is None:
        return PORT_CLOSED
    told, _, state, _ = unpack_port(entry[2])
    return state if told == number else PORT_CLOSED


def pack_command(
    session: int, vx_mps: float, vy_mps: float, wz_radps: float, manual: bool, source: str = "cmd_vel"
) -> bytes:
    """A velocity command of the client session that wrote it: x forward, y left, wz counter-clockwise. Raises
    ValueError for a source that does not fit: cut, it could be another one."""
    return _COMMAND.pack(session, vx_mps, vy_mps, wz_radps, manual, _whole(source, SOURCE_BYTES))


def unpack_command(payload: bytes) -> tuple[int, float, float, float, bool, str]:
    """Return (session, vx_mps, vy_mps, wz_radps, manual, source); the speeds may be anything, NaN too."""
    if len(payload) != _COMMAND.size:
        raise ValueError(f"payload of {len(payload)} bytes, {_COMMAND.size} expected")
    session, vx, vy, wz, manual, source = _COMMAND.unpack(payload)
    return session, vx, vy, wz, bool(manual), source.rstrip(b"\0").decode("ascii", "replace")


def pack_held(session: int, names: list[str]) -> bytes:
    """What a client session asserts now: names of interlocks, or none for "the sensor delivered". Raises ValueError
    for names that do not fit."""
    return _SESSION.pack(session) + _whole("\n".join(names), HELD_BYTES)


def unpack_held(payload: bytes) -> tuple[int, list[str]]:
    """Return (session, names)."""
    (session,), names = _head(_SESSION, payload)
    return session, names.decode("utf-8", "replace").split("\n") if names else []


def pack_said(session: int, sees: str, wrong: str) -> bytes:
    """What a client session says in a line: what it sees, and what is wrong, which may be nothing."""
    return _SESSION.pack(session) + b"\n".join(cut(text, 190).replace(b"\n", b" ") for text in (sees, wrong))


def unpack_said(payload: bytes) -> tuple[int, str, str]:
    """Return (session, sees, wrong)."""
    (session,), text = _head(_SESSION, payload)
    sees, _, wrong = text.decode("utf-8", "replace").partition("\n")
    return session, sees, wrong.replace("\n", " ")


def pack_hello(session: int, pid: int, pid_namespace: int, name: str) -> bytes:
    """Who holds a client slot: a random session number, the pid it says it has and in which namespace of pids
    (lifeline.pid_namespace), its name. NOBODY as the session is a goodbye."""
    return _HELLO.pack(session, pid, pid_namespace) + cut(name, 64)


def unpack_hello(payload: bytes) -> tuple[int, int, int, str]:
    """Return (session, pid, pid_namespace, name)."""
    (session, pid, pid_namespace), name = _head(_HELLO, payload)
    return session, pid, pid_namespace, name.decode("utf-8", "replace")


def pack_request(session: int, number: int, verb: int) -> bytes:
    """A request: ENABLE, DISABLE or RESET; `number` comes back in the reply."""
    return _REQUEST.pack(session, number, verb)


def unpack_request(payload: bytes) -> tuple[int, int, int]:
    """Return (session, number, verb)."""
    session, number, verb = _exact(_REQUEST, payload)
    return int(session), int(number), int(verb)


def pack_reply(session: int, number: int, done: int, text: str, cause: bytes = b"") -> bytes:
    """The answer to a request: DONE, REFUSED with the reason, or UNDER_WAY with how far it is; where it says CAUSE, the
    packed cause is meant."""
    said = cut(text, REPLY_BYTES)
    return _REPLY.pack(session, number, done, len(said)) + said + cause


def unpack_reply(payload: bytes) -> tuple[int, int, int, str, bytes]:
    """Return (session, number, done, text, cause)."""
    (session, number, done, length), rest = _head(_REPLY, payload)
    return session, number, done, rest[:length].decode("utf-8", "replace"), rest[length:]


def pack_arm_goal(session: int, mode: int, values: dict[int, float]) -> bytes:
    """A goal that is renewed: ARM_FOLLOW with the angle (rad) of each servo's joint, ARM_JOG with its rate (rad/s).
    Raises ValueError for more than MOST_JOINTS."""
    if not 0 < len(values) <= MOST_JOINTS:
        raise ValueError(f"{len(values)} joints, must be 1 to {MOST_JOINTS}")
    return _ARM_GOAL.pack(session, mode, len(values)) + b"".join(map(_ARM_VALUE.pack, values, values.values()))


def unpack_arm_goal(payload: bytes) -> tuple[int, int, dict[int, float]]:
    """Return (session, mode, value by servo); the values may be anything, NaN too."""
    (session, mode, count), rest = _head(_ARM_GOAL, payload)
    if not 0 < count <= MOST_JOINTS or len(rest) != count * _ARM_VALUE.size:
        raise ValueError(f"a goal of {count} joints in {len(rest)} bytes")
    return session, mode, {int(servo): value for servo, value in _ARM_VALUE.iter_unpack(rest)}


def pack_arm_path(session: int, share: float, servos: list[int], rows: list[tuple[float, list[float]]]) -> bytes:
    """A trajectory: when (s; 0 in the first row: as fast as `share` of the joints' speeds allows) and the angles (rad)
    of these servos' joints. Raises ValueError for more than MOST_JOINTS or MOST_ROWS."""
    if not 0 < len(servos) <= MOST_JOINTS or not 0 < len(rows) <= MOST_ROWS:
        raise ValueError(f"{len(servos)} joints and {len(rows)} points: at most {MOST_JOINTS} and {MOST_ROWS} fit")
    form = struct.Struct(f"<d{len(servos)}f")
    head = _ARM_PATH.pack(session, share, len(servos), len(rows))
    return head + bytes(servos) + b"".join(form.pack(t_s, *values) for t_s, values in rows)


def unpack_arm_path(payload: bytes) -> tuple[int, float, list[int], list[tuple[float, tuple[float, ...]]]]:
    """Return (session, share, servos, rows); the numbers may be anything, NaN too."""
    found, rest = _head(_ARM_PATH, payload)
    session, share, count, length = found
    form = struct.Struct(f"<d{count}f")
    if not 0 < count <= MOST_JOINTS or len(rest) != count + length * form.size:
        raise ValueError(f"a trajectory of {count} joints and {length} points in {len(rest)} bytes")
    rows = [(row[0], tuple(row[1:])) for row in form.iter_unpack(rest[count:])]
    return session, share, list(rest[:count]), rows


def pack_servo(servo: int, what: int, value: int | None) -> bytes:
    """An answer of a bus servo to a question (board/servos.py); None: the board says that there was none."""
    return _SERVO.pack(servo, what, value is not None, value or 0)


def unpack_servo(payload: bytes) -> tuple[int, int, int | None]:
    """Return (servo, what, value)."""
    servo, what, answered, value = map(int, _exact(_SERVO, payload))
    return servo, what, value if answered else None


def pack_imu(acceleration_mps2: tuple[float, float, float], rate_radps: tuple[float, float, float]) -> bytes:
    """One IMU sample, x forward, y left, z up."""
    return _IMU.pack(*acceleration_mps2, *rate_radps)


def unpack_imu(payload: bytes) -> tuple[float, ...]:
    """Return (ax, ay, az) in m/s2 and (gx, gy, gz) in rad/s, six floats."""
    return _exact(_IMU, payload)


def pack_bias(bias_radps: tuple[float, float, float], tracking: bool, calibrated: bool) -> bytes:
    """The gyro's bias: whether it follows the reading now, and whether it was ever found in a calibration."""
    return _BIAS.pack(*bias_radps, tracking, calibrated)


def unpack_bias(payload: bytes) -> tuple[tuple[float, float, float], bool, bool]:
    """Return (bias in rad/s on x, y, z, tracking, calibrated)."""
    x, y, z, tracking, calibrated = _exact(_BIAS, payload)
    return (x, y, z), bool(tracking), bool(calibrated)


def pack_odometry(
    pose: tuple[float, float, float], twist: tuple[float, float, float], twist_std: tuple[float, float]
) -> bytes:
    """Pose: x m, y m, th rad since the start; twist in the robot's frame: vx m/s, vy m/s, wz rad/s; the standard
    deviation told with it: m/s of vx and vy, rad/s of wz."""
    return _ODOMETRY.pack(*pose, *twist, *twist_std)


def unpack_odometry(payload: bytes) -> tuple[float, ...]:
    """Return (x_m, y_m, th_rad, vx_mps, vy_mps, wz_radps, twist_std_mps, twist_std_radps), eight floats."""
    return _exact(_ODOMETRY, payload)


def pack_battery(millivolts: int, plugged: int) -> bytes:
    """Battery voltage, and whether the charger is plugged in: an index of PLUGGED."""
    return _BATTERY.pack(millivolts, plugged)


def unpack_battery(payload: bytes) -> tuple[int, int]:
    """Return (millivolts, plugged)."""
    millivolts, plugged = _exact(_BATTERY, payload)
    return int(millivolts), int(plugged)


def pack_pad(buttons: int, hat: int, lx: int, ly: int, rx: int, ry: int, mode: int) -> bytes:
    """The gamepad's last frame: a bit a button, the hat, raw axes -128..127; its mode, an index of PAD_MODES."""
    return _PAD.pack(buttons, hat, lx, ly, rx, ry, mode)


def unpack_pad(payload: bytes) -> tuple[int, ...]:
    """Return (buttons, hat, lx, ly, rx, ry, mode)."""
    return tuple(int(v) for v in _exact(_PAD, payload))


def pack_pad_command(vx_mps: float, vy_mps: float, wz_radps: float) -> bytes:
    """What the gamepad's sticks command: x forward, y left, wz counter-clockwise."""
    return _PAD_COMMAND.pack(vx_mps, vy_mps, wz_radps)


def unpack_pad_command(payload: bytes) -> tuple[float, float, float]:
    """Return (vx_mps, vy_mps, wz_radps)."""
    vx, vy, wz = _exact(_PAD_COMMAND, payload)
    return vx, vy, wz


def pack_pad_arm(joint: int, share: float) -> bytes:
    """What the gamepad asks of the arm: which joint, by its place in the settings, and the share of its speed, -1 to
    1."""
    return _PAD_ARM.pack(joint, share)


def unpack_pad_arm(payload: bytes) -> tuple[int, float]:
    """Return (joint, share)."""
    joint, share = _exact(_PAD_ARM, payload)
    return int(joint), share


def pack_pad_request(kind: int, frame: bytes = b"") -> bytes:
    """What telemetry asks the gate for: PAD_RESET, or PAD_FRAME with a wire frame that is not motion."""
    return _WISH.pack(kind) + frame


def unpack_pad_request(payload: bytes) -> tuple[int, bytes]:
    """Return (kind, frame)."""
    (kind,), frame = _head(_WISH, payload)
    return kind, frame
