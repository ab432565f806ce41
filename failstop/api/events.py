"""What the service tells people, for programs: the events of the run that is there now, in order.

for event in EventLog("failstop").read():
    print(event.t, event.kind, event.text)
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator
from contextlib import closing

import msgpack

from failstop.api.client import attach, runtime_dir
from failstop.api.errors import FailstopError, NoService
from failstop.api.news import News
from failstop.shm import layout
from failstop.shm.instance import DEFAULT_NAME

POLL_S = 0.05
LOOK_EVERY_S = 0.25
"""How often a log without news looks whether its service is still there."""


@dataclasses.dataclass(frozen=True)
class Event:
    """One event. Its kinds, and the fields of each, are in supervisor/kinds.py and docs/journal.md."""

    seq: int
    """Counted from 1 in each run of the service; a gap: so many were overwritten before they were read."""
    t: float
    """Unix time."""
    ns: int
    """CLOCK_MONOTONIC, ns."""
    kind: str
    """What it is about: stop, enabled, died, ... (docs/journal.md)."""
    level: str
    """info, notice, warning, error or critical."""
    text: str
    """One line for people, the same as in the journal; cut at 280 bytes, or at 200 or 120 where its fields need
    the room."""
    fields: dict[str, str | int | float]
    """What its kind has beside the text."""


class EventLog:
    """Reads the events of a running service; needs no permission and no client slot. Not thread-safe."""

    def __init__(self, name: str = DEFAULT_NAME) -> None:
        """Raises NoService, FailstopError."""
        self.name = name
        segment = attach(name, layout.SUPERVISOR)
        self._incarnation = segment.incarnation
        self._ring = segment.ring_reader("events", from_oldest=True)
        self._looked_s = time.monotonic()

    @property
    def lost(self) -> int:
        """How many events were overwritten before they were read."""
        return self._ring.lost

    def read(self) -> list[Event]:
        """The events since the last call, the first time all that the service still has (the last 256). Empty when
        there are none. Raises NoService when the service has ended, and all that it told was read."""
        found = []
        while entry := self._ring.next():
            if event := unpack(entry[0], entry[2]):
                found.append(event)
        if not found:
            self._look()
        return found

    def follow(self, every_s: float = POLL_S) -> Iterator[Event | None]:
        """Every event, those that are there first, each as it is told; None when there is none for a while (`every_s`),
        so that the caller can do something else. Raises NoService when the service has ended."""
        with closing(News(self.name)) as news:
            while True:
                news.look()
                found = self.read()
                yield from found
                if not found:
                    news.wait(every_s)
                    yield None

    def skip(self) -> None:
        """Only what is told from here on."""
        while self._ring.next():
            pass

    def _look(self) -> None:
        """Raises NoService when this run of the service is over."""
        now_s = time.monotonic()
        if now_s - self._looked_s < LOOK_EVERY_S:
            return
        self._looked_s = now_s
        runtime_dir(self.name)
        there = attach(self.name, layout.SUPERVISOR)
        there.close()
        if there.incarnation != self._incarnation:
            raise NoService(f"the service {self.name!r} was restarted: read its events again")


def unpack(seq: int, payload: bytes) -> Event | None:
    """An entry of the ring; None for a payload that is none, as of another version."""
    try:
        found = msgpack.unpackb(payload)
        return Event(seq, found["t"], found["ns"], found["kind"], found["level"], found["text"], found["fields"])
    except (ValueError, KeyError, TypeError, msgpack.exceptions.UnpackException):
        return None


__all__ = ["Event", "EventLog", "FailstopError", "NoService"]
