"""The black box records what each process except the stopper has done in about the last minute. The records are in
shared memory, in rings named `box`, and are saved with each stop. This module defines the payloads of these rings.

Each ring is in its writer's segment, so it can be read after the writer has died. Readers never delay the writer. A
process adds the entry about a stop only after it has written the stop, so the entry never delays the stop.
"""

from __future__ import annotations

import struct

from failstop.messages import records
from failstop.messages.records import Payload, Shape

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

SECONDS = 60
"""How many seconds each ring covers if its writer runs at its normal rates."""
GATE_CELLS = 3072
"""How many entries the gate's ring holds. The gate adds 50 entries per second, one in each of its ticks."""
WIRE_CELLS = 4096
"""How many entries the ring of bytes for the board holds. Normally there are at most 50 motion frames, 2 pings and a
few stops per second. If a client drives at 100 Hz, there are 100 motion frames, so the ring covers only 40 s."""
BOARD_CELLS = 8192
"""How many entries the ring of the board's reports holds. Each second there are 110 IMU samples, 20 gamepad frames and
one battery reading."""
ARM_CELLS = 640
"""How many entries the arm's ring holds. The gate adds 10 entries per second while a client moves the arm, and one more
whenever the goal changes."""
BEATS_CELLS = 768
"""How many entries the ring of the processes' heartbeats holds. The supervisor adds 10 entries per second, and one more
at each stop."""

COPY_NS = 2_200_000_000
"""How long after a stop the rings are copied, at the earliest. With the default settings, nothing more becomes known
about a stop after 2.0 s (supervisor/proof.py)."""
JUDGED_NS = 700_000_000
"""How long after the end of still.after_s the rings are copied. By then, the verdict about the wheels is logged."""
LONGEST_COPY_NS = 15_000_000_000
"""How long after a stop the rings are copied, at the latest. A later copy would lose too much from before the stop."""

ARM_BYTES = 80
SHORT_WHO_BYTES = 36

LATCHED = "estop: "
"""If a stop is latched, the gate's reason why nothing moves begins with this. The cause of that stop follows."""
DISABLED = "disabled"
NO_COMMAND = "cmd timeout"
NO_SCAN = "no scan"
HELD = "let go first"
EVERY_BLOCK = (LATCHED, DISABLED, HELD, NO_COMMAND, NO_SCAN)
"""All reasons why nothing moves. If several apply, the gate reports the first one in this list."""
DECISIONS = ("driving", "estop", DISABLED, NO_COMMAND, NO_SCAN, HELD)
"""The gate's possible decisions. Each entry in the gate's ring has the index of the decision in this tuple."""
DECISION = {"": 0, DISABLED: 2, NO_COMMAND: 3, NO_SCAN: 4, HELD: 5}
ENABLED, MANUAL, DRIVES = 1, 2, 4
"""Flags of a gate tick. ENABLED: motion is enabled. MANUAL: a person has sent the tick's command. DRIVES: the tick's
command is the one that drives."""

WIRE_BURST, WIRE_FRAME, WIRE_REST = range(1, 4)
"""Kinds of entries about bytes for the board. WIRE_BURST: a stop burst. WIRE_FRAME: one frame; the entry has its first
bytes. WIRE_REST: the remaining bytes of a burst or frame of which the kernel first took only a part."""
WIRE_HEAD = 39
"""How many bytes of each frame are kept. A motor frame for four wheels has 27 bytes, and steering adds at most 12."""

IMU_KIND, BATTERY_KIND, PAD_KIND, SERVO_KIND, WHEELS_KIND = range(1, 6)

ARM_MODES = ("", "trajectory", "follow", "jog")
"""The ways to move the arm. Empty: nothing moves the arm from that entry on, until the next entry."""

SILENCES = 1
OWN_BURST = 2
"""Marks an entry in the ring of heartbeats that is not about heartbeats: the supervisor itself has written a stop
burst, on its own descriptor. Such an entry has only its time, and no values."""
MOST_U32 = 0xFFFFFFFF

MOST_SPEEDS = 5
"""The most numbers that a frame for the board has: a speed for each of four wheels, and on a steered base the steering
angle in rad as the last number."""
TICK = Shape(f"<IBBBBI3f3f{MOST_SPEEDS}f16s", records.rest(SHORT_WHO_BYTES))
"""One tick of the gate, with the values that unpack_gate() describes. The entry always has room for MOST_SPEEDS speeds,
so the same layout fits every board. It also has the number of speeds that are used."""
WIRE: Payload[int, int, int, bytes] = Payload("<BHH", records.rest(WIRE_HEAD))
"""An entry about bytes for the board. It has the kind of the entry, how many bytes were to be written, how many of
these the kernel accepted, and for WIRE_FRAME the first bytes of the frame."""
REPORTS: dict[int, Shape] = {
    IMU_KIND: Shape("<6f"),
    BATTERY_KIND: records.BATTERY,
    PAD_KIND: records.PAD,
    SERVO_KIND: records.SERVO,
    WHEELS_KIND: Shape(f"<{records.MOST_WHEELS}f"),
}
"""The shape of each kind of report from the board, after telemetry has decoded it. In an entry, a byte with the kind
comes first. An IMU sample has the same values as the record `imu` of telemetry. WHEELS_KIND has the speed of each wheel
in turns per second, by wire id (NaN if not reported)."""
BOARD_BYTES = 1 + max(shape.most for shape in REPORTS.values())
OF_BEATS = Shape("<B10I")
_ARM = struct.Struct("<BB")
_AIM = struct.Struct("<Bf")


