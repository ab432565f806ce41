"""Targets of the fuzzers: whatever reads bytes that others wrote, each as a function of bytes that may only fail as its
docstring says, with examples of what it should understand."""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import math
import os
import random
import struct
import zlib
from argparse import Namespace
from binascii import crc_hqx
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import msgpack

from failstop import config
from failstop.api.errors import FailstopError
from failstop.board import described, interface
from failstop.board import wire as wire_words
from failstop.board.driver import DriverAnswer, DriverFrame, DriverMotion, DriverRefusal, language_of
from failstop.board.kinds import board_of, is_described
from failstop.board.rrc.framing import MOTOR
from failstop.board.servos import ServoAnswer
from failstop.cli.commands import incident as command
from failstop.cli.screen import incident as screen
from failstop.fleet import levels, signed, topics, twins, view, wire
from failstop.fleet.replay import Seen
from failstop.fleet.roster import Roster
from failstop.fleet.twins import Twins
from failstop.guard.talk import Talk
from failstop.incidents import files
from failstop.messages import box, packing, records
from failstop.policy import causes, layouts
from failstop.policy.setting import SettingError
from failstop.ros2 import trajectory
from failstop.web import driving, guard, lease, messages
from failstop.web import incidents as cards
from failstop.web.devices import Devices, typed
from failstop_lab.boards.line import arrivals, model_of
from failstop_lab.boards.vesc import wrapped
from failstop_lab.prove import pack
from failstop_lab.sim.motors import Motors
from failstop_lab.sim.receiver import Receiver

ROOT = Path(__file__).resolve().parents[2]
KEPT = ROOT / "tests/incidents/kept/0.1.0-gate-died.incident"
SCRATCH = Path(os.environ.get("XDG_RUNTIME_DIR", "/dev/shm")) / f"failstop-fuzz-{os.getpid()}"
"""A file, or a folder, while a target runs."""
SHOWN = ({"all": False, "json": False}, {"all": True, "json": False}, {"all": True, "json": True})
"""Options of `incident show`."""
BOARDS = {kind: board_of(kind, 0.1, 0.0) for kind in layouts.BOARDS}
SIZES: dict[str, float | str] = {"wheels.track_m": 0.172}
SPOKEN = [kind for kind in BOARDS if language_of(kind, SIZES)]
"""Boards that have a language for drivers."""
GAPS = "hoverboard"
"""The board that takes a frame only between two gaps, which a terminal does not keep: each frame counts as alone."""
SLOW_NS = 5_000_000
"""Between two bytes for the other boards, so that one that answers a byte loses none of the next ones."""
NEVER_NS = 1 << 62
DRIVER_BYTES = 600
KEY = bytes(32)
ROBOT = "failstop/v1/failstop/robot/robot7"


class Target(NamedTuple):
    """One reader that is fuzzed."""

    run: Callable[[bytes], object]
    """Raises for a defect alone."""
    examples: tuple[bytes, ...] = ()


def decoders(data: bytes) -> None:
    """Words of every kind of board: the same in one piece as in two."""
    at = data[0] if data else 0
    for kind in BOARDS:
        board = BOARDS[kind]
        whole, pieces = board.hearing(), board.hearing()
        said = whole.feed(data)
        assert repr(said) == repr([*pieces.feed(data[:at]), *pieces.feed(data[at:])]), kind
        for what, value in said:
            recorded(what, value)
        for check in (lambda frame, board=board: board.check_motion(frame, 5.0), board.check_aux):
            assert isinstance(check(data), str)
        board.speeds(data)
    for number in _doubles(data):
        for sample in reports(number):
            for what, value in described.Samples(OwnWire([sample])).feed(b""):
                recorded(what, value)


class Listed(wire_words.Reader):
    """A reader that has these samples for any bytes."""

    def __init__(self, samples: list[wire_words.Sample]) -> None:
        self._samples = samples

    def feed(self, chunk: bytes) -> list[wire_words.Sample]:
        return self._samples


class OwnWire(wire_words.Wire):
    """An own board, as far as its reports go."""

    def __init__(self, samples: list[wire_words.Sample]) -> None:
        self.questions = ()
        self.reader = lambda: Listed(samples)


