"""Durable: files that are whole and on the disk, or not there. A draft is written and synced, then it gets its name."""

from __future__ import annotations

import contextlib
import os
from errno import ENOSPC


def write_draft(draft: str, data: bytes) -> None:
    """Write a draft, in place of an old one. Raises OSError, and then there is none."""
    with contextlib.suppress(FileNotFoundError):
        os.unlink(draft)
    try:
        # Never through a link: whoever runs this may be more than the folder's owner.
        fd = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644)
        try:
            rest = memoryview(data)
            while rest:
                written = os.write(fd, rest)
                if not written:
                    raise OSError(ENOSPC, os.strerror(ENOSPC), draft)
                rest = rest[written:]
            os.fsync(fd)
        finally:
            os.close(fd)
    except OSError:
        _drop(draft)
        raise


def publish(draft: str, path: str) -> None:
    """Give a draft its name, in place of what had it. Raises OSError; until the rename the old file is there."""
    try:
        os.rename(draft, path)
    except OSError:
        _drop(draft)
        raise
    # Without this, a power cut can still undo the rename.
    fd = os.open(os.path.dirname(path), os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


def _drop(draft: str) -> None:
    with contextlib.suppress(OSError):
        os.unlink(draft)
