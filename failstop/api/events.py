"""Events: programs read here what the service reports to people, in order, from the run that exists now.

for event in EventLog("failstop").read():
    print(event.t, event.kind, event.text)
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator

import msgpack

from failstop.api.client import SeenRun, runtime_dir
from failstop.api.errors import NoService
from failstop.files.instance import DEFAULT_NAME
from failstop.messages.packing import NEXT_STEP

LOOK_S = 0.02
"""Time between two looks for what may have changed."""


@dataclasses.dataclass(frozen=True)
class Event:
    """One event. supervisor/kinds.py and docs/logs.md list its kinds, and the fields of each."""

    seq: int
    """Counted from 1 in each run of the service. A gap means that events were overwritten before they were read."""
    t: float
    """When it happened (Unix time, s)."""
    ns: int
    """When it happened (CLOCK_MONOTONIC, ns)."""
    kind: str
    """What it is about: stop, enabled, died, ... (docs/logs.md)."""
    level: str
    """info, notice, warning, error or critical."""
    text: str
    """One line for people, the same as in the journal; cut at 280 bytes, or at 200 or 120 if fields need room."""
    fields: dict[str, str | int | float]
    """The values of this kind of event, in addition to the text."""
    next: str = ""
    """The next step, with which the text ends; empty if the text names none."""

    @property
    def what(self) -> str:
        """The text without its next step."""
        return self.text[: -len(NEXT_STEP) - len(self.next)] if self.next else self.text


class EventLog:
    """Reads the events of a running service; needs no permission and no client slot. Not thread-safe."""

    def __init__(self, name: str = DEFAULT_NAME, *, past: bool = True) -> None:
        """`past`: start with the earlier events that the service still has. Raises NoService, FailstopError."""
        self.name = name
        self._run = SeenRun(name)
        self._ring = self._run.supervisor.ring_reader("events", from_oldest=past)

    def read(self) -> list[Event]:
        """The events since the last call; the first call returns all that the service still has (the last 256). Empty
        if there are none. Raises NoService when the service has ended and all its events were read."""
        over = self._run.over()  # asked first, because the last events must still be read then
        found = []
        while entry := self._ring.next():
            if event := unpack(entry[0], entry[2]):
                found.append(event)
        if over and not found:
            runtime_dir(self.name)
            raise NoService(f"the service {self.name!r} has ended, or was restarted: read its events again")
        return found

    def follow(self) -> Iterator[Event]:
        """Every event as it happens, starting with those that the service still has. Raises NoService when the service
        has ended."""
        while True:
            found = self.read()
            yield from found
            if not found:
                time.sleep(LOOK_S)


def unpack(seq: int, payload: bytes) -> Event | None:
    """The event in an entry of the ring; None if it can't be read, for example because it is from another version."""
    try:
        found = msgpack.unpackb(payload)
        text, what = found["text"], found.get("what")
        step = text[what + len(NEXT_STEP) :] if what else ""
        return Event(seq, found["t"], found["ns"], found["kind"], found["level"], text, found["fields"], step)
    except (ValueError, KeyError, TypeError, msgpack.exceptions.UnpackException):
        return None
