"""The files of incidents: where they are, how many are kept, which one a person means; each is written so that it is
whole or not there, and read so that damage is told.

    "failstop incident\\n" | format u16, 0 u16 | length u32, crc32 u32 of the head | the same of the body | head | body

The head is a msgpack map, small, all that a list needs. The body is a msgpack map too, compressed with zlib. Numbers
are little-endian.
"""

from __future__ import annotations

import contextlib
import os
import struct
import zlib
from itertools import count

import msgpack

from failstop.api import words
from failstop.api.errors import FailstopError
from failstop.files import durable, root
from failstop.files.root import SYSTEM_BASE, state_directory
from failstop.incidents import memory

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from typing import Any

MAGIC = b"failstop incident\n"
FORMAT = 1
SUFFIX = ".incident"
DRAFT = ".draft-"
"""The begin of a file's name while it is written; its writer's pid follows."""
_LENGTHS = struct.Struct("<HHIIII")
START_BYTES = len(MAGIC) + _LENGTHS.size
LONGEST_HEAD = 65536
LONGEST_BODY = 64 * 1024 * 1024
"""Uncompressed; what claims to be longer is damage, and not worth the memory."""
FOLDER = "incidents"
LAST = "last"


class IncidentError(FailstopError):
    """An incident can't be found or read; the message says what is wrong with it."""


@contextlib.contextmanager
def as_written(path: str) -> Iterator[None]:
    """Decode or tell what a file holds. Raises IncidentError where its values are not as failstop writes them."""
    try:
        yield
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError, OSError) as error:
        raise IncidentError(f"{path} is no incident as failstop writes them ({error!r})") from None


def build(head: dict[str, Any], body: dict[str, Any]) -> bytes:
    """The bytes of a file."""
    first: bytes = msgpack.packb(head)
    second = zlib.compress(msgpack.packb(body), 6)
    lengths = _LENGTHS.pack(FORMAT, 0, len(first), zlib.crc32(first), len(second), zlib.crc32(second))
    return MAGIC + lengths + first + second


def write(folder: str, name: str, data: bytes) -> str:
    """Write a file under a new name; returns its path. It is whole, and on the disk, or not there. Raises OSError."""
    os.makedirs(folder, exist_ok=True)
    for entry in os.listdir(folder):
        # Drafts of dead writers take room that this file may need.
        if entry.startswith(DRAFT) and not os.path.exists(f"/proc/{entry.removeprefix(DRAFT)}"):
            with contextlib.suppress(OSError):
                os.unlink(os.path.join(folder, entry))
    draft = os.path.join(folder, f"{DRAFT}{os.getpid()}")
    durable.write_draft(draft, data)
    names = (f"{name}{f'-{number}' * (number > 1)}{SUFFIX}" for number in count(1))
    path = next(path for each in names if not os.path.exists(path := os.path.join(folder, each)))
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


def read(path: str, *, with_body: bool = True) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return (head, body); without its body, that is neither read nor checked. Raises IncidentError."""
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
            body = _part(path, "body", file.read(body_length), body_crc) if with_body else {}
    except OSError as error:
        raise IncidentError(f"{path} can't be read: {error.strerror}") from None
    return head, body


def _part(path: str, what: str, data: bytes, crc: int) -> dict[str, Any]:
    if zlib.crc32(data) != crc:
        raise IncidentError(f"{path} is damaged: its {what} does not match its checksum")
    try:
        if what == "body":
            # A body that is cut off here can't be unpacked.
            data = zlib.decompressobj().decompress(data, LONGEST_BODY)
        found: dict[str, Any] = dict(msgpack.unpackb(data, strict_map_key=False))
    except (zlib.error, ValueError, TypeError, msgpack.UnpackException) as error:
        raise IncidentError(f"{path} is damaged: its {what} can't be decoded ({error})") from None
    return found


def folders(name: str, environ: Mapping[str, str]) -> list[str]:
    """Every folder in which a service of this name may have kept incidents: as one that was started from here, and as
    one of the system's, that systemd gave its state directory."""
    elsewhere = {key: value for key, value in environ.items() if key != "STATE_DIRECTORY"}
    places = [state_directory(name, given) for given in (environ, elsewhere)]
    places.append(os.path.join(root.at(SYSTEM_BASE), name))
    return [path for place in dict.fromkeys(places) if os.path.isdir(path := os.path.join(place, FOLDER))]


def identity(path: str) -> str:
    """The name of an incident: that of its file."""
    return os.path.basename(path).removesuffix(SUFFIX)


def heads(name: str, places: Iterable[str]) -> tuple[list[dict[str, Any]], list[str]]:
    """The heads of a service's incidents in these folders, the oldest first, each with its `id` and `path`; and what is
    wrong with files that can't be read."""
    found: list[dict[str, Any]] = []
    problems = []
    for folder in places:
        try:
            paths = [os.path.join(folder, entry) for entry in sorted(os.listdir(folder)) if entry.endswith(SUFFIX)]
        except OSError as error:
            problems.append(f"{folder} can't be read: {error.strerror}")
            continue
        for path in paths:
            try:
                with as_written(path):
                    head, _ = read(path, with_body=False)
                    words.clock(head["t"]), float(head["saved"]), head["reason"].encode(), memory.proven(head)
                    if head.get("name") == name:
                        found.append({**head, "id": identity(path), "path": path})
            except IncidentError as error:
                problems.append(str(error))
    return sorted(found, key=lambda head: float(head["t"])), problems


def prune(folder: str, name: str, keep: int, most_bytes: int) -> None:
    """Remove the oldest incidents of an instance (several may share a folder) beyond `keep` and `most_bytes` together,
    but the newest. What is no incident is left alone."""
    # By the time of saving: an old run's incident is saved after newer ones of nobody.
    newest_first = sorted(heads(name, [folder])[0], key=lambda head: -float(head["saved"]))
    total = 0
    for index, path in enumerate(head["path"] for head in newest_first):
        with contextlib.suppress(OSError):
            total += os.stat(path).st_size
            if index and (index >= keep or total > most_bytes):
                os.unlink(path)


def find(wanted: str, name: str, environ: Mapping[str, str]) -> str:
    """The path of the incident that is meant by a path, `last`, an id or the beginning of one. Raises IncidentError."""
    if os.sep in wanted or wanted.endswith(SUFFIX):
        return wanted
    places = folders(name, environ)
    # A damaged file is not in the list; whoever names it should be told why.
    if whole := [path for folder in places if os.path.exists(path := os.path.join(folder, wanted + SUFFIX))]:
        return whole[0]
    found, problems = heads(name, places)
    meant = found[-1:] if wanted == LAST else [head for head in found if head["id"].startswith(wanted)]
    if len(meant) == 1:
        return str(meant[0]["path"])
    if meant:
        raise IncidentError(f"incident {wanted!r} may be {', '.join(head['id'] for head in meant)}: write more of it")
    if found:
        raise IncidentError(f"no incident {wanted!r} of {name!r}: `failstop incident list` shows them")
    raise IncidentError("; ".join((f"no incidents of {name!r}: nothing was latched yet, or see --name", *problems)))
