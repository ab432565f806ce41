"""Packing: msgpack for the service's own records, with one small buffer per process, and the notes made with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import msgpack

from failstop.data import Data
from failstop.messages.layout import NOTE_BYTES
from failstop.messages.records import cut

Value = str | int | float
Fields = dict[str, Value]
NO_FIELDS: Fields = {}
NEXT_STEP = "; next: "
"""The text that comes before the next step in a text for people."""

# msgpack.packb allocates 1 MB at every call, so a process that is out of memory would die of a note.
pack: Callable[[object], bytes] = msgpack.Packer(buf_size=8192).pack
"""The bytes of a value. Not thread-safe. Raises TypeError, ValueError, OverflowError."""

STEP_BYTES = 200
NOTE_CUTS = ((280, 280), (280, 64))
"""To how many bytes the text and each field are cut. The first pair with which the note fits into the ring is used."""


def fitting(
    room: int,
    cuts: tuple[tuple[int, int], ...],
    text: str,
    fields: Mapping[str, Value],
    whole: Callable[[str, dict[str, Value]], object],
) -> bytes:
    """Combine text and fields with `whole` and pack them into `room` bytes. Texts are cut as little as possible, and
    fields that still don't fit are left out."""
    for text_bytes, value_bytes in cuts:
        short = cut(text, text_bytes).decode()
        given = {
            key: cut(value, value_bytes).decode() if isinstance(value, str) else value for key, value in fields.items()
        }
        data = pack(whole(short, given))
        if len(data) <= room:
            return data
    return pack(whole(short, {}))


class Note(Data):
    """A note for people, on its way from gate or telemetry to the supervisor's events.

    As bytes it is a msgpack list: kind (supervisor/kinds.py), level (empty: the kind's own), text, next step (may be
    empty), fields.
    """

    kind: str
    text: str
    fields: Fields = NO_FIELDS
    level: str = ""
    step: str = ""

    def pack(self) -> bytes:
        """The bytes for a ring of NOTE_BYTES."""
        head, step = (self.kind, self.level), cut(self.step, STEP_BYTES).decode()
        return fitting(NOTE_BYTES, NOTE_CUTS, self.text, self.fields, lambda text, fields: (*head, text, step, fields))

    @classmethod
    def unpack(cls, payload: bytes) -> Note:
        """The note in these bytes. Raises ValueError if they are damaged."""
        found = msgpack.unpackb(payload)
        if not isinstance(found, list) or [type(part) for part in found] != [str, str, str, str, dict]:
            raise ValueError("a payload that is no note")
        kind, level, text, step, fields = found
        return cls(kind, text, fields, level, step)
