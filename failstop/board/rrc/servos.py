"""Frames to the bus servos of an arm, and a function that checks these frames before they are written.

The firmware handles a servo's frame inside its receive task. So every later frame, even a stop, waits until the servos'
own bus (115200 baud) has taken the servo's frame. Most frames hold up the receiver for HELD_NS at most. Questions may
take longer, because failstop asks the servos nothing while a wheel may turn.

A servo completes a timed move by itself, even if every program has died since. So a move lasts at most LONGEST_MOVE_MS,
and a longer movement is made of many short moves.

The sub-commands 10, 20, 24, 30, 34 and 38 (hexadecimal) write a servo's flash or its id (firmware source). failstop
never makes these commands, and check_bus() refuses them.
"""

from __future__ import annotations

from math import tau
from struct import Struct

from failstop.board import checks
from failstop.board.checks import FrameError
from failstop.board.rrc import framing
from failstop.board.rrc.framing import BUS_SERVO, HEAD, crc8, frame
from failstop.board.servos import (
    HELD_NS,
    HIGHEST_ID,
    LONGEST_MOVE_MS,
    MOST_MOVES,
    MOVE_NS,
    READS,
    SERVO_MOVE,
    SERVO_STOP,
    SILENT_NS,
    TORQUE_OFF,
    TORQUE_ON,
)

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

EVERY_SERVO = 254
"""The address of all servos at once. Test a command to this address on a stand before you use it on a robot."""
HIGHEST_POSITION = 1000
PULSES_PER_RAD = 1500 / tau
"""How many pulses make a radian. A pulse is 0.24 degrees."""
STOP_NS = 521_000
"""How long the stop of one servo takes on the servos' bus, in ns. It is a packet of six bytes."""
TORQUE_NS = 610_000
"""How long a torque command takes on the servos' bus, in ns. It is a packet of seven bytes."""
MOST_STOPS = HELD_NS // STOP_NS

_U16 = Struct("<H")
_ID_U16 = Struct("<BH")
_MOVES_AT = 4


def held_ns(frame: bytes) -> int:
    """Return how long a servo's frame holds up the receiver at most, in ns. Call this only for a frame whose form and
    number of servos have been checked."""
    data = frame[4:]
    if data[0] == SERVO_MOVE:
        return MOVE_NS * data[3]
    if data[0] == SERVO_STOP:
        return STOP_NS * data[1]
    return TORQUE_NS if data[0] in (TORQUE_OFF, TORQUE_ON) else SILENT_NS


def _id(servo: int, highest: int = HIGHEST_ID) -> int:
    return checks.integer("servo id", servo, 1, highest)


def bus_servo_move(positions: Sequence[tuple[int, int]], duration_ms: int, longest_ms: int = LONGEST_MOVE_MS) -> bytes:
    """Return the frame that moves one or two bus servos, each given as (id 1 to 253, position 0 to 1000). The move
    takes duration_ms, from 1 to longest_ms. Raises FrameError.

    The duration may be a few milliseconds longer, or shorter if it would exceed longest_ms. Otherwise the zeros of the
    stop burst might complete a cut frame. The last servo in the frame, or a servo with the id 0, would then move to a
    wrong position.
    """
    checks.integer("duration_ms", duration_ms, 1, longest_ms)
    data = bytes((checks.counted("moves", positions, 1, MOST_MOVES),))
    for move in positions:
        checks.group("move", move, 2)
        data += _ID_U16.pack(_id(move[0]), checks.integer("position", move[1], 0, HIGHEST_POSITION))
    checks.distinct("servo id", [move[0] for move in positions])
    for duration in (*range(duration_ms, longest_ms + 1), *range(duration_ms - 1, 0, -1)):
        made = bytes((SERVO_MOVE,)) + _U16.pack(duration) + data
        if not _zeros_complete(made):
            return frame(BUS_SERVO, made)
    raise FrameError(f"moves {positions!r} within {longest_ms} ms: zeros would complete every frame for it")


def bus_servo_stop(servos: Sequence[int]) -> bytes:
    """Return the frame that stops up to three bus servos (ids 1 to 253, or EVERY_SERVO) where they are. Their torque
    stays on. Raises FrameError.

    If the frame is cut short, the zeros of the stop burst may complete it. It then stops only some of these servos, and
    also a servo with the id 0. bus_servo_move() prevents this for a move by changing the duration a little. But a stop
    has no number that could be changed.
    """
    count = checks.counted("servos", servos, 1, MOST_STOPS)
    ids = bytes([_id(servo, EVERY_SERVO) for servo in servos])
    checks.distinct("servo id", ids)
    return frame(BUS_SERVO, bytes((SERVO_STOP, count)) + ids)


