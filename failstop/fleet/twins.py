"""Twins: other publishers on the broker that use this robot's name. Pure.

A robot's name is the host's by default, so two cards of one image have the same. Every publisher draws a number when it
starts, puts it into all that it publishes, and names the numbers that it has heard from others under its name. Nobody
can name a number before it is drawn, so a message that names this publisher's was made by one that runs alongside it,
in whatever order the broker delivers, and whatever the clocks show.
"""

from __future__ import annotations

import json
import math
import re
import secrets
from typing import NamedTuple

from failstop.fleet import message

NUMBER_BYTES = 8
NUMBER = re.compile(rf"[0-9a-f]{{{2 * NUMBER_BYTES}}}")
MOST = 64
"""Numbers that are remembered, so that nobody who may write to the topic can fill the memory. The first other one bars
the robot from being confirmed, so a later one changes nothing."""


def draw() -> str:
    """Return a new publisher's number."""
    return secrets.token_hex(NUMBER_BYTES)


def number_of(found: object) -> str:
    """Return a number that a message gives as `publisher`. Empty: it has none."""
    return found if isinstance(found, str) and NUMBER.fullmatch(found) else ""


class Said(NamedTuple):
    """What a message on a connection says."""

    word: str = ""
    """ONLINE, OFFLINE or LOST. Empty: the message was taken away, or can't be read."""
    number: str = ""
    """The number of its publisher; empty if it gives none."""
    dated_s: float | None = None
    """When it was made, Unix seconds, by the clock of its publisher."""
    heard: tuple[str, ...] = ()
    """The numbers that its publisher had heard."""


NOTHING = Said()


def connection_of(payload: bytes) -> Said:
    """Return what a message on a connection says."""
    try:
        found = json.loads(payload) if payload else {}
        if word := found.get("connection"):
            heard = found.get("heard")
            numbers = tuple(filter(None, map(number_of, heard[:MOST]))) if isinstance(heard, list) else ()
            return Said(str(word), number_of(found.get("publisher")), message.date(found.get("t")), numbers)
    except (ValueError, AttributeError, OverflowError, RecursionError):
        pass
    return NOTHING


class Twins:
    """What the topic of this robot's connection says of other publishers."""

    def __init__(self, own: str, started_s: float) -> None:
        """`own`: this publisher's number; `started_s`: when it started, Unix time."""
        self.others: set[str] = set()
        """Their numbers, MOST at most. None is ever dropped: a robot that is switched off or renamed was still one of
        two, and may be driving. The publisher forgets when it is restarted."""
        self.again = False
        """The broker keeps somebody else's message, or none, or this publisher has a new number to name, so it must say
        its connection again."""
        self._own = own
        self._started_s = started_s
        self._connections = 0
        self._heard: dict[str, None] = {}
        self._kept_s: dict[str, float] = {}
        """The numbers that were in use before this publisher's first connection, each with the date of the message that
        the broker had kept; infinite if the date isn't known. Such a publisher may have ended or may still run, and its
        clock may have been ahead."""

    def connected(self) -> None:
        """Count a new connection to the broker, which begins with the message that the broker has kept."""
        self._connections += 1

    def heard(self) -> list[str]:
        """Return the numbers to name in this publisher's next messages, the oldest first."""
        return [number for number in self._heard if number]

    def hear(self, payload: bytes, *, retained: bool) -> None:
        """Take a message on the connection of this name. They may come in any order."""
        said = connection_of(payload)
        if said.number == self._own:
            self.again = self.again or said.word != message.ONLINE
        elif said.word:
            self._hear_other(said, retained=retained)
            # The last will of an earlier publisher, say, whose connection the broker took for alive until now.
            self.again = self.again or (said.word != message.ONLINE and not retained)
        elif not retained:
            self.again = True

    def _hear_other(self, said: Said, *, retained: bool) -> None:
        if said.number not in self._heard and len(self._heard) < MOST:
            self._heard[said.number] = None
            self.again = True  # to name it, and only once: otherwise two would answer each other forever
        if retained and self._connections <= 1:
            self._kept_s[said.number] = math.inf if said.dated_s is None else said.dated_s
            self._kept_s |= dict.fromkeys(said.heard, math.inf)
        runs = self._own in said.heard or (self._later(said) and (retained or said.word == message.ONLINE))
        if runs and len(self.others) < MOST:
            self.others.add(said.number)

    def _later(self, said: Said) -> bool:
        """Whether a message is dated after this publisher's start. That is no proof, because a clock may be wrong, but
        nothing else shows a twin that hangs before it has named anybody."""
        return said.dated_s is not None and said.dated_s > max(self._started_s, self._kept_s.get(said.number, 0.0))
