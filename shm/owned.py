"""Owned: closes a descriptor only if it still is the file that was opened.

A program may close descriptors that it does not know, for example because it becomes a daemon. Its next files then get
the same numbers.
"""

from __future__ import annotations

import contextlib
import os

Inode = tuple[int, int]
"""The device and inode of a file."""


def inode_of(fd: int) -> Inode | None:
    """The file behind this descriptor, or None if the descriptor is closed."""
    try:
        found = os.fstat(fd)
    except OSError:
        return None
    return found.st_dev, found.st_ino


def close(fd: int, file: Inode | None) -> None:
    """Close the descriptor if it is open, and `file` is what inode_of() returned for it when it was opened."""
    if file is not None and inode_of(fd) == file:
        with contextlib.suppress(OSError):
            os.close(fd)
