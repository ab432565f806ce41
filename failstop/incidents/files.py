"""The files of incidents: where they are, in which order, how many are kept, which one a person means; each is written
whole or not at all, never over another, and damage is reported when it is read.

The name of a file begins with its number: NUMBER-DATE-TIME-CAUSE.incident. A saver takes the next number of its folder
before anything else, so the numbers are the order of the stops whatever the wall clock says. Files from before there
were numbers count as older than all that have one.

    "failstop incident\\n" | format u16, 0 u16 | length u32, crc32 u32 of the head | the same of the body | head | body

The head is a msgpack map, small, all that a list needs. The body is a msgpack map too, compressed with zlib. Numbers
are little-endian.
"""

from __future__ import annotations

import contextlib
import fcntl
import heapq
import os
import struct
import zlib
from itertools import pairwise

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
"""How a file's name begins while it is written. Its number follows, which is taken as long as the draft exists."""
DIGITS = 6
_LENGTHS = struct.Struct("<HHIIII")
START_BYTES = len(MAGIC) + _LENGTHS.size
LONGEST_HEAD = 65536
LONGEST_BODY = 64 * 1024 * 1024
"""Uncompressed; what claims to be longer is damage, and not worth the memory."""
FOLDER = "incidents"
LAST = "last"
MOST_NAMED = 3
"""How many incidents an error names."""


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


class Draft:
    """A file that is being written. Until write() or drop() its number is taken, and its descriptor holds a lock that
    tells others that the writer lives."""

    def __init__(self, folder: str, number: int, fd: int) -> None:
        self._folder, self._number, self._fd = folder, number, fd

    def write(self, name: str, data: bytes) -> str:
        """Publish the file under its number and this name; returns its path. Raises OSError, and then it is gone."""
        path = os.path.join(self._folder, f"{self._number:0{DIGITS}}-{name}{SUFFIX}")
        try:
            durable.write_all(self._fd, data)
            durable.publish(_draft(self._folder, self._number), path)
        except OSError as error:
            self.drop()
            raise OSError(error.errno, error.strerror, path) from None
        os.close(self._fd)
        return path

    def drop(self) -> None:
        """Give the number back: there is nothing to write, or it could not be written."""
        with contextlib.suppress(OSError):
            os.unlink(_draft(self._folder, self._number))
        os.close(self._fd)


def begin(folder: str) -> Draft:
    """Take the next number of a folder, which is made where it is missing. Raises OSError."""
    os.makedirs(folder, exist_ok=True)
    _clear(folder)
    while True:
        number = 1 + max(_numbers(folder), default=0)
        path = _draft(folder, number)
        try:
            fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644)
        except FileExistsError:
            continue
        draft = Draft(folder, number, fd)
        if not _locked(fd, path):
            os.close(fd)
        elif number in _published(folder):
            # By another saver, after this one had looked for numbers.
            draft.drop()
        else:
            return draft


def write(folder: str, name: str, data: bytes) -> str:
    """Write a file under the next number of a folder and this name; returns its path. It is whole, and on the disk, or
    not there. Raises OSError."""
    return begin(folder).write(name, data)


def _draft(folder: str, number: int) -> str:
    return os.path.join(folder, f"{DRAFT}{number:0{DIGITS}}")


def _locked(fd: int, path: str) -> bool:
    """Lock a draft; False when another process was faster, which then clears it away. Where the file system knows no
    locks it is as good as locked, as nobody can clear it."""
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return os.path.samestat(os.fstat(fd), os.lstat(path))
    except (BlockingIOError, FileNotFoundError):
        return False
    except OSError:
        return True


def _clear(folder: str) -> None:
    """Remove the drafts of writers that died: they take room that the next file may need."""
    for entry in os.listdir(folder):
        if not entry.startswith(DRAFT):
            continue
        with contextlib.suppress(OSError):
            fd = durable.open_own(path := os.path.join(folder, entry))
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
                # The name may be that of a newer draft by now.
                if os.path.samestat(os.fstat(fd), os.lstat(path)):
                    os.unlink(path)
            finally:
                os.close(fd)


