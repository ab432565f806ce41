"""Events: what the supervisor tells people, one line each, after the bytes are out."""

from __future__ import annotations

import os
import select


def say(message: str) -> None:
    """Write one line to stderr. A log that can't be written is no reason to stop working, nor one that nobody reads (a
    full pipe, a terminal held by Ctrl-S): the line is dropped then."""
    try:
        if select.select((), (2,), (), 0)[1]:
            os.write(2, f"failstop: {message}\n".encode("utf-8", "replace"))
    except OSError:
        return
