"""Twins: other publishers on the broker that use this robot's name. Pure.

By default a robot has the name of its computer, so two SD cards with the same image have the same name. Every publisher
draws a random number when it starts, puts it into all its messages, and also lists the numbers that it has heard from
other publishers under its name. Nobody can list a number before it is drawn. So a message that lists this publisher's
number was made by a publisher that runs at the same time, whatever the order of delivery and whatever the clocks show.
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
"""How many numbers are remembered, so that nobody who may write to the topic can fill the memory. More are not needed:
the first other publisher already keeps the robot from being confirmed."""


def draw() -> str:
    """Return the random number of a new publisher."""
    return secrets.token_hex(NUMBER_BYTES)


def number_of(found: object) -> str:
    """Return the number that a message has in its field `publisher`; empty if it has none."""
    return found if isinstance(found, str) and NUMBER.fullmatch(found) else ""


class Said(NamedTuple):
    """The content of a message about a connection."""

    word: str = ""
    """ONLINE, OFFLINE or LOST; empty if the message was removed or can't be read."""
    number: str = ""
    """The number of the publisher that made the message; empty if the message has none."""
    dated_s: float | None = None
    """When the message was made, by the clock of its publisher (Unix time, s)."""
    heard: tuple[str, ...] = ()
    """The numbers that its publisher had heard from others."""


NOTHING = Said()


def connection_of(payload: bytes) -> Said:
    """Return the content of a message about a connection."""
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
    """The other publishers that use the topic of this robot's connection."""

    def __init__(self, own: str, started_s: float) -> None:
        """`own`: this publisher's number; `started_s`: when it started, Unix time."""
        self.others: set[str] = set()
        """The numbers of the other publishers, at most MOST. None is ever removed, because a robot that is switched off
        or renamed was still one of two and may be driving. Only a restart of this publisher forgets them."""
        self.again = False
        """True if this publisher must publish its connection again: the broker has stored somebody else's message or
        none, or this publisher has heard a new number."""
        self._own = own
        self._started_s = started_s
        self._connections = 0
        self._heard: dict[str, None] = {}
        self._kept_s: dict[str, float] = {}
        """The numbers that were in use before this publisher's first connection, each with the date of the message that
        the broker had stored; infinite if the date isn't known. Such a publisher may have ended or may still run, and
        its clock may have been ahead."""

    def connected(self) -> None:
        """Count a new connection to the broker. It begins with the message that the broker has stored."""
        self._connections += 1

    def heard(self) -> list[str]:
        """Return the numbers to list in this publisher's next messages, the oldest first."""
        return [number for number in self._heard if number]

    def hear(self, payload: bytes, *, retained: bool) -> None:
        """Take in a message about the connection of this name. Messages may come in any order."""
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
        """True if a message is dated after this publisher's start. That is no proof, because a clock may be wrong, but
        it is the only sign of a twin that hangs before it has listed any number."""
        return said.dated_s is not None and said.dated_s > max(self._started_s, self._kept_s.get(said.number, 0.0))
