"""The layout of shared memory. It declares every record once, with the process that writes it, the shape of its
payload, and the processes that read it.

Each process has a segment of its own. It maps this segment for writing, and all other segments only for reading, so two
processes can never write the same record. Each client slot also has a segment, to which only the client writes. The
service never maps a client's segment into memory, but reads it as a file (see cell.py).

In each segment, the records that the C library uses come first (OF_LIBRARY), so that a new record of the service does
not move them.
"""

from __future__ import annotations

from zlib import crc32

from failstop.messages import box, records
from failstop.messages.records import Shape
from failstop.shm.futex import BLOCKS, PER_BLOCK
from failstop.shm.segment import Record, SegmentSpec
from failstop.shm.words import LINE_BYTES

LAYOUT_VERSION = 13
SUPERVISOR_BLOCK = 0
"""The block of futexes (futex.py) that the supervisor holds. The processes that it starts hold the blocks after this
one."""
CLIENT_SLOTS = 8
NOTE_BYTES = 576
"""The longest note that the gate or telemetry sends (packing.py), in bytes."""
PINGS = 4
"""How many pings a board can have at most. All pings of a board differ, so that an answer shows which ping it belongs
to."""
PUBLIC = 0o644
CLIENTS_WRITE = 0o660
PRIVATE = 0o600

SUPERVISOR = "supervisor"
PORT_OWNER = "port_owner"
GATE = "gate"
TELEMETRY = "telemetry"
STOPPER = "stopper"
PROCESS_NAMES = (SUPERVISOR, PORT_OWNER, GATE, TELEMETRY, STOPPER)


def _word(name: str, readers: str) -> Record:
    return Record("word", name, readers)


def _latest(name: str, payload: Shape | int, readers: str) -> Record:
    """A record that keeps only its newest value. `payload`: the shape of the value, or its size in bytes."""
    return Record("latest", name, readers, payload if isinstance(payload, int) else payload.most, 2)


def _ring(name: str, payload: Shape | int, cells: int, readers: str) -> Record:
    return Record("ring", name, readers, payload if isinstance(payload, int) else payload.most, cells)


def _beat() -> tuple[Record, ...]:
    """The records for the heartbeat of one process (heartbeat.py)."""
    return (
        _word("beat_ns", "everyone"),  # CLOCK_MONOTONIC of the last pass through its loop
        _word("beat_worst_ns", "everyone"),  # the longest time between two passes
        _word("beat_pid", "everyone"),
        _word("beat_cpu_ns", "everyone"),  # the processor time that it had used by then
        _word("beat_state", "everyone"),  # heartbeat.BEAT_STARTING, BEAT_RUNNING, BEAT_STOPPING
        _word("beat_rights", "everyone"),  # heartbeat.REALTIME | MEMORY_LOCKED | EARLY_NEWS
    )


FEWER: dict[str, int] = {"sensed": 64, "attended": 96}
"""The sizes in bytes of client records that never need all the room of their shape."""


def _client(index: int) -> SegmentSpec:
    return SegmentSpec(
        f"client.{index}",
        "the client that holds the slot's claim",
        CLIENTS_WRITE,
        (
            _latest("left", records.LEFT, "gate"),  # the sessions that have left; kept when the slot is taken again
            Record("futexes", "held", "gate", LINE_BYTES),  # held by a thread of the client
            _latest("hello", records.HELLO, "gate"),
            *(_latest(name, FEWER.get(name, shape), "gate") for name, shape in records.OF_SESSION.items()),
        ),
    )