def reports(number: float) -> Iterator[wire_words.Sample]:
    """Every report of an own board, with this number, as a float and as the integer that it may be."""
    for value in (number, int(number) if math.isfinite(number) else 0):
        yield from (wire_words.Battery(value), wire_words.Wheels((value,), (value, 0.0)), wire_words.Obeyed((value,)))
        yield from (wire_words.Imu((value, value, value), (0.0, value, 0.0)), ServoAnswer(value, value, value))  # type: ignore[arg-type]
        yield from (wire_words.Health(((value, value, value),)), wire_words.Health(((1, value, 20),)))  # type: ignore[arg-type]
        yield wire_words.Health(((1, 0.0, 20, value),))  # type: ignore[arg-type]


def recorded(what: int, value: tuple[Any, ...]) -> None:
    """A record takes what a board said."""
    if what == interface.HEARD_BATTERY:
        assert value == (0,) or 1000 <= value[0] <= 1_000_000
        box.pack_board(box.BATTERY_KIND, *value, 0)
    elif what == interface.HEARD_IMU:
        assert all(map(math.isfinite, records.IMU.unpack(records.IMU.pack(*value))))
    elif what == interface.HEARD_SERVO:
        box.pack_board(box.SERVO_KIND, *value)
    elif what == interface.HEARD_HEALTH:
        records.HEALTH.pack(*value)
    elif what == interface.HEARD_PAD:
        box.pack_board(box.PAD_KIND, *value[:6], 0)
    elif what == interface.HEARD_WHEELS:
        assert all(map(math.isfinite, (*value[0], *value[1])))
    elif what == interface.HEARD_OBEYED:
        assert value
        assert all(map(math.isfinite, value))
    elif what == interface.HEARD_ODD:
        about, text = value
        packing.Note("odd", text, {"what": about, "value": text}).pack()


def receivers(data: bytes) -> None:
    """The simulated firmware: in any state a burst stops it, whatever came before."""
    at = data[0] if data else 0
    whole, pieces = Receiver(), Receiver()
    frames = [row[1:] for row in whole.feed(data)]
    assert frames == [row[1:] for part in (data[:at], data[at:]) for row in pieces.feed(part)]
    board = BOARDS["rrc"]
    stop = board.stop
    (func, _, *body) = stop[2:-1]
    assert (func, bytes(body)) in [row[1:] for row in whole.feed(board.burst)]


def obeyed(kind: str, body: bytes) -> list[tuple[float, ...]]:
    """The speeds that the board itself commands when these bytes reach it, however a driver has paused among them."""
    if not is_described(kind):
        receiver, motors = Receiver(), Motors()
        frames = [row[1:] for row in receiver.feed(body)]
        return [motors.execute(data) for func, data in frames if func == MOTOR]
    if kind == GAPS:
        starts = [at for at in range(len(body)) if body[at : at + 1] == BOARDS[kind].stop[:1]]
        return [speeds for at in starts for speeds in _heard(kind, body[at : at + len(BOARDS[kind].stop)])]
    return _heard(kind, body)


def _heard(kind: str, body: bytes) -> list[tuple[float, ...]]:
    board = model_of(kind).any_state(random.Random(0))
    for motor in getattr(board, "motors", ()):
        if hasattr(motor, "until"):
            motor.until = lambda _: None  # a time for its watchdog is refused, by name
    if hasattr(board, "_joined"):
        board._joined = False  # a driver's frame for one motor is a motion, whatever is read at the same time
    if hasattr(board, "_looked_ns"):
        # The driver has written all of this at once, so no motor's timeout is over before the last byte is there.
        board._looked_ns = NEVER_NS
    at_ns, byte_ns = SLOW_NS, BOARDS[kind].port.byte_ns if kind == GAPS else SLOW_NS
    for at_ns, value in arrivals([(at_ns, body)], byte_ns):  # noqa: B020
        board.byte(at_ns, value)
        if hasattr(board, "_rates"):
            board._rates = [1.0, 1.0]  # T:138 is refused, by name: it does not reach the board
    board.until(at_ns + SLOW_NS)
    return [speeds for _, speeds in board.commands]


def _alike(one: tuple[float, ...], other: tuple[float, ...]) -> bool:
    """Each wheel has the speed that the board has, or none: a refusal stops them all."""
    return all(not a or math.isclose(a, b, rel_tol=1e-6, abs_tol=1e-9) for a, b in zip(one, other, strict=True))


def _said(rows: list[DriverMotion | DriverAnswer | DriverFrame | DriverRefusal]) -> tuple[object, ...]:
    """What rows ask for: a motion that is repeated asks for nothing more, nor does a refusal."""
    motions = [repr(list(map(float, row.speeds))) for row in rows if isinstance(row, DriverMotion)]
    answers = [row.data for row in rows if isinstance(row, DriverAnswer)]
    refusals = {(row.what, row.why) for row in rows if isinstance(row, DriverRefusal)}
    return [motion for motion, _ in itertools.groupby(motions)], answers, refusals


