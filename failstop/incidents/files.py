"""Files: where incidents are saved, how many are kept, and which file a person means. A file is written completely or
not at all, and never replaces another. A damaged file is reported when it is read.

A file's name is NUMBER-DATE-TIME-CAUSE.incident. A saver takes the next number of its folder before it does anything
else. So the numbers show the order of the stops even if the wall clock is wrong. Files without a number count as older
than all files with a number.

    "failstop incident\\n" | format u16, 0 u16 | length u32, crc32 u32 of the head | the same of the body | head | body

The head is a small msgpack map with everything that a list of incidents needs. The body is a msgpack map too,
compressed with zlib. Numbers are little-endian.
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
"""The beginning of a file's name while the file is being written. The file's number follows, so the number is taken
while the draft exists."""
DIGITS = 6
_LENGTHS = struct.Struct("<HHIIII")
START_BYTES = len(MAGIC) + _LENGTHS.size
LONGEST_HEAD = 65536
LONGEST_BODY = 64 * 1024 * 1024
"""The longest allowed body, in bytes when uncompressed. A longer one must be damaged, and is not read into memory."""
FOLDER = "incidents"
LAST = "last"
MOST_NAMED = 3
"""How many incidents an error message names."""


_UNEXPECTED = (
    LookupError,
    TypeError,
    ValueError,
    AttributeError,
    ArithmeticError,
    RecursionError,
    OSError,
    struct.error,
)
"""What code raises if a file has values that failstop does not write."""


class IncidentError(FailstopError):
    """An incident can't be found, read or written. The message says what is wrong."""

    def __init__(self, text: str) -> None:
        super().__init__(words.printable(text))  # most messages have the file's path, which anybody may have chosen


@contextlib.contextmanager
def as_written(path: str) -> Iterator[None]:
    """Context manager for code that reads values from a file. Unexpected values raise IncidentError with the file's
    path."""
    try:
        yield
    except _UNEXPECTED as error:
        raise IncidentError(f"{path} is no incident as failstop writes them ({error!r})") from None


def build(head: dict[str, Any], body: dict[str, Any]) -> bytes:
    """The bytes of an incident file."""
    first: bytes = msgpack.packb(head)
    second = zlib.compress(msgpack.packb(body), 6)
    lengths = _LENGTHS.pack(FORMAT, 0, len(first), zlib.crc32(first), len(second), zlib.crc32(second))
    return MAGIC + lengths + first + second


class Draft:
    """A file that is being written. Until write() or drop() is called, its number is taken, and its descriptor holds a
    lock. The lock shows other processes that the writer is alive."""

    def __init__(self, folder: str, number: int, fd: int) -> None:
        self._folder, self._number, self._fd = folder, number, fd

    def write(self, name: str, data: bytes) -> str:
        """Save the data under the draft's number and this name. Returns the file's path. If this fails, removes the
        draft and raises OSError."""
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
        """Remove the draft, so that its number is free again. Call it if there is nothing to write, or if writing
        failed."""
        with contextlib.suppress(OSError):
            os.unlink(_draft(self._folder, self._number))
        os.close(self._fd)


def begin(folder: str) -> Draft:
    """Begin a new file in a folder, and take the folder's next number for it. The folder is made if needed. Raises
    OSError."""
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
            # Another saver has published this number after we looked for a free one.
            draft.drop()
        else:
            return draft


def write(folder: str, name: str, data: bytes) -> str:
    """Save data in a folder under the next number and this name, completely or not at all. Returns the file's path.
    Raises OSError."""
    return begin(folder).write(name, data)


def _draft(folder: str, number: int) -> str:
    return os.path.join(folder, f"{DRAFT}{number:0{DIGITS}}")


def _locked(fd: int, path: str) -> bool:
    """Lock a new draft. Returns False if another process has locked or removed the draft. Returns True on a file system
    without locks, where no other process removes drafts."""
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return os.path.samestat(os.fstat(fd), os.lstat(path))
    except (BlockingIOError, FileNotFoundError):
        return False
    except OSError:
        return True