SEGMENTS = (
    SegmentSpec(
        SUPERVISOR,
        SUPERVISOR,
        PUBLIC,
        (
            *_beat(),
            _word("epoch", "port_owner, gate, stopper, clients"),
            _word("ready", "gate, clients"),  # 1 while every process beats and the port is open and stopped
            _latest("latch", records.LATCH, "port_owner, gate, clients"),  # the latched cause, or the last one
            _latest("link", 32, "gate, clients"),  # whether the board answers (ASCII)
            _latest("rules", 512, "clients"),  # the settings that clients need (msgpack), written once
            _latest("settings", 16384, "clients"),  # every setting of this run by its whole key (msgpack)
            # For each of these processes, the one that runs now (records.life), so that its death is noticed.
            *(_word(f"{process}_life", "port_owner") for process in (GATE, TELEMETRY, STOPPER)),
            _word("port_owner_life", "stopper"),
            _word("written_ns", "everyone"),  # when the supervisor itself last wrote a burst
            _word("resets", "gate"),  # the number of the newest reset that it has granted or refused
            _latest("reset", records.REPLY, "gate"),  # the answer to that reset (policy/causes.py)
            _latest("stop", 1024, "clients"),  # the last stop, for people (msgpack)
            _latest("processes", 2048, "clients"),  # the process table (msgpack)
            _ring("events", 512, 256, "clients"),  # events for people (msgpack, supervisor/events.py)
            _ring("box", box.OF_BEATS, box.BEATS_CELLS, "everyone"),  # heartbeats, and its own bursts (box.py)
        ),
    ),
    SegmentSpec(
        PORT_OWNER,
        PORT_OWNER,
        PUBLIC,
        (
            *_beat(),
            _latest("port", records.PORT, "supervisor, stopper, clients"),  # the state and path of the port
            _word("stopped_epoch", "supervisor, stopper"),  # the newest epoch for which it has written a stop
            _word("written_ns", "everyone"),  # when it last wrote a burst
            # 1 if what was written last may make the wheels turn: from before a motion frame until a whole burst, or
            # its repeat.
            _word("moving", "supervisor, stopper"),
            _word("told_ns", "telemetry"),  # since when the written frames make the wheels turn; 0: they don't
            _word("asked_ns", "supervisor"),  # when the port owner last wrote a ping
            _ring("stops", records.STOPPED, 32, "supervisor"),  # every stop that it has noticed, in order
            # The pings and commands that the board will answer or echo, with the time before each write. It has room
            # for more pings and clients' questions than can be sent within GIVEN_UP_NS.
            _ring("wrote", records.WROTE, 1536, "everyone"),
            _ring("received", 512, 512, "everyone"),  # bytes from the board while no telemetry runs, in order
            _ring("box", box.WIRE, box.WIRE_CELLS, "everyone"),  # bytes for the board (box.py)
        ),
    ),
    SegmentSpec(
        GATE,
        GATE,
        PUBLIC,
        (
            *_beat(),
            _latest("state", 4096, "telemetry, clients"),  # the gate's decision (msgpack)
            *(_latest(f"reply.{i}", records.REPLY, "the client of that slot") for i in range(CLIENT_SLOTS)),
            _word("resets_asked", "supervisor, its successor"),  # the number of the newest reset that was requested
            _word("reset_asked_ns", "supervisor"),  # when that reset was requested
            _word("busy", "supervisor, telemetry"),  # 1 if motion is enabled, a client is present, or there is an arm
            _word("limit", "its successor"),  # the speed limit in percent of the settings; 0 if nobody has set one
            _ring("frames", records.FRAME, 64, "port_owner"),  # motion, stops, and other frames for the board
            _ring("stops", records.STOPPED, 32, "supervisor"),  # every stop that it has noticed, in order
            _ring("notes", NOTE_BYTES, 32, "supervisor"),  # notes for people (packing.py)
            _latest("said", 4096, "clients"),  # what clients report about themselves (msgpack, procs/gate/remarks.py)
            _ring("box", box.TICK, box.GATE_CELLS, "everyone"),  # the command and decision of every tick (box.py)
            _ring("arm_box", box.ARM_BYTES, box.ARM_CELLS, "everyone"),  # where the arm must go, and for whom (box.py)
        ),
    ),
    SegmentSpec(
        TELEMETRY,
        TELEMETRY,
        PUBLIC,
        (
            *_beat(),
            _latest("imu", records.IMU, "clients"),  # corrected: the bias is taken off the rate
            _latest("wheels", records.WHEELS_SEEN, "gate, supervisor, clients"),  # what is known about the wheels
            _latest("battery", records.BATTERY, "its successor, clients"),
            _latest("odometry", records.ODOMETRY, "its successor, clients"),
            _word("port_number", "supervisor"),  # the number of the port that it reads; 0: none
            _word("restarts", "port_owner"),  # how often the board has restarted
            _latest("answered", records.PROVED, "supervisor, its successor"),  # the newest ping that was answered
            _latest("proved", records.PROVED, "supervisor"),  # the newest stop that the board has obeyed
            _word("unheeded_ns", "supervisor, clients"),  # since when it reports zero although motion is commanded
            _word("said_ns", "supervisor, clients"),  # when the board last sent anything; 0: never
            # How long the board may be silent; 0 if it speaks only when asked, or if that is not known yet.
            _word("patience_ns", "supervisor, its successor"),
            _word("still_ns", "supervisor"),  # since when the IMU shows wheels at rest; 0: they turn
            _word("judged_ns", "supervisor"),  # the last IMU sample that still_ns depends on; 0: none yet
            _latest("scale", 1024, "clients"),  # measured over commanded: wheels, turn, faults, remarks (msgpack)
            _latest("health", records.HEALTH, "supervisor, gate, clients"),
            _latest("bias", records.BIAS, "its successor, clients"),
            _latest("pad", records.PAD, "clients"),
            _latest("pad_arm", records.PAD_ARM, "gate"),  # one per frame while the pad moves a joint
            _latest("pad_command", records.PAD_COMMAND, "gate"),  # one per frame while the pad drives
            # The causes for which it stops the robot, in order. An empty entry means: write the stop again, without a
            # cause.
            _ring("causes", records.CAUSE_BYTES, 8, "port_owner"),
            _ring("servos", records.SERVO, 64, "gate"),  # the answers of the arm's servos, in order
            _ring("pad_requests", records.PAD_REQUEST, 32, "gate"),  # resets, and frames other than motion, in order
            _ring("notes", NOTE_BYTES, 32, "supervisor"),  # notes for people (packing.py)
            _ring("received", 512, 512, "everyone"),  # bytes from the board, in order; about 4 s of them
            _ring("box", box.BOARD_BYTES, box.BOARD_CELLS, "everyone"),  # the board's reports, decoded (box.py)
        ),
    ),
    SegmentSpec(
        STOPPER,
        STOPPER,
        PUBLIC,
        (
            *_beat(),
            _word("written_ns", "everyone"),  # when the stopper last wrote a burst
            _word("port_number", "supervisor"),  # the number of the port that it holds; 0: none
        ),
    ),
    SegmentSpec(
        "lifelines",
        "every process of the service, each its own block",
        PRIVATE,
        (Record("futexes", "held", "every process of the service", BLOCKS * PER_BLOCK * LINE_BYTES),),
    ),
    *(_client(i) for i in range(CLIENT_SLOTS)),
)

