"""The file of an incident: how it is written so that it is whole or not there, and read so that damage is told.

    "failstop incident\\n" | format u16, 0 u16 | length u32, crc32 u32 of the head | the same of the body | head | body

The head is a msgpack map, small, all that a list needs. The body is a msgpack map too, compressed with zlib. Numbers
are little-endian.
"""

from __future__ import annotations

import contextlib
import os
import struct
from itertools import count
from zlib import compress, crc32, decompressobj
from zlib import error as ZlibError

import msgpack

from failstop.api.errors import FailstopError
from failstop.shm import durable

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

MAGIC = b"failstop incident\n"
FORMAT = 1
SUFFIX = ".incident"
DRAFT = ".draft-"
"""What a file is named while it is written, then its writer's pid."""
_LENGTHS = struct.Struct("<HHIIII")
START_BYTES = len(MAGIC) + _LENGTHS.size
LONGEST_HEAD = 65536
LONGEST_BODY = 64 * 1024 * 1024
"""Uncompressed; what claims to be longer is damage, and not worth the memory."""


class IncidentError(FailstopError):
    """An incident can't be found or read; the message says what is wrong with it."""


def build(head: dict[str, Any], body: dict[str, Any]) -> bytes:
    """The bytes of a file."""
    first: bytes = msgpack.packb(head)
    second = compress(msgpack.packb(body), 6)
    lengths = _LENGTHS.pack(FORMAT, 0, len(first), crc32(first), len(second), crc32(second))
    return MAGIC + lengths + first + second


def write(folder: str, name: str, data: bytes) -> str:
    """Write a file under a name that nobody has yet; returns its path. It is whole, and on the disk, or not there.
    Raises OSError."""
    os.makedirs(folder, exist_ok=True)
    clear_drafts(folder)
    draft = os.path.join(folder, f"{DRAFT}{os.getpid()}")
    durable.write_draft(draft, data)
    path = _free(folder, name)
    durable.publish(draft, path)
    return path


def write_as(path: str, data: bytes) -> None:
    """Write a file of a person's choice, whole or not at all. Raises IncidentError."""
    draft = f"{path}.part"
    try:
        durable.write_draft(draft, data)
        durable.publish(draft, path)
    except OSError as error:
        raise IncidentError(f"{path} can't be written: {error.strerror}") from None


def _free(folder: str, name: str) -> str:
    names = (f"{name}{f'-{number}' * (number > 1)}{SUFFIX}" for number in count(1))
    return next(path for each in names if not os.path.exists(path := os.path.join(folder, each)))


def clear_drafts(folder: str) -> None:
    """Remove what writers that are dead have left."""
    for entry in os.listdir(folder):
        pid = entry[len(DRAFT) :]
        if entry.startswith(DRAFT) and pid.isdigit() and not os.path.exists(f"/proc/{pid}"):
            with contextlib.suppress(OSError):
                os.unlink(os.path.join(folder, entry))


def read_head(path: str) -> dict[str, Any]:
    """The head alone, the body neither read nor checked. Raises IncidentError."""
    return _read(path, with_body=False)[0]


def read(path: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return (head, body). Raises IncidentError."""
    return _read(path, with_body=True)


def _read(path: str, *, with_body: bool) -> tuple[dict[str, Any], dict[str, Any]]:
    try:
        with open(durable.open_regular(path), "rb") as file:
            start = file.read(START_BYTES)
            if len(start) < START_BYTES or not start.startswith(MAGIC):
                raise IncidentError(f"{path} is no incident of failstop, or its beginning is lost")
            form, _, head_length, head_crc, body_length, body_crc = _LENGTHS.unpack(start[len(MAGIC) :])
            if form != FORMAT:
                raise IncidentError(f"{path} is of format {form}, this program reads {FORMAT}: use the newer failstop")
            whole = START_BYTES + head_length + body_length
            found = os.fstat(file.fileno()).st_size
            if found < whole or head_length > LONGEST_HEAD:
                raise IncidentError(f"{path} is cut short: {found} of {whole} bytes; copy it again, if it is a copy")
            head = _part(path, "head", file.read(head_length), head_crc)
            body = _part(path, "body", file.read(body_length), body_crc, packed=True) if with_body else {}
    except OSError as error:
        raise IncidentError(f"{path} can't be read: {error.strerror}") from None
    return head, body


def _part(path: str, what: str, data: bytes, crc: int, *, packed: bool = False) -> dict[str, Any]:
    if crc32(data) != crc:
        raise IncidentError(f"{path} is damaged: its {what} does not match its checksum")
    try:
        found: dict[str, Any] = msgpack.unpackb(_inflate(data) if packed else data, strict_map_key=False)
    except (ZlibError, ValueError, msgpack.UnpackException) as error:
        raise IncidentError(f"{path} is damaged: its {what} can't be decoded ({error})") from None
    return found


def _inflate(data: bytes) -> bytes:
    inflater = decompressobj()
    found = inflater.decompress(data, LONGEST_BODY)
    if inflater.unconsumed_tail:
        raise ValueError(f"more than {LONGEST_BODY} bytes")
    return found
