"""Frames as a board reports them after a fault."""

from __future__ import annotations

from failstop.board.rrc.codec import STOP, motor_speeds
from failstop.board.rrc.framing import MOTOR
from failstop_lab.sim.client import Event

MS = 1_000_000
FAULT_NS = 10_000 * MS
STILL = (0.0, 0.0, 0.0, 0.0)
TURNING = (0.5, 0.5, -0.5, -0.5)


def event(index: int, ms: float, speeds: tuple[float, float, float, float]) -> Event:
    """A motor frame that the board got so long after the fault."""
    at_ns = FAULT_NS + round(ms * MS)
    frame = motor_speeds(speeds, 1.0) if any(speeds) else STOP
    return Event(index, at_ns, at_ns + MS // 2, MOTOR, frame[4:-1], speeds)
