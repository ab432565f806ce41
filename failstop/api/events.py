"""Events: what the service reports to people, in order. A program can read these events from the running service:

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
"""How long to wait before looking for new events again, in seconds."""


@dataclasses.dataclass(frozen=True)
class Event:
    """One event of the service. docs/logs.md and supervisor/kinds.py list the kinds of events, and the fields of each
    kind."""

    seq: int
    """The number of the event, counted from 1 in each run of the service. A gap in the numbers means that events were
    overwritten before they were read."""
    t: float
    """When the event happened, by the wall clock of that moment (Unix time, s). If somebody sets the clock later, `ns`
    still shows how long ago it was."""
    ns: int
    """When the event happened (CLOCK_MONOTONIC, ns)."""
    kind: str
    """The kind of the event, for example stop, enabled or died (docs/logs.md)."""
    level: str
    """How important the event is: info, notice, warning, error or critical."""
    text: str
    """One line for people, the same as in the journal, of at most 280 bytes. It is cut to 200 or 120 bytes if the event
    would not fit into its entry because of long `fields`."""
    fields: dict[str, str | int | float]
    """The event's values for programs. Each kind of event has different values (docs/logs.md)."""
    next: str = ""
    """What people should do next. `text` ends with the same words. Empty if nothing needs to be done."""

    @property
    def what(self) -> str:
        """The text without the next step."""
        return self.text[: -len(NEXT_STEP) - len(self.next)] if self.next else self.text


class EventLog:
    """Reads the events of a running service. It needs no permission and no client slot. Not thread-safe."""

    def __init__(self, name: str = DEFAULT_NAME, *, past: bool = True) -> None:
        """`past`: True to begin with events from before this object was made, as far as the service still has them.
        Raises NoService, FailstopError."""
        self.name = name
        self._run = SeenRun(name)
        self.run = self._run.found[0]
        """The name of this run of the service. Each run has another one."""
        self._ring = self._run.supervisor.ring_reader("events", from_oldest=past)

    def read(self) -> list[Event]:
        """Return the events since the last call. The first call returns the events since this object was made, and with
        `past` also the earlier ones that the service still has (the last 256). Raises NoService once this run of the
        service has ended and all its events were returned."""
        over = self._run.over()  # checked before reading, because the last events must still be returned
        found = []
        while entry := self._ring.next():
            if event := unpack(entry[0], entry[2]):
                found.append(event)
        if over and not found:
            runtime_dir(self.name)
            raise NoService(f"the service {self.name!r} has ended, or was restarted: read its events again")
        return found

    def follow(self) -> Iterator[Event]:
        """Yield every event as it happens. If this EventLog was made with `past`, begin with the earlier events that
        the service still has. Raises NoService when this run of the service ends."""
        while True:
            found = self.read()
            yield from found
            if not found:
                time.sleep(LOOK_S)


def unpack(seq: int, payload: bytes) -> Event | None:
    """Decode an event of the service's ring. None if that fails, for example because a different version of failstop
    wrote it."""
    try:
        found = msgpack.unpackb(payload)
        text, what = found["text"], found.get("what")
        step = text[what + len(NEXT_STEP) :] if what else ""
        return Event(seq, found["t"], found["ns"], found["kind"], found["level"], text, found["fields"], step)
    except (ValueError, KeyError, TypeError, msgpack.exceptions.UnpackException):
        return None
