"""Packing: turns values into msgpack for shared memory. It uses one small buffer for the whole process. It also defines
the notes that the gate and telemetry send to people."""

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
"""Comes before the next step in a text for people."""

# Not msgpack.packb, which allocates 1 MB at every call. A process that is short of memory could die of that.
pack: Callable[[object], bytes] = msgpack.Packer(buf_size=8192).pack
"""Return a value as msgpack bytes. Not thread-safe. Raises TypeError, ValueError, OverflowError."""

STEP_BYTES = 200
NOTE_CUTS = ((280, 280), (280, 64))
"""Pairs of (bytes of a note's text that are kept, bytes of each field that are kept). The second pair is used only if
the note is too long with the first pair."""


def fitting(
    room: int,
    cuts: tuple[tuple[int, int], ...],
    text: str,
    fields: Mapping[str, Value],
    whole: Callable[[str, dict[str, Value]], object],
) -> bytes:
    """Pack `whole(text, fields)` into at most `room` bytes. Each pair in `cuts` says how many bytes of the text and of
    each text field are kept. The first pair that fits is used. If none fits, the last pair is used without the
    fields."""
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
    """A note for people, which the gate or telemetry sends to the supervisor. The supervisor makes an event of it.

    As bytes it is a msgpack list of: kind (supervisor/kinds.py), level (empty for the usual level of this kind), text,
    next step (may be empty), fields.
    """

    kind: str
    text: str
    fields: Fields = NO_FIELDS
    level: str = ""
    step: str = ""

    def pack(self) -> bytes:
        """The note as at most NOTE_BYTES bytes."""
        head, step = (self.kind, self.level), cut(self.step, STEP_BYTES).decode()
        return fitting(NOTE_BYTES, NOTE_CUTS, self.text, self.fields, lambda text, fields: (*head, text, step, fields))

    @classmethod
    def unpack(cls, payload: bytes) -> Note:
        """Read the note in these bytes. Raises ValueError if they are damaged."""
        found = msgpack.unpackb(payload)
        if not isinstance(found, list) or [type(part) for part in found] != [str, str, str, str, dict]:
            raise ValueError("a payload that is no note")
        kind, level, text, step, fields = found
        return cls(kind, text, fields, level, step)