def number_of(name: str) -> int:
    """The number in the name of an incident, or of its file; 0: it has none, as it was saved before there were any."""
    first, _, rest = name.partition("-")
    date, _, rest = rest.partition("-")
    return int(first) if first.isdecimal() and first.isascii() and len(date) == 8 and date.isdecimal() and rest else 0


def _published(folder: str) -> set[int]:
    return {number_of(entry) for entry in os.listdir(folder) if entry.endswith(SUFFIX)}


def _numbers(folder: str) -> set[int]:
    """Every number of this folder that is taken."""
    drafts = (entry.removeprefix(DRAFT) for entry in os.listdir(folder) if entry.startswith(DRAFT))
    return _published(folder) | {int(number) for number in drafts if number.isdecimal() and number.isascii()}


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
                raise IncidentError(f"{path} is not an incident file of failstop, or its beginning is missing")
            form, _, head_length, head_crc, body_length, body_crc = _LENGTHS.unpack(start[len(MAGIC) :])
            if form != FORMAT:
                raise IncidentError(
                    f"{path} is of format {form}, but this program reads {FORMAT}: use the newer failstop"
                )
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


def places(name: str, environ: Mapping[str, str]) -> list[str]:
    """Every state directory in which a service of this name may keep files, whether it exists or not: as one that is
    started from here, and as one of the system's, to which systemd gives its state directory."""
    elsewhere = {key: value for key, value in environ.items() if key != "STATE_DIRECTORY"}
    found = [state_directory(name, given) for given in (environ, elsewhere)]
    return list(dict.fromkeys([*found, os.path.join(root.at(SYSTEM_BASE), name)]))


def folders(name: str, environ: Mapping[str, str]) -> list[str]:
    """Every folder in which a service of this name has kept incidents."""
    return [path for place in places(name, environ) if os.path.isdir(path := os.path.join(place, FOLDER))]


def identity(path: str) -> str:
    """The name of an incident: that of its file."""
    return os.path.basename(path).removesuffix(SUFFIX)


def heads(name: str, places: Iterable[str]) -> tuple[list[dict[str, Any]], list[str]]:
    """The heads of a service's incidents in these folders, the oldest first, and what is wrong with files that can't be
    read. Each head gets its `id`, its `path`, and `clock_jump_s`: how far the wall clock is known to have jumped since
    the incident before it in its folder, in s, negative: back.

    The order of each folder is that of its numbers. No number orders two folders, so these are merged by time."""
    found: list[list[dict[str, Any]]] = []
    problems = []
    for folder in places:
        try:
            paths = [os.path.join(folder, entry) for entry in sorted(os.listdir(folder)) if entry.endswith(SUFFIX)]
        except OSError as error:
            problems.append(f"{folder} can't be read: {error.strerror}")
            continue
        found.append([])
        for path in paths:
            try:
                with as_written(path):
                    head, _ = read(path, with_body=False)
                    words.clock(head["t"]), float(head["saved"]), head["reason"].encode(), memory.proven(head)
                    if head.get("name") == name:
                        found[-1].append({**head, "id": identity(path), "path": path, "clock_jump_s": 0.0})
            except IncidentError as error:
                problems.append(str(error))
        found[-1].sort(key=lambda head: (number_of(head["id"]), float(head["t"])))
        for before, head in pairwise(found[-1]):
            head["clock_jump_s"] = _jump(before, head)
    return list(heapq.merge(*found, key=lambda head: float(head["t"]))), problems


def _jump(before: dict[str, Any], head: dict[str, Any]) -> float:
    """How far the wall clock is known to have jumped between two incidents, in s; 0: not that anybody could tell."""
    was_ns, is_ns = (each.get("unix_minus_monotonic_ns") for each in (before, head))
    apart_s = float(head["t"]) - float(before["t"])
    if before.get("run") == head.get("run") and isinstance(was_ns, int) and isinstance(is_ns, int):
        # One run counts both by the same monotonic clock.
        return words.clock_jump(apart_s, apart_s - (is_ns - was_ns) / 1e9)
    return min(0.0, words.clock_jump(apart_s, 0.0))


