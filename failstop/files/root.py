"""Root: below which the machine's own directories are for this process."""

from __future__ import annotations

import os

VARIABLE = "FAILSTOP_ROOT"
"""Names another root than /: a run below it has nothing to do with what is installed, or runs, on the machine."""


def at(path: str) -> str:
    """Where an absolute path of the system's, as /run/failstop, is."""
    return os.environ.get(VARIABLE, "") + path
