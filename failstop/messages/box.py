"""The black box: the payloads of the rings `box`, in which each process except the stopper keeps about its last minute.

Each ring is in its writer's own segment, so it outlives the writer, and reading it disturbs nobody. A put is one cell
of private bytes and one slice assignment. On the stop path it comes after the bytes of the stop.
"""

from __future__ import annotations

import struct

from failstop.messages import records
from failstop.messages.records import Payload, Shape

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

SECONDS = 60
"""The time that each ring covers, at its writer's default rates."""
GATE_CELLS = 3072
"""The number of entries in the gate's ring: one for each tick, 50 per second."""
WIRE_CELLS = 4096
"""The number of entries for bytes on the wire: up to 50 motion frames, 2 pings and a few stops per second. A client
that drives at 100 Hz fills the ring in 40 s."""
BOARD_CELLS = 8192
"""The number of entries for the board's reports: 110 IMU samples, 20 gamepad frames and a battery reading per
second."""
ARM_CELLS = 640
"""The number of entries for the arm: 10 per second while a client moves it, and one at each change."""
BEATS_CELLS = 768
"""The number of entries for the beats: 10 per second, and one more at each stop."""

ARM_BYTES = 80
SHORT_WHO_BYTES = 36

LATCHED = "estop: "
"""How the gate's reason for a latched stop begins, also in its record. The reason of the latch follows."""
DISABLED = "disabled"
NO_COMMAND = "cmd timeout"
NO_SCAN = "no scan"
HELD = "let go first"
EVERY_BLOCK = (LATCHED, DISABLED, HELD, NO_COMMAND, NO_SCAN)
"""All blocks. The first one that applies is reported."""
DECISIONS = ("driving", "estop", DISABLED, NO_COMMAND, NO_SCAN, HELD)
"""The gate's decisions. The record has the index."""
DECISION = {"": 0, DISABLED: 2, NO_COMMAND: 3, NO_SCAN: 4, HELD: 5}
ENABLED, MANUAL, DRIVES = 1, 2, 4
"""Flags of a tick. DRIVES: the newest command is the one that drives, so it does not wait behind a higher source."""

WIRE_BURST, WIRE_FRAME, WIRE_REST = range(1, 4)
"""Bytes for the board: the stop burst; one frame, with its first bytes; what the kernel had not taken of either."""
WIRE_HEAD = 39
"""How many bytes of a frame are kept. A motor frame for four wheels has 27, and steering adds at most 12."""

IMU_KIND, BATTERY_KIND, PAD_KIND, SERVO_KIND, WHEELS_KIND = range(1, 6)

ARM_MODES = ("", "trajectory", "follow", "jog")
"""The modes of an arm's goal; empty: from now on nobody moves the arm."""

SILENCES = 1
OWN_BURST = 2
"""The flag of a burst that the supervisor wrote on its own descriptor, at the time of the entry."""
MOST_U32 = 0xFFFFFFFF

MOST_SPEEDS = 5
"""The most speeds in a frame for the board. On a steered base the last is the steering angle in rad."""
TICK = Shape(f"<IBBBBI3f3f{MOST_SPEEDS}f16s", records.rest(SHORT_WHO_BYTES))
"""A tick of the gate; unpack_gate() describes it. It has room for the most speeds and says how many it holds, so that
records need no layout for each board."""
WIRE: Payload[int, int, int, bytes] = Payload("<BHH", records.rest(WIRE_HEAD))
"""Bytes for the board: WIRE_BURST or another kind; how many; how many of them the kernel took; the first bytes of a
frame."""
REPORTS: dict[int, Shape] = {
    IMU_KIND: Shape("<6f"),
    BATTERY_KIND: records.BATTERY,
    PAD_KIND: records.PAD,
    SERVO_KIND: records.SERVO,
    WHEELS_KIND: Shape(f"<{records.MOST_WHEELS}f"),
}
"""Reports that telemetry has decoded, by the kind that is their first byte. The IMU's is as published; the speed of
each wheel is in turns per second, by wire id (NaN: not reported)."""
BOARD_BYTES = 1 + max(shape.most for shape in REPORTS.values())
OF_BEATS = Shape("<B10I")
_ARM = struct.Struct("<BB")
_AIM = struct.Struct("<Bf")


def single(value: float) -> float:
    """The closest value that a four-byte float can hold, because a client's command may be any double. NaN stays
    NaN."""
    return min(max(value, -3e38), 3e38)


def pack_wire(kind: int, data: bytes, taken: int) -> bytes:
    """The record of bytes for the board. `kind`: WIRE_BURST or another; `taken`: how many the kernel took (0: none,
    because the port was full)."""
    return WIRE.pack(kind, min(len(data), 65535), min(taken, 65535), data[:WIRE_HEAD] if kind == WIRE_FRAME else b"")


def pack_board(kind: int, *values: float | None) -> bytes:
    """The record of a report of the board, with the values that REPORTS lists for its kind."""
    return bytes((kind,)) + REPORTS[kind].pack(*values)


def unpack_board(payload: bytes) -> tuple[int, tuple[Any, ...]]:
    """Return (kind, values) of such a record. Raises ValueError."""
    if not payload or payload[0] not in REPORTS:
        raise ValueError(f"a record of the board of {len(payload)} bytes, of no known kind")
    return payload[0], REPORTS[payload[0]].unpack(payload[1:])


def pack_arm(mode: str, who: str, aims: list[tuple[int, float]]) -> bytes:
    """The record of the arm's goal, and of the client that set it. For each servo: where it must end (trajectory) or be
    now (follow), in pulses, or its rate (jog), in pulses/s."""
    aims = aims[: records.MOST_JOINTS]
    head = _ARM.pack(ARM_MODES.index(mode), len(aims)) + b"".join(_AIM.pack(servo, single(aim)) for servo, aim in aims)
    return head + who.encode("utf-8", "replace")[: ARM_BYTES - len(head)]


def unpack_arm(payload: bytes) -> tuple[str, str, dict[int, float]]:
    """Return (mode, who, the goal of each servo). Raises ValueError."""
    mode, count = _ARM.unpack_from(payload) if len(payload) >= _ARM.size else (255, 0)
    end = _ARM.size + count * _AIM.size
    if mode >= len(ARM_MODES) or len(payload) < end:
        raise ValueError(f"a record of the arm of {len(payload)} bytes, of no known form")
    aims = dict(_AIM.unpack_from(payload, at) for at in range(_ARM.size, end, _AIM.size))
    return ARM_MODES[mode], payload[end:].decode("utf-8", "replace"), aims


def pack_beats(silent_us: list[int], before_us: list[int]) -> bytes:
    """The record of silences: for each of layout.PROCESS_NAMES the longest one since the last record, and how long ago
    it was seen."""
    return OF_BEATS.pack(SILENCES, *(min(max(0, time_us), MOST_U32) for time_us in (*silent_us, *before_us)))


OWN_BURST_RECORD = bytes((OWN_BURST,))


def unpack_gate(payload: bytes) -> dict[str, Any]:
    """A tick of the gate: epoch, block (a word of DECISIONS), enabled, manual, drives, commands (since the tick
    before), age_us (None: no command yet), command, velocity, wheels_rps (by wire id), source, who. Raises
    ValueError."""
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
    """Return (silent_us, before_us) for each of layout.PROCESS_NAMES; empty for a burst. Raises ValueError."""
    if payload == OWN_BURST_RECORD:
        return ()
    kind, *times = OF_BEATS.unpack(payload)
    if kind != SILENCES:
        raise ValueError(f"a record of beats of the kind {kind}")
    return tuple(zip(times[:5], times[5:], strict=True))
