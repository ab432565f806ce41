"""The link: does the board hear what is written to it? Pure.

    unproven   it has never answered a ping since the port was opened: nothing is known, nothing is stopped for
    alive      it answers
    deaf       it has answered before and is silent: a stop cause, once, until it answers again

A board can go deaf while its telemetry goes on, so only answers count.
"""

from __future__ import annotations

UNPROVEN = "unproven"
ALIVE = "alive"
DEAF = "deaf"

ANSWER_NS = 20_000_000
"""A ping as young as this may still be answered; a stop's ping and the next are further apart (schedule.py)."""


class Link:
    """What is known of one opened port's board."""

    __slots__ = ("_answered_ns", "_asked_ns", "_deaf_ns", "state")

    def __init__(self, deaf_ns: int) -> None:
        self._deaf_ns = deaf_ns
        self.state = UNPROVEN
        self._answered_ns = 0
        """When the newest answered ping was sent."""
        self._asked_ns = 0
        """When the oldest ping after it was sent; 0: none yet."""

    def opened(self) -> None:
        """Another port, perhaps another board: nothing is known of it."""
        self.state = UNPROVEN
        self._answered_ns = self._asked_ns = 0

    def listen(self, newest_ping_ns: int) -> None:
        """Nobody could have heard an answer until now: a silence begins with the next ping at the earliest."""
        self._asked_ns = 0
        self._answered_ns = max(self._answered_ns, newest_ping_ns)

    def answered(self, sent_ns: int) -> None:
        """A ping that was sent at `sent_ns` was answered."""
        self.state = ALIVE
        self._answered_ns = max(self._answered_ns, sent_ns)
        self._asked_ns = 0

    def silent(self, newest_ping_ns: int, now_ns: int) -> bool:
        """True when the board has just become deaf; `newest_ping_ns`: when the last ping was sent."""
        if self._asked_ns == 0 and newest_ping_ns > self._answered_ns:
            self._asked_ns = newest_ping_ns
        if self.state != ALIVE or not self._asked_ns:
            return False
        # Half of it since a ping that it should have answered: a ping period before, it had nothing to answer.
        if now_ns - self._answered_ns < self._deaf_ns or now_ns - self._asked_ns < self._deaf_ns // 2:
            return False
        if now_ns - newest_ping_ns < ANSWER_NS:
            return False
        self.state = DEAF
        return True
