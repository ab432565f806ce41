"""Notes: what gate and telemetry have to tell people, on its way to the supervisor, which makes events of them.

A msgpack list: kind (supervisor/kinds.py), level (empty: the kind's own), text, fields.
"""

from __future__ import annotations

import msgpack

from failstop.shm.layout import NOTE_BYTES
from failstop.shm.packing import pack
from failstop.shm.records import cut

TYPE_CHECKING = False
if TYPE_CHECKING:
    Value = str | int | float
    Fields = dict[str, Value]

TEXT_BYTES = 280
"""The longest text, of the note and of each field."""
SHORT_BYTES = 64
"""The longest text of each field, where they do not fit otherwise."""


class Note:
    """One remark for people."""

    __slots__ = ("fields", "kind", "level", "text")

    def __init__(self, kind: str, text: str, fields: Fields | None = None, *, level: str = "") -> None:
        self.kind = kind
        self.text = text
        self.fields = fields or {}
        self.level = level

    def pack(self) -> bytes:
        """For a ring of NOTE_BYTES: texts are cut, and fields that still do not fit are left out."""
        text = cut(self.text, TEXT_BYTES).decode()
        for most in (TEXT_BYTES, SHORT_BYTES):
            fields = {
                key: cut(value, most).decode() if isinstance(value, str) else value
                for key, value in self.fields.items()
            }
            data = pack((self.kind, self.level, text, fields))
            if len(data) <= NOTE_BYTES:
                return data
        return pack((self.kind, self.level, text, {}))

    @classmethod
    def unpack(cls, payload: bytes) -> Note:
        """Raises ValueError."""
        found = msgpack.unpackb(payload)
        if not isinstance(found, list) or [type(part) for part in found] != [str, str, str, dict]:
            raise ValueError("a payload that is no note")
        kind, level, text, fields = found
        return cls(kind, text, fields, level=level)