def drivers(data: bytes) -> None:
    """A driver's bytes, in the language of every board that has one: the rows of a whole are those of its pieces, no
    wheel turns that the board itself would not turn, and what a conversation commands is finite and complete."""
    at, body = (data[0], data[1:DRIVER_BYTES]) if data else (0, b"")
    pieces = body[:at], body[at:]
    for kind in SPOKEN:
        wheels = BOARDS[kind].wheels
        whole, split = language_of(kind, SIZES), language_of(kind, SIZES)
        assert whole
        assert split
        rows = whole.wrote(body, 1)
        assert _said(rows) == _said([row for part in pieces for row in split.wrote(part, 1)]), kind
        moved = []
        for row in rows:
            assert isinstance(row, (DriverMotion, DriverAnswer, DriverFrame, DriverRefusal)), kind
            if isinstance(row, DriverFrame):
                assert row.data in BOARDS[kind].pings or BOARDS[kind].check_aux(row.data) == "", (kind, row.data)
                assert not any(any(speeds) for speeds in obeyed(kind, row.data)), (kind, row.data)
            if isinstance(row, DriverMotion) and any(row.speeds):
                moved.append(tuple(row.speeds))
        own = iter(obeyed(kind, body))
        for speeds in moved:
            assert any(_alike(speeds, found) for found in own), (kind, speeds)
        for now_ns, part in enumerate(pieces):
            assert all(isinstance(heard, bytes) for heard in whole.heard(part, now_ns)), kind
        talk = Talk(split, wheels, 300, 300)
        for now_ns, part in enumerate((body, *pieces)):
            assert all(isinstance(answer, bytes) for answer in talk.wrote(part, now_ns, 0)), kind
            command = talk.command(now_ns)
            assert command is None or (len(command.speeds) == wheels and all(map(math.isfinite, command.speeds))), kind
        assert all(row.what.isprintable() and row.why.isprintable() for row in talk.refusals), kind
        talk.ended(body, 3)


SHAPES: tuple[Callable[[bytes], object], ...] = (
    *(value.unpack for value in vars(records).values() if isinstance(value, records.Shape)),
    *(getattr(box, name) for name in dir(box) if name.startswith("unpack_")),
    packing.Note.unpack,
    causes.unpack,
)


def memory(data: bytes) -> None:
    """Records of shared memory, which a hostile client writes: ValueError is damage, and nothing else is raised."""
    for unpack in SHAPES:
        with contextlib.suppress(ValueError):
            unpack(data)
    str(causes.read(data))
    str(causes.requested(data))


def incident(data: bytes) -> None:
    """An incident that somebody sent, with right checksums: shown and listed, or refused in a line."""
    size = min(struct.unpack_from("<H", data)[0], len(data) - 2) if len(data) >= 2 else 0
    head, body = data[2 : 2 + size], zlib.compress(data[2 + size :], 1)
    lengths = struct.pack("<HHIIII", 1, 0, len(head), zlib.crc32(head), len(body), zlib.crc32(body))
    SCRATCH.mkdir()
    path = SCRATCH / f"sent{files.SUFFIX}"
    path.write_bytes(files.MAGIC + lengths + head + body)
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            for shown in SHOWN:
                with contextlib.suppress(FailstopError):
                    command.main(Namespace(action="show", id=str(path), name="failstop", **shown))
        listed, _ = files.heads("failstop", [str(SCRATCH)])
        screen.table(listed, 80)
        json.dumps([cards._card(row) for row in listed])
    finally:
        path.unlink()
        SCRATCH.rmdir()


def evidence(data: bytes) -> None:
    """An evidence pack that somebody sent, with this record or of these bytes: told in lines that a terminal shows, or
    refused with FailstopError."""
    record = b'<script type="application/json" id="record">' + data + b"</script>"
    try:
        whole = pack.page(json.loads(data)).encode("utf-8", "surrogatepass")
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        whole = b""
    for page in (data, record, whole):
        SCRATCH.write_bytes(page)
        try:
            with contextlib.suppress(FailstopError):
                assert all(line.isprintable() for line in pack.verified(str(SCRATCH)).splitlines())
        finally:
            SCRATCH.unlink()


