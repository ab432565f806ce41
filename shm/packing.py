"""Packing: msgpack for the service's own records, with one small buffer for each process."""

from __future__ import annotations

import msgpack

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

# msgpack.packb allocates 1 MB at every call: a process that is out of memory would die of a remark.
pack: Callable[[object], bytes] = msgpack.Packer(buf_size=8192).pack
"""The bytes of a value. Not for several threads. Raises TypeError, ValueError, OverflowError."""
