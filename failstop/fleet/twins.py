"""Twins: other publishers on the broker that use this robot's name. Pure.

A robot's name is the host's by default, so two cards of one image have the same. Every publisher draws a number when it
starts, and puts it into all that it publishes, so that two of them are never taken for one.
"""

from __future__ import annotations

import json
import re
import secrets

from failstop.fleet import message

NUMBER_BYTES = 8
NUMBER = re.compile(rf"[0-9a-f]{{{2 * NUMBER_BYTES}}}")


def draw() -> str:
    """Return a new publisher's number."""
    return secrets.token_hex(NUMBER_BYTES)


def number_of(found: object) -> str:
    """Return a number that a message gives as `publisher`. Empty: it has none."""
    return found if isinstance(found, str) and NUMBER.fullmatch(found) else ""


def connection_of(payload: bytes) -> tuple[str, str, float | None]:
    """Return the state, the publisher's number and the date (Unix seconds) of a message on a connection. All empty for
    a message that was taken away, or can't be read."""
    try:
        found = json.loads(payload) if payload else {}
        if word := found.get("connection"):
            return str(word), number_of(found.get("publisher")), message.date(found.get("t"))
    except (ValueError, AttributeError, OverflowError, RecursionError):
        pass
    return "", "", None


class Twins:
    """What the topic of this robot's connection says of other publishers."""

    def __init__(self, own: str, started_s: float) -> None:
        """`own`: this publisher's number; `started_s`: when it started, Unix time."""
        self.others: set[str] = set()
        """Their numbers. None is ever dropped: a robot that is switched off or renamed was still one of two, and may
        be driving. The publisher forgets when it is restarted."""
        self.again = False
        """The broker keeps somebody else's message, or none, so this publisher must say its connection again."""
        self._own = own
        self._started_s = started_s
        self._settled = False
        """The broker has passed on this publisher's own message. What it had kept before that may be from before this
        publisher's start."""

    def hear(self, payload: bytes, *, retained: bool) -> None:
        """Take a message on the connection of this name."""
        word, number, dated_s = connection_of(payload)
        if number == self._own:
            self._settled = True
            self.again = self.again or word != message.ONLINE
            return
        if retained:
            # Two clients that throw each other off the broker learn of each other from nothing else.
            later = dated_s is not None and dated_s > self._started_s
            if word and self._settled and later:
                self.others.add(number)
        elif word == message.ONLINE:
            # Answered once, or both would go on for ever.
            self.again = self.again or number not in self.others
            self.others.add(number)
        else:
            # The last will of an earlier publisher, say, whose connection the broker took for alive until now.
            self.again = True