def settings(data: bytes) -> None:
    """A file of settings: right, or refused with SettingError."""
    SCRATCH.write_bytes(data)
    try:
        with contextlib.suppress(SettingError):
            config.load(str(SCRATCH)).flat()
    finally:
        SCRATCH.unlink()


def page(data: bytes) -> None:
    """All that a browser sends: messages, headers, codes, the stick; and the file of paired devices."""
    found = messages.read(data)
    text = data.decode("utf-8", "replace")
    for said in (text, str(found.get("drive") or "")):
        wanted = driving.share(said)
        assert wanted is None or all(math.isfinite(part) and abs(part) <= 1 for part in wanted)
    held = lease.Lease(lease.key_of("token"))
    nonce = held.ask(b"12345678", 1)
    assert not held.accept(nonce, str(found.get("answer")), str(found.get("drive") or ""))
    guard.refusal(guard.PageRequest("POST", "http", text, text, "1", ""), frozenset(("robot",)))
    typed(text)
    with contextlib.suppress(ValueError):
        Devices.load(data)


def fleet(data: bytes) -> None:
    """All that a broker passes on, whoever published it: packets, states, connections, stops."""
    packets = wire.MqttWire()
    with contextlib.suppress(wire.Malformed):
        packets.feed(data)
    heard = [(topic, payload) for topic, payload, _ in packets.messages()]
    name, _, rest = data.partition(b"\0")
    topic = f"{topics.of_robot('failstop', name.decode('utf-8', 'replace'), topics.STATE)}"
    heard += [(topic, rest), (f"{ROBOT}/{topics.STATE}", data), (f"{ROBOT}/{topics.CONNECTION}", data)]
    roster = Roster()
    for topic, payload in heard:
        roster.hear(topic, payload, 1.0, retained=False)
    view.counts(roster.sorted(), 2.0, 2.0)
    view.table(roster.sorted(), 2.0, 2.0)
    twins.connection_of(data)
    Twins("0" * 16, 1.0).hear(data, retained=False)
    with contextlib.suppress(ValueError):
        Seen.load(data, 1.0)
    text = data.decode("utf-8", "replace")
    genuine = json.dumps({"body": text, "mac": signed._mac(KEY, signed.STOP_PURPOSE, text)}).encode()
    for message in (data, genuine):
        for read in (levels.read_order, levels.read_answer):
            with contextlib.suppress(signed.Forged):
                read(KEY, message)


