"""Events: what the supervisor tells people, one line each, after the bytes are out."""

from __future__ import annotations

import os


def say(message: str) -> None:
    """Write one line to stderr. A log that can't be written is no reason to stop working."""
    try:
        os.write(2, f"failstop: {message}\n".encode("utf-8", "replace"))
    except OSError:
        return