def _clear(folder: str) -> None:
    """Remove the drafts of writers that died. They use up space that the next file may need."""
    for entry in os.listdir(folder):
        if not entry.startswith(DRAFT):
            continue
        with contextlib.suppress(OSError):
            fd = durable.open_own(path := os.path.join(folder, entry))
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
                # A newer draft may have the same name by now, so compare the files.
                if os.path.samestat(os.fstat(fd), os.lstat(path)):
                    os.unlink(path)
            finally:
                os.close(fd)


def number_of(name: str) -> int:
    """The number in the name of an incident or its file. 0 if the name has no number."""
    first, _, rest = name.partition("-")
    date, _, rest = rest.partition("-")
    return int(first) if first.isdecimal() and first.isascii() and len(date) == 8 and date.isdecimal() and rest else 0


def _published(folder: str) -> set[int]:
    return {number_of(entry) for entry in os.listdir(folder) if entry.endswith(SUFFIX)}


def _numbers(folder: str) -> set[int]:
    """All numbers of this folder that are taken."""
    drafts = (entry.removeprefix(DRAFT) for entry in os.listdir(folder) if entry.startswith(DRAFT))
    return _published(folder) | {int(number) for number in drafts if number.isdecimal() and number.isascii()}


def write_as(path: str, data: bytes) -> None:
    """Write a file to a path that a person has chosen, as durable.replace(). Raises IncidentError."""
    try:
        durable.replace(path, data)
    except OSError as error:
        raise IncidentError(f"{path} can't be written: {error.strerror}") from None


def read(path: str, *, with_body: bool = True) -> tuple[dict[str, Any], dict[str, Any]]:
    """Read a file. Returns (head, body). Without `with_body` the body is {}, and is neither read nor checked. Raises
    IncidentError."""
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
        raise IncidentError(_unreadable(path, error)) from None
    return head, body


def _part(path: str, what: str, data: bytes, crc: int) -> dict[str, Any]:
    if zlib.crc32(data) != crc:
        raise IncidentError(f"{path} is damaged: its {what} does not match its checksum")
    try:
        if what == "body":
            # A body that is too long is cut off, and then can't be unpacked.
            data = zlib.decompressobj().decompress(data, LONGEST_BODY)
        found: dict[str, Any] = dict(msgpack.unpackb(data, strict_map_key=False))
    except (zlib.error, ValueError, TypeError, msgpack.UnpackException) as error:
        raise IncidentError(f"{path} is damaged: its {what} can't be decoded ({error})") from None
    return found


def places(name: str, environ: Mapping[str, str]) -> list[str]:
    """The state directories in which a service of this name may keep its files, for a service started from here and for
    a service of the system. They may not exist."""
    elsewhere = {key: value for key, value in environ.items() if key != "STATE_DIRECTORY"}
    found = [state_directory(name, given) for given in (environ, elsewhere)]
    return list(dict.fromkeys([*found, os.path.join(root.at(SYSTEM_BASE), name)]))


def folders(name: str, environ: Mapping[str, str]) -> list[str]:
    """The existing folders in which a service of this name has saved incidents. A folder that this user can't see may
    exist, so it is one of them."""
    found = [os.path.join(place, FOLDER) for place in places(name, environ)]
    return [path for path in found if os.path.isdir(path) or not (os.path.exists(path) or durable.missing(path))]


def _unreadable(path: str, error: OSError) -> str:
    """The message about a file or a folder that can't be read, with the remedy."""
    if isinstance(error, PermissionError):
        return f"{path} can't be read by this user, so use sudo: sudo failstop incident ..."
    return f"{path} can't be read: {error.strerror}"


def identity(path: str) -> str:
    """The id of an incident: the name of its file, without the suffix."""
    return os.path.basename(path).removesuffix(SUFFIX)