def _doubles(data: bytes) -> Iterator[float]:
    yield from (value for (value,) in struct.iter_unpack("<d", data[: len(data) // 8 * 8]))


def bridge(data: bytes) -> None:
    """A trajectory of ROS, of any numbers: a way, or refused with FailstopError."""
    joints, *rest = data or b"\0"
    names = [f"joint{number % 3}" if number > 8 else f"joint{number}" for number in range(joints % 12)]
    values = list(_doubles(bytes(rest)))
    size = max(1, len(names))
    rows = [values[at : at + size] for at in range(0, len(values), size)]
    points: list[Any] = [
        SimpleNamespace(
            positions=row,
            velocities=[],
            accelerations=[],
            effort=[],
            time_from_start=SimpleNamespace(sec=number, nanosec=int(row[0]) % 10**9 if math.isfinite(row[0]) else 0),
        )
        for number, row in enumerate(rows)
    ]
    with contextlib.suppress(FailstopError):
        trajectory.way(SimpleNamespace(joint_names=names, points=points))


STATE = {
    "t": 1735689600.0,
    "word": "DRIVING",
    "why": "0.20 m/s forward",
    "next": "",
    "moves": True,
    "latched": False,
    "errors": [{"kind": "stop_latched", "level": "fatal", "text": "x"}],
    "battery": {"volts": 7.4},
}
ORDER = {"id": "0123456789abcdef", "t": 1.5, "reason": "smoke", "by": "anna", "robot": "r", "reached": {"asked": 0.1}}


def _kept() -> bytes:
    head, body = files.read(str(KEPT))
    packed: bytes = msgpack.packb(head)
    return struct.pack("<H", len(packed)) + packed + bytes(msgpack.packb(body))


def made_up() -> Iterator[bytes]:
    """Of the kept incident, each with one value of its head that failstop never writes."""
    head, body = files.read(str(KEPT))
    values: tuple[Any, ...] = (None, -1, 1e300, float("nan"), "x", b"\xff", [], {"name": {}, "gate": 7})
    for key in sorted(head):
        for value in values:
            packed: bytes = msgpack.packb({**head, key: value})
            yield struct.pack("<H", len(packed)) + packed + bytes(msgpack.packb(body))


PROVED = {
    **dict.fromkeys(("verdict", "begun", "version", "code_sha256", "settings_sha256", "machine", "kernel"), "x"),
    **dict.fromkeys(("python", "board", "device", "can_not", "ended", "simulated", "realtime", "covers"), "x"),
    "complete": False,
    "cores": 2,
    "distances": ["0.1 m"],
    "unproved": ["x"],
    "rows": [{**{key: 1.5 for key, _ in pack.COLUMNS}, "wrong": ["x"], "skipped": "", "starved": ""}],
    "settings": {"gate.lease_s": 0.06},
}

DEEP = b"[" * 100_000
"""No parser of Python goes so deep."""

TARGETS: dict[str, Target] = {
    "decoders": Target(
        decoders,
        (
            *(b"\0" + BOARDS[kind].stop + BOARDS[kind].burst for kind in BOARDS),
            b'\0{"T":1001,"v":-1}\n{"T":1001,"v":1e308,"L":NaN,"R":0}\n',
            b'\0{"T":1001,"v":1' + bytes(b"0" * 310) + b"}\n",
            struct.pack("<8d", -0.01, 0.0, 1e308, -1e308, math.nan, math.inf, 11.6, 255.0),
        ),
    ),
    "drivers": Target(
        drivers,
        (
            *(
                b"\4" + BOARDS[kind].motor_speeds([0.3] * BOARDS[kind].wheels, 0.3) * 2 + BOARDS[kind].burst
                for kind in SPOKEN
            ),
            b"\5\ru 30:20:0:100\rm 10 -20\re\rm 32768 0\rxm +7, +8\ro 90 90\r",
            b'\7{"T": "13", "X": 0.1, "Z": 0.4}\n{"T":1,"L":0.2,"R":-0.3}\n{\'T\':1,L:1.9e0,R:.5}\n{"T":0}\n',
            b'\7{"T":11,"L":200,"R":200}\n{"T":138,"L":0.5,"R":0.5}\n{"T":1,"L":0.2,"R":0.2}\n',
            b'\7{"T":1,"L":1e400,"R":-1e400}\n{"T":13,"X":NaN,"Z":1e308}\n',
            b"\3C\rS8\r\rO\rt7FF80200330A00000000\rt7FF80100550A03000000\rt0018FFFFFFFFFFFFFFFC\rt20140000803F\r",
            b"\7t20180000803F00000000\rt0028FFFFFFFFFFFFFFFD\rt2018123\rt0018FFFFFFFFFFFFFFFE\rt1018"
            + b"0" * 16
            + b"\r",
            b'\7{"T":132,"IO4":["a"]}\n{"T":3,"lineNum":{"a":1}}\n{"T":132,"IO4":[1],"IO5":null}\n',
            b"\5\3\1\0\x0d" + bytes(255) + crc_hqx(b"\x0d" + bytes(255), 0).to_bytes(2, "big") + b"\3",
            b"\5" + b"".join(map(wrapped, (b"\x08\0\0\3\xe8", b"\x22\1\x08\xff\xff\xfd\x44", b"\6\0\0\7\xd0", b"\4"))),
        ),
    ),
    "receivers": Target(receivers, (b"\3" + BOARDS["rrc"].burst,)),
    "memory": Target(memory, (records.asking("smoke", "anna", 7), bytes(64), msgpack.packb(["a", "b", "c", 0, {}]))),
    "incident": Target(incident, (_kept(), *made_up())),
    "evidence": Target(
        evidence, (json.dumps(PROVED).encode(), json.dumps({**PROVED, "verdict": "\x1b]0;x\x07<b>"}).encode(), DEEP)
    ),
    "settings": Target(settings, ((ROOT / "examples/failstop.toml").read_bytes(), b"[gate]\nlease_s = 0.1\n")),
    "page": Target(page, (DEEP, b'{"attend":true,"nonce":"00","answer":"aa","drive":"0.1 0.2"}', b"[::1]:8080")),
    "fleet": Target(
        fleet,
        (
            json.dumps(STATE).encode(),
            json.dumps(ORDER).encode(),
            b'{"connection":"online"}',
            b"0\x0e\0\x03a/bpayload\0",
            DEEP,
        ),
    ),
    "bridge": Target(bridge, (b"\2" + struct.pack("<4d", 0.1, 0.2, 0.3, 0.4),)),
}
