"""Views: how the bytes of a segment are reached, by mapping or by pread and pwrite.

The service maps only what it alone can write. What clients may write is read with pread: a file that a client has
truncated is then a short read, which no CRC passes, and not a SIGBUS that kills the reader.
"""

from __future__ import annotations

import os

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Protocol

    class View(Protocol):
        """What a reader or writer needs of a segment: one slice copy out, one slice assignment in."""

        def __getitem__(self, where: slice, /) -> bytes: ...

        def __setitem__(self, where: slice, data: bytes, /) -> None: ...


class FileView:
    """Slices of a file through pread and pwrite; a slice past the end of a truncated file comes back short."""

    __slots__ = ("fd",)

    def __init__(self, fd: int) -> None:
        self.fd = fd

    def __getitem__(self, where: slice) -> bytes:
        return os.pread(self.fd, where.stop - where.start, where.start)

    def __setitem__(self, where: slice, data: bytes) -> None:
        os.pwrite(self.fd, data, where.start)
