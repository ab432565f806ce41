"""The layout: every record of shared memory, declared once, with its writer, its payload and its readers.

In each segment, the records that the C library reads come first (OF_LIBRARY), so that a new record of the service's own
moves none of them.

There is one segment per writer, so the mapping enforces "one writer per record": a process maps its own segment for
writing and every other one only for reading. Clients write their own segments, and the service never maps those (see
cell.py).
"""

from __future__ import annotations

from zlib import crc32

from failstop.messages import box, records
from failstop.messages.records import Shape
from failstop.shm.futex import BLOCKS, PER_BLOCK
from failstop.shm.segment import Record, SegmentSpec
from failstop.shm.words import LINE_BYTES

LAYOUT_VERSION = 12
SUPERVISOR_BLOCK = 0
"""The block of futexes (futex.py) that the supervisor holds. The blocks of its children come after it."""
CLIENT_SLOTS = 8
NOTE_BYTES = 576
"""The longest note that gate and telemetry send at once (packing.py)."""
PINGS = 4
"""The most different pings that a board has; an answer says which of them it answers."""
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
    """`payload`: the shape that gives its size, or a number of bytes."""
    return Record("latest", name, readers, payload if isinstance(payload, int) else payload.most, 2)


def _ring(name: str, payload: Shape | int, cells: int, readers: str) -> Record:
    return Record("ring", name, readers, payload if isinstance(payload, int) else payload.most, cells)


def _beat() -> tuple[Record, ...]:
    """The records for the heartbeat of a process (heartbeat.py)."""
    return (
        _word("beat_ns", "everyone"),  # CLOCK_MONOTONIC of the last turn of its loop
        _word("beat_worst_ns", "everyone"),  # longest time between two turns
        _word("beat_pid", "everyone"),
        _word("beat_cpu_ns", "everyone"),  # processor time that it had used at that turn
        _word("beat_state", "everyone"),  # heartbeat.BEAT_STARTING, BEAT_RUNNING, BEAT_STOPPING
        _word("beat_rights", "everyone"),  # heartbeat.REALTIME | MEMORY_LOCKED | EARLY_NEWS
    )


FEWER: dict[str, int] = {"sensed": 64, "attended": 96}
"""Sizes of client records that never fill their shape."""