def bus_servo_stops(servos: Sequence[int]) -> tuple[bytes, ...]:
    """Return as many frames as are needed to stop all these servos."""
    return tuple(bus_servo_stop(servos[at : at + MOST_STOPS]) for at in range(0, len(servos), MOST_STOPS))


def bus_servo_read(servo: int, what: int) -> bytes:
    """Return the frame that asks a bus servo for its POSITION (usually 0 to 1000), SUPPLY (mV), TEMPERATURE (degrees
    Celsius) or TORQUE (1 means on)."""
    if what not in READS:
        raise FrameError(f"what is {what!r}, must be one of {READS}")
    return frame(BUS_SERVO, bytes((what, _id(servo))))


def bus_servo_torque(servo: int, on: bool) -> bytes:
    """Return the frame that switches a bus servo's torque on (sub-command 0C) or off (0B). The vendor's SDK mixes up
    the two. Raises FrameError."""
    if not isinstance(on, bool):
        raise FrameError(f"on is {on!r}, must be True or False")
    return frame(BUS_SERVO, bytes((TORQUE_ON if on else TORQUE_OFF, _id(servo))))


def check_bus(frame: bytes, servos: Collection[int], longest_ms: int) -> str:
    """Return the reason to refuse these bytes for these bus servos, in a few words, or "" to accept them. It accepts
    only frames that this module makes. Never raises."""
    size = len(frame)
    if size < 5 or frame[:2] != HEAD or frame[2] != BUS_SERVO:
        return "not a bus servo's frame"
    if size != frame[3] + 5:
        return f"{size} bytes, its length byte says {frame[3] + 5}"
    if crc8(frame[2:]):
        return "bad crc"
    data = frame[4:-1]
    if not data:
        return "no sub-command"
    command = data[0]
    if command == SERVO_MOVE:
        ids = data[_MOVES_AT::3]
        fault = _move_fault(data, longest_ms)
    elif command == SERVO_STOP:
        ids = data[2:]
        fault = "" if len(data) > 2 and data[1] == len(ids) else "a count that is not its data's"
    elif command in READS or command in (TORQUE_OFF, TORQUE_ON):
        ids = data[1:]
        fault = "" if len(ids) == 1 else f"{len(ids)} servos, must be 1"
    else:
        return f"bus servo sub-command {command:02X}"
    if fault:
        return fault
    if command not in READS and (longest_ns := held_ns(frame)) > HELD_NS:
        return f"{len(ids)} servos hold the receiver for {longest_ns / 1e6:.1f} ms, limit {HELD_NS / 1e6:g}"
    if len(set(ids)) < len(ids):
        return "a servo twice"
    strange = next((f"servo {servo} is none of the arm's" for servo in ids if servo not in servos), "")
    return strange or (_zeros_complete(data) if command == SERVO_MOVE else "")


def moves(frame: bytes) -> list[tuple[int, int, int]]:
    """Return (id, position, duration in ns) for each servo that a frame moves. Empty for other bytes. Never raises."""
    data = frame[4:-1]
    if frame[:3] != HEAD + bytes((BUS_SERVO,)) or not data or data[0] != SERVO_MOVE or _move_fault(data, 0xFFFF):
        return []
    takes_ns = _U16.unpack_from(data, 1)[0] * 1_000_000
    return [(servo, position, takes_ns) for servo, position in _ID_U16.iter_unpack(data[_MOVES_AT:])]


def _move_fault(data: bytes, longest_ms: int) -> str:
    """Return the fault in the data of a move, or "". The ids of the servos are not checked."""
    if len(data) <= _MOVES_AT or len(data) != _MOVES_AT + 3 * data[3]:
        return "a count that is not its data's"
    duration_ms: int = _U16.unpack_from(data, 1)[0]
    if not 1 <= duration_ms <= longest_ms:
        return f"a move of {duration_ms} ms, limit {longest_ms}"
    for at in range(_MOVES_AT, len(data), 3):
        position: int = _U16.unpack_from(data, at + 1)[0]
        if position > HIGHEST_POSITION:
            return f"position {position}, limit {HIGHEST_POSITION}"
    return ""


def _zeros_complete(data: bytes) -> str:
    """Return a text that names the first cut of this move after which zeros would complete a wrong move, or "" if there
    is none. In a wrong move, a servo goes to a wrong position, or a servo with the id 0 moves. A cut before the number
    of servos is harmless, because the completed frame moves no servo."""
    end = framing.zeros_complete(BUS_SERVO, data, _MOVES_AT)
    return f"another move if cut after {end} bytes of data" if end else ""