SEGMENT_BY_NAME = {spec.name: spec for spec in SEGMENTS}
_TEXT = f"layout {LAYOUT_VERSION}\n" + "\n".join(
    f"{spec.name} {spec.writer} {spec.mode:o} {r.kind} {r.name} {r.capacity} {r.cells} {spec.offsets[r.name]}"
    for spec in SEGMENTS
    for r in spec.records.values()
)
LAYOUT_HASH = crc32(_TEXT.encode()) << 32 | crc32(_TEXT.encode(), 0x5AFE)
"""A hash of all declarations above. Processes with different hashes refuse to work together. The hash covers the sizes
of the payloads, but not their formats. So if you change the format of a payload but not its size, raise
LAYOUT_VERSION."""

CLIENT_VERSION = 1
"""Raise this number if a value, or a key in `state`, `rules` or `settings`, gets a new meaning, so that programs with
the C library (clients/c) must be built again. If the size or the place of a record in OF_LIBRARY changes, the hash
below shows it without a new number."""
OF_LIBRARY: dict[str, dict[str, Shape | None]] = {
    SUPERVISOR: {
        **dict.fromkeys(("beat_ns", "epoch", "ready", "link", "rules", "settings")),
        "latch": records.LATCH,
    },
    PORT_OWNER: {"port": records.PORT},
    GATE: {"state": None, **{f"reply.{i}": records.REPLY for i in range(CLIENT_SLOTS)}},
    TELEMETRY: {
        "imu": records.IMU,
        "wheels": records.WHEELS_SEEN,
        "battery": records.BATTERY,
        "odometry": records.ODOMETRY,
    },
    "client.0": {
        "left": records.LEFT,
        "held": None,
        "hello": records.HELLO,
        **{name: records.OF_SESSION[name] for name in ("command", "sensed", "interlocks", "request", "seen", "said")},
    },
}
"""The records that the C library reads or writes, with the shape of each record that has one. A program with an older
library works with a newer service as long as nothing in this table changes."""
_OF_LIBRARY = f"client {CLIENT_VERSION}\n" + "\n".join(
    f"{name} {r.kind} {r.name} {r.capacity} {r.cells} {SEGMENT_BY_NAME[name].offsets[r.name]} {shape and shape.form}"
    for name, used in OF_LIBRARY.items()
    for r, shape in ((SEGMENT_BY_NAME[name].records[record], shape) for record, shape in used.items())
)
CLIENT_HASH = crc32(_OF_LIBRARY.encode()) << 32 | crc32(_OF_LIBRARY.encode(), 0x5AFE)
"""A hash of the records that the C library uses. The header of each segment contains it, next to the hash of the whole
layout."""
