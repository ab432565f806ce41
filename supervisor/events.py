"""Events: what the supervisor tells people - in the journal or on stderr, and in a ring for programs.

Told is not yet sent: events wait for flush(), which comes at the end of a turn, when the bytes of a stop are out.
"""

from __future__ import annotations

import os
import select
import time

from failstop.fold import PREFIX, fitted
from failstop.shm import instance, layout, packing
from failstop.shm.records import cut
from failstop.supervisor.kinds import BY_NAME, LEVELS

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping

    from failstop.shm.ring import RingWriter
    from failstop.supervisor.journal import Journal, Value

    Told = tuple[int, float, str, str, str, dict[str, Value]]

LONGEST_HOLD_NS = 50_000_000
"""Events wait at most this long for a stop's bytes, which are out within 5 ms where they can be written at all."""
MOST_WAITING = 256
CUTS = ((280, 280), (200, 60), (120, 24))
"""Bytes that are left of the text, and of each field's: the first that fit into the ring."""
ROOM = layout.BY_NAME[layout.SUPERVISOR].records["events"].capacity


def say(message: str) -> None:
    """Write one line to stderr, broken at words on a terminal. A log that can't be written is no reason to stop
    working, nor one that nobody reads (a full pipe, a terminal held by Ctrl-S): the line is dropped then."""
    try:
        if select.select((), (2,), (), 0)[1]:
            os.write(2, f"{fitted(PREFIX + message, 2)}\n".encode("utf-8", "replace"))
    except OSError:
        return


class Events:
    """The one place where events leave the service. Without a journal they are lines on stderr."""

    def __init__(self, name: str, ring: RingWriter | None = None, journal: Journal | None = None) -> None:
        """`name`: the instance's."""
        self._name = name
        self._ring = ring
        self._journal = journal
        self._waiting: list[Told] = []

    def tell(self, kind: str, text: str, fields: Mapping[str, Value | None] | None = None, *, level: str = "") -> None:
        """An event of a kind of kinds.py (any other becomes a note), at its kind's level or another; a field that is
        None is left out."""
        if len(self._waiting) >= MOST_WAITING:
            return
        known = BY_NAME.get(kind) or BY_NAME["note"]
        given = {key: value for key, value in (fields or {}).items() if value is not None}
        now = (time.monotonic_ns(), time.time())
        self._waiting.append((*now, known.name, level if level in LEVELS else known.level, text, given))

    def command(self, words: str) -> str:
        """A command to type next, in backquotes, for this instance."""
        return f"`failstop {words}{instance.option(self._name)}`"

    def flush(self, now_ns: int = 0, *, hold: bool = False) -> None:
        """Send what was told. `hold`: a stop's bytes are not out yet; then only what has waited for long."""
        if not self._waiting or (hold and now_ns - self._waiting[0][0] < LONGEST_HOLD_NS):
            return
        waiting, self._waiting = self._waiting, []
        for told in waiting:
            self._send(*told)

    def _send(self, t_ns: int, unix_s: float, kind: str, level: str, text: str, fields: dict[str, Value]) -> None:
        if self._ring:
            self._ring.put(pack(t_ns, unix_s, kind, level, text, fields), t_ns)
        if not self._journal or not self._journal.send(entry(self._name, t_ns, kind, level, text, fields)):
            say(text)


def entry(name: str, t_ns: int, kind: str, level: str, text: str, fields: dict[str, Value]) -> list[tuple[str, Value]]:
    """The journal's fields of one event of the instance `name`."""
    return [
        ("MESSAGE", text),
        ("PRIORITY", LEVELS[level]),
        ("MESSAGE_ID", BY_NAME[kind].message_id),
        ("SYSLOG_IDENTIFIER", "failstop"),
        ("FAILSTOP_EVENT", kind),
        ("FAILSTOP_NAME", name),
        ("FAILSTOP_MONOTONIC_NS", t_ns),
        *((f"FAILSTOP_{key.upper()}", value) for key, value in fields.items()),
    ]


def pack(t_ns: int, unix_s: float, kind: str, level: str, text: str, fields: dict[str, Value]) -> bytes:
    """One event for the ring, as a msgpack map, its texts cut until it fits; fields that then still do not are left
    out."""
    told: dict[str, object] = {"t": unix_s, "ns": t_ns, "kind": kind, "level": level, "text": "", "fields": {}}
    for text_bytes, value_bytes in CUTS:
        told["text"] = cut(text, text_bytes).decode()
        told["fields"] = {
            key: cut(value, value_bytes).decode() if isinstance(value, str) else value for key, value in fields.items()
        }
        data = packing.pack(told)
        if len(data) <= ROOM:
            return data
    told["fields"] = {}
    return packing.pack(told)