def heads(name: str, places: Iterable[str]) -> tuple[list[dict[str, Any]], list[str]]:
    """Read the heads of a service's incidents in these folders. Returns the heads, the oldest first, and a message for
    each file or folder that can't be read.

    Each head gets three more keys. `id` and `path` identify the file. `clock_jump_s` is how far the wall clock is known
    to have jumped since the previous incident in the folder, in s. It is negative if the clock jumped back.

    Within a folder, the numbers decide the order. Between folders, the time does.
    """
    found: list[list[dict[str, Any]]] = []
    problems = []
    for folder in places:
        try:
            paths = [os.path.join(folder, entry) for entry in sorted(os.listdir(folder)) if entry.endswith(SUFFIX)]
        except OSError as error:
            problems.append(_unreadable(folder, error))
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
    """How far the wall clock is known to have jumped between two incidents, in s. 0 if no jump is known."""
    was_ns, is_ns = (each.get("unix_minus_monotonic_ns") for each in (before, head))
    apart_s = float(head["t"]) - float(before["t"])
    if before.get("run") == head.get("run") and isinstance(was_ns, int) and isinstance(is_ns, int):
        # Both incidents are of one run, so their monotonic times are of the same clock.
        return words.clock_jump(apart_s, apart_s - (is_ns - was_ns) / 1e9)
    return min(0.0, words.clock_jump(apart_s, 0.0))


def jumped(head: dict[str, Any]) -> str:
    """A note for people that the wall clock jumped before this incident. Empty if no jump is known."""
    seconds: float = head["clock_jump_s"]
    return f"before this incident {words.jumped(seconds)}" if seconds else ""


def prune(folder: str, name: str, keep: int, most_bytes: int) -> None:
    """Remove a service's oldest incidents until at most `keep` incidents and `most_bytes` bytes are left. The newest
    incident, other services' incidents and other files always stay."""
    total = 0
    for index, path in enumerate(head["path"] for head in reversed(heads(name, [folder])[0])):
        with contextlib.suppress(OSError):
            total += os.stat(path).st_size
            if index and (index >= keep or total > most_bytes):
                os.unlink(path)


def find(wanted: str, name: str, environ: Mapping[str, str]) -> str:
    """The path of the incident that a person means by `wanted`: a path, `last`, an id, a number, the beginning of an id
    with or without its number, or a date or time as the screens show it. Raises IncidentError."""
    if os.sep in wanted or wanted.endswith(SUFFIX):
        return wanted
    there = folders(name, environ)
    # A damaged file is not in the list. Return its path, so that reading it shows what is wrong.
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
    # If a folder can't be listed, nobody knows whether it has incidents.
    none = nothing(name, environ) if all(map(_listed, there)) else f"no incident {wanted!r} of {name!r} was found"
    raise IncidentError("; ".join((none, *problems)))


def _listed(folder: str) -> bool:
    try:
        os.listdir(folder)
    except OSError:
        return False
    return True


def _meant(wanted: str, found: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The heads of the incidents that a person may mean. `wanted` is tried as a number, then as the beginning of an id
    with or without its number, then as the beginning of a date or time. The first match counts."""
    if wanted.isdecimal() and (numbered := [head for head in found if number_of(head["id"]) == int(wanted) > 0]):
        return numbered
    ids = ((head, head["id"]) for head in found)
    named = [
        head for head, it in ids if it.startswith(wanted) or (number_of(it) and it.partition("-")[2].startswith(wanted))
    ]
    return named or [head for head in found if _shown_at(head, wanted)]


def _shown_at(head: dict[str, Any], wanted: str) -> bool:
    """True if an incident's date and time begin with `wanted` on the screens. With a colon, `wanted` may also be the
    beginning of the time of day."""
    date_and_time = words.clock(head["t"])
    with_time = ":" in wanted and date_and_time.partition(" ")[2].startswith(wanted)
    return with_time or date_and_time.startswith(wanted)


def nothing(name: str, environ: Mapping[str, str]) -> str:
    """The message for people if no incident was found. It says so if the disk has no room for incidents."""
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