def jumped(head: dict[str, Any]) -> str:
    """A note on the wall clock of an incident, for people; empty: nothing is known against it."""
    seconds: float = head["clock_jump_s"]
    return f"before this incident {words.jumped(seconds)}" if seconds else ""


def prune(folder: str, name: str, keep: int, most_bytes: int) -> None:
    """Remove the oldest incidents of an instance (several may share a folder) beyond `keep` and `most_bytes` together,
    but the newest. What is no incident is left alone."""
    total = 0
    for index, path in enumerate(head["path"] for head in reversed(heads(name, [folder])[0])):
        with contextlib.suppress(OSError):
            total += os.stat(path).st_size
            if index and (index >= keep or total > most_bytes):
                os.unlink(path)


def find(wanted: str, name: str, environ: Mapping[str, str]) -> str:
    """The path of the incident that is meant by a path, `last`, an id, its number, the beginning of one with or without
    its number, or its date, its time or both as the screens show them. Raises IncidentError."""
    if os.sep in wanted or wanted.endswith(SUFFIX):
        return wanted
    there = folders(name, environ)
    # A damaged file is not in the list; whoever names it should be told why.
    if whole := [path for folder in there if os.path.exists(path := os.path.join(folder, wanted + SUFFIX))]:
        return whole[0]
    found, problems = heads(name, there)
    meant = found[-1:] if wanted == LAST else _meant(wanted, found)
    if len(meant) == 1:
        return str(meant[0]["path"])
    if meant:
        ids = [str(head["id"]) for head in meant[-MOST_NAMED:]]
        more = f" or one of {len(meant) - len(ids)} older ones" if len(meant) > len(ids) else ""
        raise IncidentError(f"incident {wanted!r} could be {', '.join(ids)}{more}: write more of its id, or its number")
    if found:
        listing = words.named("`failstop incident list`", name)
        raise IncidentError(
            f"no incident {wanted!r} of {name!r}: {listing} shows them; if it is another robot's, add --name"
        )
    raise IncidentError("; ".join((nothing(name, environ), *problems)))


def _meant(wanted: str, found: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The heads that a person may mean: those of this number, else those whose id, or its part after the number, begins
    like this, else those whose date and time, or whose time, begins like this as the screens show it."""
    if wanted.isdecimal() and (numbered := [head for head in found if number_of(head["id"]) == int(wanted) > 0]):
        return numbered
    ids = ((head, head["id"]) for head in found)
    named = [
        head for head, it in ids if it.startswith(wanted) or (number_of(it) and it.partition("-")[2].startswith(wanted))
    ]
    return named or [head for head in found if _shown_at(head, wanted)]


def _shown_at(head: dict[str, Any], wanted: str) -> bool:
    """Whether the screens show an incident with a date and time that begins like this, or with such a time of day."""
    date_and_time = words.clock(head["t"])
    with_time = ":" in wanted and date_and_time.partition(" ")[2].startswith(wanted)
    return with_time or date_and_time.startswith(wanted)


def nothing(name: str, environ: Mapping[str, str]) -> str:
    """What to say where no incident is found: that none is saved, and what is known to keep one from being saved."""
    where = places(name, environ)
    reasons = [why for place in where if os.path.isdir(place) and (why := durable.no_room(place))]
    reasons = list(dict.fromkeys(reasons)) or [why for why in [durable.no_room(where[0])] if why]
    if reasons:
        return (
            f"no incident of {name!r} is saved, and {' and '.join(reasons)}, so stops leave no file until there is room"
        )
    return (
        f"no incident of {name!r} is saved in {' or '.join(where)}: see "
        f"{words.named('`failstop events`', name)}, or name another with --name"
    )
