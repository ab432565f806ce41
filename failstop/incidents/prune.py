"""Prune: how many incidents are kept. The newest stays in any case."""

from __future__ import annotations

import contextlib
import os

from failstop.incidents.file import SUFFIX, IncidentError, read_head


def prune(folder: str, name: str, keep: int, most_bytes: int) -> list[str]:
    """Remove the oldest incidents of an instance (several may share a folder) beyond `keep` and `most_bytes` together;
    returns the file names that were removed. What is no incident is left alone. Raises OSError when the folder can't
    be read."""
    found = []
    for entry in os.listdir(folder):
        path = os.path.join(folder, entry)
        if entry.endswith(SUFFIX):
            with contextlib.suppress(IncidentError, OSError):
                head = read_head(path)
                if head.get("name") == name:
                    # By the time of saving: an old run's incident is saved after newer ones of nobody.
                    found.append((float(head.get("saved", 0.0)), entry, os.stat(path).st_size))
    removed, total = [], 0
    for index, (_, entry, size) in enumerate(sorted(found, reverse=True)):
        total += size
        if index and (index >= keep or total > most_bytes):
            with contextlib.suppress(OSError):
                os.unlink(os.path.join(folder, entry))
                removed.append(entry)
                total -= size
    return removed