def _client(index: int) -> SegmentSpec:
    return SegmentSpec(
        f"client.{index}",
        "the client that holds the slot's claim",
        CLIENTS_WRITE,
        (
            _latest("left", records.LEFT, "gate"),  # earlier clients' goodbyes, kept when the slot is taken
            Record("futexes", "held", "gate", LINE_BYTES),  # by a thread of the client
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
            _latest("latch", records.LATCH, "port_owner, gate, clients"),  # the latch, or the one before
            _latest("link", 32, "gate, clients"),  # whether the board answers (ASCII)
            _latest("rules", 512, "clients"),  # the settings that clients need (msgpack), written once
            _latest("settings", 16384, "clients"),  # every setting of this run by its whole key (msgpack)
            # The processes to watch (records.life): the newest of each.
            *(_word(f"{process}_life", "port_owner") for process in (GATE, TELEMETRY, STOPPER)),
            _word("port_owner_life", "stopper"),
            _word("written_ns", "everyone"),  # when it last wrote a burst itself
            _word("resets", "gate"),  # the number of the newest reset that was decided
            _latest("reset", records.REPLY, "gate"),  # the answer to it (policy/causes.py)
            _latest("stop", 1024, "clients"),  # the last stop, as people see it (msgpack)
            _latest("processes", 2048, "clients"),  # the process table (msgpack)
            _ring("events", 512, 256, "clients"),  # events for people (msgpack, supervisor/events.py)
            _ring("box", box.OF_BEATS, box.BEATS_CELLS, "everyone"),  # beat ages, its own bursts (box.py)
        ),
    ),
    SegmentSpec(
        PORT_OWNER,
        PORT_OWNER,
        PUBLIC,
        (
            *_beat(),
            _latest("port", records.PORT, "supervisor, stopper, clients"),  # its state and path
            _word("stopped_epoch", "supervisor, stopper"),  # the newest epoch that it has answered with a stop
            _word("written_ns", "everyone"),  # when it last wrote a burst
            # 1 from before motion is written until a whole burst is, or its repeat: what it may have told the wheels.
            _word("moving", "supervisor, stopper"),
            _word("told_ns", "telemetry"),  # since when what it wrote tells the wheels to turn; 0: they are not told to
            _word("asked_ns", "supervisor"),  # when it last wrote a ping
            _ring("stops", records.STOPPED, 32, "supervisor"),  # every stop cause that it noticed, in order
            # What the board will answer or echo, with the time before each write. Holds more than GIVEN_UP_NS of pings
            # and of clients' questions.
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
            _latest("state", 4096, "telemetry, clients"),  # msgpack
            *(_latest(f"reply.{i}", records.REPLY, "the client of that slot") for i in range(CLIENT_SLOTS)),
            _word("resets_asked", "supervisor, its successor"),  # the number of the newest reset that was asked for
            _word("reset_asked_ns", "supervisor"),  # when that was asked for
            _word("busy", "supervisor, telemetry"),  # 1 while motion is enabled, a client is present, or an arm exists
            _word("limit", "its successor"),  # percent of the settings' speeds that it allows; 0: nobody has set one
            _ring("frames", records.FRAME, 64, "port_owner"),  # motion, stops, other frames for the wire
            _ring("stops", records.STOPPED, 32, "supervisor"),  # every stop cause that it noticed, in order
            _ring("notes", NOTE_BYTES, 32, "supervisor"),  # remarks for people (packing.py)
            _latest("said", 4096, "clients"),  # remarks of clients on themselves (msgpack, procs/gate/remarks.py)
            _ring("box", box.TICK, box.GATE_CELLS, "everyone"),  # every tick's command and decision (box.py)
            _ring("arm_box", box.ARM_BYTES, box.ARM_CELLS, "everyone"),  # the arm's aims, and whose (box.py)
        ),
    ),
    SegmentSpec(
        TELEMETRY,
        TELEMETRY,
        PUBLIC,
        (
            *_beat(),
            _latest("imu", records.IMU, "clients"),  # corrected, the rate less its bias
            _latest("wheels", records.WHEELS_SEEN, "gate, supervisor, clients"),  # what is known of them now
            _latest("battery", records.BATTERY, "clients"),
            _latest("odometry", records.ODOMETRY, "its successor, clients"),
            _word("port_number", "supervisor"),  # of the port that it reads; 0: it has none
            _word("restarts", "port_owner"),  # so often the board was seen to restart
            _latest("answered", records.PROVED, "supervisor, its successor"),  # the newest ping that was answered
            _latest("proved", records.PROVED, "supervisor"),  # the newest stop that the board has obeyed
            _word("unheeded_ns", "supervisor, clients"),  # since when it obeys zeros by its own word, told to move
            _word("said_ns", "supervisor, clients"),  # when the board said anything last; 0: never
            # How long it may say nothing; 0: it speaks only when asked, or nobody knows yet.
            _word("patience_ns", "supervisor, its successor"),
            _word("still_ns", "supervisor"),  # since when the IMU says that the wheels are still; 0: it shakes
            _word("judged_ns", "supervisor"),  # the last IMU sample that still_ns is judged from; 0: none yet
            _latest("scale", 1024, "clients"),  # measured over told: wheels, turn, what is wrong, remarks (msgpack)
            _latest("health", records.HEALTH, "supervisor, gate, clients"),
            _latest("bias", records.BIAS, "its successor, clients"),
            _latest("pad", records.PAD, "clients"),
            _latest("pad_arm", records.PAD_ARM, "gate"),  # one a frame while the pad moves a joint
            _latest("pad_command", records.PAD_COMMAND, "gate"),  # one a frame while the pad drives
            # The causes that it stops for, in order; empty: write the stop again, without a cause.
            _ring("causes", 64, 8, "port_owner"),
            _ring("servos", records.SERVO, 64, "gate"),  # answers of the arm's servos, in order
            _ring("pad_requests", records.PAD_REQUEST, 32, "gate"),  # resets, and frames that are not motion, in order
            _ring("notes", NOTE_BYTES, 32, "supervisor"),  # remarks for people (packing.py)
            _ring("received", 512, 512, "everyone"),  # bytes from the board, in order; about 4 s of them
            _ring("box", box.BOARD_BYTES, box.BOARD_CELLS, "everyone"),  # the reports that it decoded (box.py)
        ),
    ),
    SegmentSpec(
        STOPPER,
        STOPPER,
        PUBLIC,
        (
            *_beat(),
            _word("written_ns", "everyone"),  # when it last wrote a burst
            _word("port_number", "supervisor"),  # of the port that it holds; 0: it holds none
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
"""A hash of all declarations above: processes with different layouts refuse each other. Raise LAYOUT_VERSION when a
payload format in records.py changes without any size changing."""

CLIENT_VERSION = 1
"""Raise it if the library of clients/c must be rebuilt although the size and place of its records are the same: because
a value, or a key in `state`, `rules` or `settings`, means something else."""
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
"""The records that the C library reads or writes, with the shapes of those that have one. A library outlives an upgrade
of the service as long as nothing here changes."""
_OF_LIBRARY = f"client {CLIENT_VERSION}\n" + "\n".join(
    f"{name} {r.kind} {r.name} {r.capacity} {r.cells} {SEGMENT_BY_NAME[name].offsets[r.name]} {shape and shape.form}"
    for name, used in OF_LIBRARY.items()
    for r, shape in ((SEGMENT_BY_NAME[name].records[record], shape) for record, shape in used.items())
)
CLIENT_HASH = crc32(_OF_LIBRARY.encode()) << 32 | crc32(_OF_LIBRARY.encode(), 0x5AFE)
"""A hash of the records that the C library touches; each segment's header has it, next to the hash of the layout."""
