"""Frames that the simulated board's tests share."""

from __future__ import annotations

from failstop.board.rrc import codec

FORWARD = (0.796, 0.796, -0.796, -0.796)
DRIVE = codec.motor_speeds(FORWARD, 2.0)
