"""Servos: the commands to an arm's servos, and the time limits that every board keeps.

A servo completes a timed move by itself, whatever has died since. So a move lasts LONGEST_MOVE_MS at most, and a long
way is a stream of such moves.
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
"""The longest time that a stop may have to wait for the servos' bus."""
MOVE_NS = 870_000
"""The longest time that the move of one servo takes on any board's bus: ten bytes at 115200 baud."""
SILENT_NS = 5_000_000
"""After this time every board has given up on a servo that does not answer. An answer takes 1.2 ms."""
MOST_MOVES = HELD_NS // MOVE_NS


class ServoAnswer(Sample, Data):
    """An arm's servo, the question (one of READS) and the answer: position in pulses, supply in mV, temperature in
    degrees Celsius, torque 1 for on. A 0 is no reading, except for the torque, because some boards answer 0 when a
    servo did not answer."""

    servo: int
    what: int
    value: int
