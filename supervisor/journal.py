"""Journal: entries for systemd's journal in its native protocol, one datagram each, never waited for.

An entry is a list of fields. `NAME=value` and a line break; a value with a line break in it goes as the name, a line
break, its length as a little-endian u64, the value, a line break.
"""

from __future__ import annotations

import os

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterable

    Value = str | int | float

SOCKET = "/run/systemd/journal/socket"
STDERR = 2


def is_stderr(stream: str) -> bool:
    """True when `stream`, the DEVICE:INODE of $JOURNAL_STREAM, is this process's stderr: then the journal is where its
    lines go. A stderr that was redirected since has another device or inode."""
    try:
        found = os.fstat(STDERR)
    except OSError:
        return False
    return stream == f"{found.st_dev}:{found.st_ino}"


def encode(fields: Iterable[tuple[str, Value]]) -> bytes:
    """The datagram of one entry."""
    parts = []
    for name, value in fields:
        data = str(value).encode("utf-8", "replace")
        if b"\n" in data:
            parts.append(b"%s\n%s%s\n" % (name.encode("ascii"), len(data).to_bytes(8, "little"), data))
        else:
            parts.append(b"%s=%s\n" % (name.encode("ascii"), data))
    return b"".join(parts)