def copy_ns(still_after_ns: int) -> int:
    """How long after a stop the rings are copied, ns. `still_after_ns`: the setting still.after_s."""
    return min(max(COPY_NS, still_after_ns + JUDGED_NS), LONGEST_COPY_NS)


def single(value: float) -> float:
    """Limit a value to a range that fits into a four-byte float, because a client may send any double. NaN stays
    NaN."""
    return min(max(value, -3e38), 3e38)


def pack_wire(kind: int, data: bytes, taken: int) -> bytes:
    """Make an entry about bytes for the board. `kind`: WIRE_BURST, WIRE_FRAME or WIRE_REST. `taken`: how many of the
    bytes the kernel took; 0 if the port was full."""
    return WIRE.pack(kind, min(len(data), 65535), min(taken, 65535), data[:WIRE_HEAD] if kind == WIRE_FRAME else b"")


def pack_board(kind: int, *values: float | None) -> bytes:
    """Make an entry about a report of the board. `values`: the values for this kind, as in REPORTS."""
    return bytes((kind,)) + REPORTS[kind].pack(*values)


def unpack_board(payload: bytes) -> tuple[int, tuple[Any, ...]]:
    """Return (kind, values) of an entry that pack_board() has made. Raises ValueError if it is damaged."""
    if not payload or payload[0] not in REPORTS:
        raise ValueError(f"a record of the board of {len(payload)} bytes, of no known kind")
    return payload[0], REPORTS[payload[0]].unpack(payload[1:])


def pack_arm(mode: str, who: str, aims: list[tuple[int, float]]) -> bytes:
    """Make an entry about where the arm must go, and for whom. `aims`: pairs of a servo's id and its aim. In mode
    follow, an aim is the position that the client wants at present, in pulses. In jog it is a rate in pulses/s, and in
    trajectory the last position in pulses."""
    aims = aims[: records.MOST_JOINTS]
    head = _ARM.pack(ARM_MODES.index(mode), len(aims)) + b"".join(_AIM.pack(servo, single(aim)) for servo, aim in aims)
    return head + who.encode("utf-8", "replace")[: ARM_BYTES - len(head)]


def unpack_arm(payload: bytes) -> tuple[str, str, dict[int, float]]:
    """Return (mode, who, the aim of each servo) of an entry that pack_arm() has made. Raises ValueError if it is
    damaged."""
    mode, count = _ARM.unpack_from(payload) if len(payload) >= _ARM.size else (255, 0)
    end = _ARM.size + count * _AIM.size
    if mode >= len(ARM_MODES) or len(payload) < end:
        raise ValueError(f"a record of the arm of {len(payload)} bytes, of no known form")
    aims = dict(_AIM.unpack_from(payload, at) for at in range(_ARM.size, end, _AIM.size))
    return ARM_MODES[mode], payload[end:].decode("utf-8", "replace"), aims


def pack_beats(silent_us: list[int], before_us: list[int]) -> bytes:
    """Make an entry about heartbeats. Both lists have a time in microseconds for each process of layout.PROCESS_NAMES.
    `silent_us`: its longest silence since the previous entry. `before_us`: how long before this entry that silence was
    seen."""
    return OF_BEATS.pack(SILENCES, *(min(max(0, time_us), MOST_U32) for time_us in (*silent_us, *before_us)))


OWN_BURST_RECORD = bytes((OWN_BURST,))


def unpack_gate(payload: bytes) -> dict[str, Any]:
    """The values of one tick of the gate, by name. Raises ValueError if the entry is damaged.

    The command of a tick is the newest one, or one that drives and has no tick yet. `block` is one of DECISIONS.
    `commands` counts the commands since the tick before. `age_us` is the age of the command; None if there was no
    command yet. `command` is the velocity that the client asks for, and `velocity` is the velocity that the gate
    commands. `wheels_rps` has the wheel speeds in turns per second, by wire id. `source` is the source of the command,
    and `who` is the client that sent it.
    """
    epoch, block, flags, commands, speeds, age_us, *numbers, source, who = TICK.unpack(payload)
    return {
        "epoch": epoch,
        "block": DECISIONS[block] if block < len(DECISIONS) else f"unknown {block}",
        "enabled": bool(flags & ENABLED),
        "manual": bool(flags & MANUAL),
        "drives": bool(flags & DRIVES),
        "commands": commands,
        "age_us": None if age_us == MOST_U32 else age_us,
        "command": tuple(numbers[:3]),
        "velocity": tuple(numbers[3:6]),
        "wheels_rps": tuple(numbers[6 : 6 + speeds]),
        "source": source.rstrip(b"\0").decode("ascii", "replace"),
        "who": who.decode("utf-8", "replace"),
    }


def unpack_beats(payload: bytes) -> tuple[tuple[int, int], ...]:
    """Return (silent_us, before_us) for each process of layout.PROCESS_NAMES. Empty for a stop burst of the supervisor
    (OWN_BURST). Raises ValueError if the entry is damaged."""
    if payload == OWN_BURST_RECORD:
        return ()
    kind, *times = OF_BEATS.unpack(payload)
    if kind != SILENCES:
        raise ValueError(f"a record of beats of the kind {kind}")
    return tuple(zip(times[:5], times[5:], strict=True))
