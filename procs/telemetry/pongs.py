"""The board's answers to pings: which ping was answered, and when.

A ping asks for a servo's position (BOARD.pings), and its answer names the servo, so it says which of the pings it
answers. A client that reads the same servo's position gets the same answer, and it counts as well: it proves no less
that the board hears. But it may answer a question from before the ping, by the time that a question takes on the wire
(0.1 ms), and it takes the place of the answer before it if the supervisor has not seen that yet.
"""

from __future__ import annotations

from failstop.board.framing import PWM_SERVO
from failstop.board.interface import BOARD
from failstop.shm import records

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.shm.bell import EventBell
    from failstop.shm.words import Word


class Pongs:
    """Publishes the newest answer, and wakes the supervisor for it."""

    __slots__ = ("_bell", "_word")

    def __init__(self, word: Word, bell: EventBell) -> None:
        self._word = word
        self._bell = bell

    def take(self, data: bytes, t_ns: int) -> None:
        """A frame of the PWM servos. `t_ns`: when the port owner had read its last byte."""
        index = BOARD.pong(PWM_SERVO, data)
        if index is not None:
            self._word.set(records.pong(t_ns, index))
            self._bell.ring()
