"""Saving the evidence of a stand test: whether it can be saved is asked before anything moves, and no half file is left
afterwards."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable

from failstop.api.errors import FailstopError
from failstop.files import durable

Save = tuple[str, Callable[[], list[str]]]
"""A place for people, and what saves something there and returns the paths. May raise OSError, FailstopError."""


def unwritable(folder: str) -> str:
    """Why no file can be written into this folder, or into one that is made there. Empty if one can. If the folder does
    not exist, the nearest existing folder above it counts."""
    place = os.path.abspath(folder)
    while not os.path.lexists(place):
        place = os.path.dirname(place)
    if not os.path.isdir(place):
        return f"{place} is not a folder"
    return durable.no_room(place) or ("" if os.access(place, os.W_OK | os.X_OK) else f"you may not write to {place}")


def save_each(saves: Iterable[Save]) -> tuple[list[str], list[str]]:
    """Save everything that can be saved, whatever becomes of the rest. Returns (the paths of the files, why others
    could not be saved)."""
    paths, failed = [], []
    for place, save in saves:
        try:
            paths += save()
        except OSError as error:
            failed.append(f"the evidence could not be saved: {error.filename or place}: {error.strerror or error}")
        except KeyboardInterrupt:
            failed.append(f"the evidence could not be saved: {place}: interrupted")
        except FailstopError as error:
            failed.append(f"the evidence could not be saved: {error}")
    return paths, failed
