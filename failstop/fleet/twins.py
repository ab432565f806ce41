"""Twins: finds other publishers on the broker that use this robot's name. Pure.

By default, a robot's name is its computer's host name, so two robots with copies of the same SD card have the same
name. To notice this, every publisher draws a random number when it starts. Its messages contain this number, and also
the numbers that it has heard from other publishers with its name.

Nobody can list a number before it is drawn. So another publisher whose message lists this publisher's number has run at
the same time as this publisher. This is certain in whatever order the messages arrive, and even if clocks are wrong.
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
"""How many numbers are remembered. There is a limit, so that nobody can fill the memory by inventing numbers. A small
limit is enough, because one other publisher with this robot's name already means that no fleet stop counts this robot
as confirmed."""


def draw() -> str:
    """Draw the random number of a new publisher."""
    return secrets.token_hex(NUMBER_BYTES)


def number_of(found: object) -> str:
    """Return the publisher's number from a message's field `publisher`, or "" if it has none."""
    return found if isinstance(found, str) and NUMBER.fullmatch(found) else ""


class Said(NamedTuple):
    """The content of a connection message."""

    word: str = ""
    """ONLINE, OFFLINE or LOST. Empty if the stored message was removed, or if the message can't be read."""
    number: str = ""
    """The number of the publisher that made the message. Empty if the message has none."""
    dated_s: float | None = None
    """When the message was made, by its publisher's clock (Unix time, s)."""
    heard: tuple[str, ...] = ()
    """The numbers of other publishers that the message lists, because its sender has received messages from them."""


NOTHING = Said()


def connection_of(payload: bytes) -> Said:
    """Read a connection message. Returns NOTHING if it is empty or can't be read."""
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
    """Finds the other publishers that use this robot's name."""

    def __init__(self, own: str, started_s: float) -> None:
        """`own`: this publisher's number. `started_s`: when this publisher started (Unix time, s)."""
        self.others: set[str] = set()
        """The numbers of other publishers that use this robot's name, at most MOST. Only a restart of this publisher
        clears them, because the other robot may still be driving after its publisher falls silent."""
        self.again = False
        """True if this publisher must publish its connection message again, because the broker's stored message is
        missing or says OFFLINE or LOST, or because there is a new number to list."""
        self._own = own
        self._started_s = started_s
        self._connections = 0
        self._heard: dict[str, None] = {}
        self._kept_s: dict[str, float] = {}
        """Other publishers of this robot's name, each with a date. The broker's stored message named them when this
        publisher first connected, so they may have ended since. Only a message with a later date suggests that its
        sender still runs.

        For the publisher that made the stored message, the date is that message's date. The date is needed because that
        publisher's clock may be ahead: its old message would then look newer than this publisher's start. If the stored
        message has no date, or only lists the publisher, the date is infinity, so no message is later.
        """

    def connected(self) -> None:
        """Note a new connection to the broker. Call this before hear(), because the broker's first message may be a
        stored one from before this publisher's start."""
        self._connections += 1

    def heard(self) -> list[str]:
        """Return the numbers to list in this publisher's next messages, in the order in which they were first heard."""
        return [number for number in self._heard if number]

    def hear(self, payload: bytes, *, retained: bool) -> None:
        """Handle a connection message with this robot's name. Messages may arrive in any order."""
        said = connection_of(payload)
        if said.number == self._own:
            self.again = self.again or said.word != message.ONLINE
        elif said.word:
            self._hear_other(said, retained=retained)
            # It may be the last will of an earlier publisher, whose broken connection the broker notices only now.
            self.again = self.again or (said.word != message.ONLINE and not retained)
        elif not retained:
            self.again = True

    def _hear_other(self, said: Said, *, retained: bool) -> None:
        if said.number not in self._heard and len(self._heard) < MOST:
            self._heard[said.number] = None
            self.again = True  # list it, but only once, or two publishers would answer each other forever
        if retained and self._connections <= 1:
            self._kept_s[said.number] = math.inf if said.dated_s is None else said.dated_s
            self._kept_s |= dict.fromkeys(said.heard, math.inf)
        runs = self._own in said.heard or (self._later(said) and (retained or said.word == message.ONLINE))
        if runs and len(self.others) < MOST:
            self.others.add(said.number)

    def _later(self, said: Said) -> bool:
        """Return True if the date of the message suggests that its sender is running now. The date must be later than
        this publisher's start, and later than the date in `_kept_s`.

        A clock may be wrong, so this is not certain. But such a date is the only sign of a publisher that hangs before
        it has listed any number.
        """
        return said.dated_s is not None and said.dated_s > max(self._started_s, self._kept_s.get(said.number, 0.0))
