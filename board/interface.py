"""What gate, port owner, stopper and supervisor need of a motor board, and the one that is built in.

A second board is a second class of this form, in a module of its own (docs/dev/porting.md).
"""

from __future__ import annotations

from failstop.board import burst, codec, decoder, peripherals, servos
from failstop.board.burst import FIRST_STOP_END

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from typing import Protocol

    class Board(Protocol):
        """The board's language, as far as motion goes: constants and pure functions."""

        @property
        def stop(self) -> bytes:
            """The frame that sets every wheel to zero: the very bytes of motor_speeds with zeros."""

        @property
        def burst(self) -> bytes:
            """One write that stops the wheels whatever state the board's receiver is in."""

        @property
        def first_stop(self) -> bytes:
            """The beginning of the burst, up to its first stop frame."""

        @property
        def pings(self) -> tuple[bytes, ...]:
            """As many frames as layout.PINGS that move nothing and are answered, in order with all others; all
            different, so that an answer says which of them it answers. Or none."""

        def motor_speeds(self, rps: Sequence[float], max_rps: float) -> bytes:
            """The frame that sets all wheels, in rps by wire id, each within plus or minus max_rps. Raises FrameError,
            for a speed that is not finite too."""

        def check_motion(self, frame: bytes, max_rps: float) -> str:
            """Why these bytes must not be written as a motion frame; "" when they may. Never raises on bytes."""

        def check_aux(self, frame: bytes) -> str:
            """Why these bytes must not be written as another frame; "" when they may. No motion passes, and no servo's
            frame."""

        def burst_with(self, servos: Sequence[int]) -> bytes:
            """The burst, and in the same write behind it what stops these servos of an arm; for none the burst."""

        def servo_move(self, positions: Sequence[tuple[int, int]], duration_ms: int, longest_ms: int) -> bytes:
            """The frame that moves a few servos, (id, pulses) each, in that time. Raises FrameError."""

        def servo_read(self, servo: int, what: int) -> bytes:
            """The frame that asks a servo for one of servos.READS. Raises FrameError."""

        def servo_torque(self, servo: int, on: bool) -> bytes:
            """The frame that switches a servo's torque. Raises FrameError."""

        def check_servos(self, frame: bytes, servos: Collection[int], longest_ms: int) -> str:
            """Why these bytes must not be written as a frame for an arm of these servos; "" when they may. What passes
            holds the board's receiver for no longer than servos.HELD_NS, unless it asks a question."""

        def servo_ns(self, frame: bytes) -> int:
            """How long a frame that has passed holds the receiver at most."""

        def pong(self, func: int, data: bytes) -> int | None:
            """The index in `pings` of the one that a frame from the board answers, None if it answers none."""


class RosController:
    """The STM32 controller board of board/codec.py."""

    __slots__ = ()

    stop = codec.STOP
    burst_with = staticmethod(burst.burst_with)
    burst = burst.BURST
    first_stop = burst[:FIRST_STOP_END]
    pings = tuple(peripherals.pwm_servo_read(servo) for servo in (1, 2, 3, 4))
    motor_speeds = staticmethod(codec.motor_speeds)
    check_motion = staticmethod(codec.check_motion)
    check_aux = staticmethod(peripherals.check_aux)
    servo_move = staticmethod(servos.bus_servo_move)
    servo_read = staticmethod(servos.bus_servo_read)
    servo_torque = staticmethod(servos.bus_servo_torque)
    check_servos = staticmethod(servos.check_bus)
    servo_ns = staticmethod(servos.frame_ns)
    pong = staticmethod(decoder.pong)


BOARD: Board = RosController()
