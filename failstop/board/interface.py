"""Interface: the things that gate, port owner, stopper and supervisor need of a motor board; and the built-in board.

A second board is a second class with all of these, in a module of its own (docs/dev/porting.md).
"""

from __future__ import annotations

from failstop.board import codec, decoder, servos
from failstop.board.burst import BURST, FIRST_STOP_END, burst_with


class Board:
    """The board's language, as far as motion goes: constants and pure functions. This one's is the STM32 controller's
    (codec.py)."""

    __slots__ = ()

    stop = codec.STOP
    """The frame that sets every wheel to zero: the very bytes of motor_speeds with zeros."""
    burst = BURST
    """One write that stops the wheels whatever state the board's receiver is in."""
    first_stop = BURST[:FIRST_STOP_END]
    """The beginning of the burst, up to its first stop frame."""
    burst_with = staticmethod(burst_with)
    """(servos): the burst, and in the same write behind it what stops these servos of an arm; for none the burst."""
    pings = tuple(codec.pwm_servo_read(servo) for servo in (1, 2, 3, 4))
    """As many frames as layout.PINGS that move nothing and are answered, in order with all others; all different, so
    that an answer says which of them it answers. Or none."""
    pong = staticmethod(decoder.pong)
    """(func, data): the index in `pings` of the one that a frame from the board answers, None if it answers none."""
    motor_speeds = staticmethod(codec.motor_speeds)
    """(rps, max_rps): the frame that sets all wheels, in rps by wire id, each within plus or minus max_rps. Raises
    FrameError, for a speed that is not finite too."""
    check_motion = staticmethod(codec.check_motion)
    """(frame, max_rps): why these bytes must not be written as a motion frame; "" when they may. Never raises on
    bytes."""
    check_aux = staticmethod(codec.check_aux)
    """(frame): the same of another frame. No motion passes, and no servo's frame."""
    servo_move = staticmethod(servos.bus_servo_move)
    """(positions, duration_ms, longest_ms): the frame that moves a few servos, (id, pulses) each, in that time. Raises
    FrameError."""
    servo_read = staticmethod(servos.bus_servo_read)
    """(servo, what): the frame that asks a servo for one of servos.READS. Raises FrameError."""
    servo_torque = staticmethod(servos.bus_servo_torque)
    """(servo, on): the frame that switches a servo's torque. Raises FrameError."""
    check_servos = staticmethod(servos.check_bus)
    """(frame, servos, longest_ms): why these bytes must not be written as a frame for an arm of these servos; "" when
    they may. What passes holds the board's receiver for no longer than servos.HELD_NS, unless it asks a question."""
    servo_ns = staticmethod(servos.frame_ns)
    """(frame): how long a frame that has passed holds the receiver at most."""


BOARD = Board()
