"""What the service tells people, for programs: the events of the run that is there now, in order.

for event in EventLog("failstop").read():
    print(event.t, event.kind, event.text)
"""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import os
import select
import struct
from collections.abc import Iterator

import msgpack

from failstop.api.client import Run, runtime_dir
from failstop.api.errors import FailstopError, NoService
from failstop.shm import instance
from failstop.shm.instance import DEFAULT_NAME

POLL_S = 0.05
LOOK_EVERY_S = 0.25
"""How often a log without news looks whether its service is still there."""
_MODIFY, _ATTRIB, _MOVE_SELF, _DELETE_SELF, _DONT_FOLLOW = 0x2, 0x4, 0x800, 0x400, 0x02000000
_EVENTS = _MODIFY | _ATTRIB | _MOVE_SELF | _DELETE_SELF | _DONT_FOLLOW
_MOST_BYTES = 65536


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

    def __init__(self, name: str = DEFAULT_NAME, *, past: bool = True) -> None:
        """`past`: with those that are there. Raises NoService, FailstopError."""
        self.name = name
        self._run = Run(name)
        self._ring = self._run.supervisor.ring_reader("events", from_oldest=past)

    def read(self) -> list[Event]:
        """The events since the last call, the first time all that the service still has (the last 256). Empty when
        there are none. Raises NoService when the service has ended, and all that it told was read."""
        over = self._run.over()  # first: what it told last is still to be read then
        found = []
        while entry := self._ring.next():
            if event := unpack(entry[0], entry[2]):
                found.append(event)
        if over and not found:
            runtime_dir(self.name)
            raise NoService(f"the service {self.name!r} has ended, or was restarted: read its events again")
        return found

    def follow(self, every_s: float = POLL_S) -> Iterator[Event | None]:
        """Every event, those that are there first, each as it is told; None when there is none for a while (`every_s`),
        so that the caller can do something else. Raises NoService when the service has ended."""
        with contextlib.closing(News(self.name)) as news:
            while True:
                news.look()
                found = self.read()
                yield from found
                if not found:
                    news.wait(every_s)
                    yield None


def unpack(seq: int, payload: bytes) -> Event | None:
    """An entry of the ring; None for a payload that is none, as of another version."""
    try:
        found = msgpack.unpackb(payload)
        return Event(seq, found["t"], found["ns"], found["kind"], found["level"], found["text"], found["fields"])
    except (ValueError, KeyError, TypeError, msgpack.exceptions.UnpackException):
        return None


class News:
    """A wake-up for whoever reads the service's state and events, without a right to anything of it: a descriptor that
    is readable when there may be news. Not for several threads at once.

    The supervisor writes one byte of the file that names its run once more; inotify tells whoever watches that file,
    and tells them too when a run ends or another one takes the name. What watching costs the writer is bounded by the
    kernel: a user has 128 watches of one file at most (fs.inotify.max_user_instances). A wake-up that is lost costs a
    look later.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._libc = ctypes.CDLL(None)
        self.fd: int = self._libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        """-1 where this user may have no more of them: then there are no wake-ups, and looking is all there is."""
        self.watched = False
        """There is a run, whose news wake."""

    def look(self) -> None:
        """Before a look at what there may be news of: whatever is told after this wakes whoever waits."""
        if self.fd < 0:
            return
        with contextlib.suppress(BlockingIOError):
            # Anything but a change of its bytes means that the file is another one, or none.
            told = struct.iter_unpack("iIII", os.read(self.fd, _MOST_BYTES))
            self.watched &= all(mask == _MODIFY for _, mask, _, _ in told)
        if not self.watched:
            paths = (os.fsencode(instance.run_path(path)) for path in instance.places(self._name))
            self.watched = any(self._libc.inotify_add_watch(self.fd, path, _EVENTS) >= 0 for path in paths)

    def wait(self, timeout_s: float) -> None:
        """Sleep until there may be news."""
        poll = select.poll()
        if self.fd >= 0:
            poll.register(self.fd, select.POLLIN)
        poll.poll(max(0.0, timeout_s) * 1e3)

    def close(self) -> None:
        """Give the descriptor back."""
        fd, self.fd = self.fd, -1
        if fd >= 0:
            os.close(fd)


__all__ = ["Event", "EventLog", "FailstopError", "NoService"]
