"""Servos: the commands to an arm's servos, and the time limits that every board keeps.

A servo completes a timed move by itself, even if every program has died since. So a move lasts at most LONGEST_MOVE_MS,
and a longer movement is made of many short moves.
"""

from __future__ import annotations

from failstop.board.wire import Sample
from failstop.data import Data

SERVO_MOVE = 0x01
SERVO_STOP = 0x03
POSITION = 0x05
SUPPLY = 0x07
TEMPERATURE = 0x09
TORQUE_OFF = 0x0B
TORQUE_ON = 0x0C
TORQUE = 0x0D
READS = (POSITION, SUPPLY, TEMPERATURE, TORQUE)

HIGHEST_ID = 253
LONGEST_MOVE_MS = 60
LONGEST_MOVE_NS = LONGEST_MOVE_MS * 1_000_000

HELD_NS = 2_000_000
"""The longest time that a stop may have to wait for the servos' bus, in ns."""
MOVE_NS = 870_000
"""How long the command that moves one servo takes on the servos' bus at most, with any board, in ns. It is a packet of
ten bytes, sent at 115200 baud."""
SILENT_NS = 5_000_000
"""The longest time that any board waits for a servo's answer, in ns. A normal answer takes 1.2 ms."""
MOST_MOVES = HELD_NS // MOVE_NS


class ServoAnswer(Sample, Data):
    """A servo's answer: the servo's id, the question (one of READS), and the value. A position is in pulses, a supply
    in mV, and a temperature in degrees Celsius. A torque is 1 (on) or 0 (off). A position, supply or temperature of 0
    means that nothing was read, because some boards answer 0 for a silent servo."""

    servo: int
    what: int
    value: int
