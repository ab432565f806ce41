"""What a gate with an arm tells people."""

from __future__ import annotations

from collections.abc import Callable

from failstop.messages.packing import Note
from tests.support.gate_scene import Scene

Make = Callable[..., Scene]
"""A scene with other settings; two underscores are a point."""


def notes(scene: Scene) -> Callable[[], list[tuple[str, str]]]:
    """(level, text) of what people are told from now on, since the last call."""
    ring = scene.own.ring_reader("notes")

    def news() -> list[tuple[str, str]]:
        found = []
        while entry := ring.next():
            note = Note.unpack(entry[2])
            found += [(note.level, note.text)] if note.kind == "arm" else []
        return found

    return news
