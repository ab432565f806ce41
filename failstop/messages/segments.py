"""The segments of a run: POSIX shared memory objects, which are files on Linux. The supervisor creates them; other
processes attach.

Everyone may write to /dev/shm. So each run has names that nobody can know in advance (`memory`: the instance's name and
the run's incarnation), which only the runtime directory reveals (instance.run), and a segment must prove to be the
service's own: attaching checks the owner, then size, magic, layout and the run's incarnation, and refuses with a
message that says what to do. A restart of the service makes new segments; nothing is ever repaired.
"""

from __future__ import annotations

import contextlib
import errno
import mmap
import os
import stat
import struct

from failstop.files import place
from failstop.messages import layout
from failstop.messages.layout import CLIENT_HASH, LAYOUT_HASH, SEGMENT_BY_NAME, SUPERVISOR
from failstop.shm import cell, claim
from failstop.shm.segment import HEADER_BYTES, Segment, SegmentSpec
from failstop.version import VERSION

SHM = "/dev/shm"
MAGIC = b"failstop"
_FLAGS = os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC
SEGMENT_HEADER = struct.Struct("<8sQQQ16sQ24s")
"""Magic, layout, size, incarnation, name, the part of the layout that the C library knows, version."""
_HEADER_SEED = cell.seed("header", 0)


class AttachError(Exception):
    """A segment was refused; the message says why and what to do. `kind`: absent, permission, owner, damaged, version,
    or descriptors (this process has none left)."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


def memory(instance: str, incarnation: int) -> str:
    """The name that all segments of a run share."""
    return f"{instance}.{incarnation:016x}"


def path_of(memory: str, segment: str, folder: str = SHM) -> str:
    return f"{folder}/failstop.{memory}.{segment}"


def create(memory: str, name: str, incarnation: int, client_gid: int = -1) -> Segment:
    """Create a segment of this run. Only the run's supervisor does this; it holds the lock on its own segment for as
    long as it lives. Raises AttachError, and then leaves nothing behind."""
    spec, path = SEGMENT_BY_NAME[name], path_of(memory, name)
    try:
        fd = _make(path)
    except OSError as error:
        raise AttachError("damaged", f"{path} can't be made: {error}") from None
    try:
        if name == SUPERVISOR:
            claim.acquire(fd, 0)
        # Reserve the memory now; otherwise the first touch could be a SIGBUS.
        os.posix_fallocate(fd, 0, spec.size)
        header = SEGMENT_HEADER.pack(
            MAGIC, LAYOUT_HASH, spec.size, incarnation, name.encode(), CLIENT_HASH, VERSION.encode()
        )
        os.pwrite(fd, cell.build(1, 0, header, _HEADER_SEED, HEADER_BYTES - cell.CELL_HEADER_BYTES), 0)
        if spec.mode & 0o020 and client_gid >= 0:
            os.fchown(fd, -1, client_gid)
        os.fchmod(fd, spec.mode)
    except OSError as error:
        os.close(fd)
        unlink(memory, name)
        doubt = "`ulimit -f`" if error.errno == errno.EFBIG else f"`df {SHM}`"
        raise AttachError(
            "damaged", f"no room in {SHM} for {spec.size} bytes ({error.strerror}): look at {doubt}"
        ) from None
    return Segment(spec, incarnation, fd=fd)


def _make(path: str) -> int:
    """A new shared memory object, as its descriptor. Without posix-ipc, which has no wheel for Python 3.14, this makes
    the call that shm_open() of glibc makes. Raises OSError."""
    try:
        import posix_ipc  # here alone: a process that attaches loads nothing for it
    except ModuleNotFoundError:
        return os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | _FLAGS, 0o600)
    try:
        fd: int = posix_ipc.SharedMemory(path.removeprefix(SHM), posix_ipc.O_CREX, mode=0o600).fd
    except posix_ipc.Error as error:
        raise OSError(str(error)) from None
    return fd


def unlink(memory: str, name: str) -> None:
    """Remove a segment's name. It does not matter if the name is gone already or belongs to another user, because
    nobody needs it again."""
    with contextlib.suppress(OSError):
        os.unlink(path_of(memory, name))


def unlink_all(memory: str) -> None:
    for spec in layout.SEGMENTS:
        unlink(memory, spec.name)


def living(memory: str) -> bool:
    """True while this run's supervisor is alive."""
    try:
        fd = os.open(path_of(memory, SUPERVISOR), os.O_RDONLY | _FLAGS)
    except OSError:
        return False
    try:
        return lives(fd)
    except OSError:  # not a regular file
        return False
    finally:
        os.close(fd)


def open_life(memory: str, owner: int) -> int:
    """A descriptor for several calls of lives(). Raises AttachError."""
    return _open(memory, SUPERVISOR, False, owner)


def lives(fd: int) -> bool:
    """True while the run's supervisor is alive: it holds the lock on its segment from the moment it has made it, and
    other users may only read that file. `fd`: a descriptor of it. One system call without a pid, so it works in every
    container. Raises OSError if this is not a regular file."""
    return claim.held(fd, 0, by_writer=True)


def version(memory: str) -> str:
    """The version of failstop that made a run's segments; empty if it can't be read."""
    try:
        with open(path_of(memory, SUPERVISOR), "rb") as file:
            header = _header(file.read(HEADER_BYTES))
    except OSError:
        return ""
    return _version(header[-1]) if header else ""


def _header(raw: bytes) -> tuple[int, int, int, bytes, bytes] | None:
    """Layout, size, incarnation, name and version from a segment's first bytes; None if they are no header."""
    entry = cell.check(raw, _HEADER_SEED)
    if entry is None or len(entry[2]) != SEGMENT_HEADER.size or not entry[2].startswith(MAGIC):
        return None
    _, fingerprint, size, incarnation, name, _, version = SEGMENT_HEADER.unpack(entry[2])
    return fingerprint, size, incarnation, name.rstrip(b"\0"), version


def _version(told: bytes) -> str:
    return told.rstrip(b"\0").decode("ascii", "replace")


def dead_runs(instance: str) -> list[str]:
    """The runs of this name and user that have ended and left segments, by their `memory`, the newest last."""
    found: dict[str, int] = {}
    prefix = f"failstop.{instance}."
    for file in os.listdir(SHM):
        run, dot, name = file.removeprefix(prefix).partition(".")
        if file.startswith(prefix) and dot and name in SEGMENT_BY_NAME:
            try:
                made = os.lstat(os.path.join(SHM, file))
            except FileNotFoundError:
                continue
            if made.st_uid == os.geteuid():
                found[f"{instance}.{run}"] = max(made.st_ctime_ns, found.get(f"{instance}.{run}", 0))
    return [run for run in sorted(found, key=found.__getitem__) if not living(run)]


def attach(memory: str, name: str, incarnation: int | None = None, *, write: bool = False, owner: int = -1) -> Segment:
    """Attach a segment to read, or to write if this process is its declared writer.

    It is mapped, except where several processes write it (clients, or the lifelines' holders): those are accessed
    through the file, so that truncating it causes no SIGBUS. `incarnation` is the expected run; None takes the one that
    exists. `owner`: the uid of the service; -1: this process's. Raises AttachError.
    """
    spec = SEGMENT_BY_NAME[name]
    fd = _open(memory, name, write, owner)
    mapped = None
    try:
        found = _check_header(fd, memory, spec, incarnation)
        if spec.mode == layout.PUBLIC:
            prot = mmap.PROT_READ | (mmap.PROT_WRITE if write else 0)
            mapped = mmap.mmap(fd, spec.size, flags=mmap.MAP_SHARED, prot=prot)
    except BaseException:
        os.close(fd)
        raise
    if mapped is None:
        return Segment(spec, found, fd=fd)
    os.close(fd)
    return Segment(spec, found, mapped)


def read_client_slot(memory: str, index: int, incarnation: int) -> Segment:
    """A client's segment as the service reads it, by records that carry the incarnation in their CRC, because clients
    may have scribbled over its header. A segment whose name was removed counts as unused: it is always empty."""
    name = f"client.{index}"
    try:
        fd = _open(memory, name, False)
    except AttachError:
        fd = os.open(os.devnull, os.O_RDONLY)
    return Segment(SEGMENT_BY_NAME[name], incarnation, fd=fd)


def open_all(memory: str) -> dict[str, int]:
    """Read-only descriptors of the processes' segments, by name, for those that exist. They can be read even after the
    names are removed. Only this user's files."""
    found = {}
    for name in layout.PROCESS_NAMES:
        try:
            found[name] = _open_file(memory, name, os.O_RDONLY, os.geteuid())
        except OSError:
            continue
    return found


def copy(fd: int, memory: str, name: str) -> tuple[int, bytes]:
    """A private copy of the whole segment that is open as `fd`: (incarnation, bytes). Raises AttachError."""
    return _check_header(fd, memory, SEGMENT_BY_NAME[name], None), os.pread(fd, SEGMENT_BY_NAME[name].size, 0)


def _open_file(memory: str, name: str, flags: int, owner: int) -> int:
    """A segment's descriptor. A pipe in its place does not block. Raises OSError, or place.Untrusted (not
    `owner`'s)."""
    path = path_of(memory, name)
    fd = os.open(path, flags | _FLAGS)
    found = os.fstat(fd)
    if stat.S_ISREG(found.st_mode) and found.st_uid == owner:
        return fd
    os.close(fd)
    if stat.S_ISREG(found.st_mode):
        raise place.Untrusted(path, f"belongs to {place.user(found.st_uid)}, the service to {place.user(owner)}")
    raise OSError(errno.EINVAL, "not a regular file", path)


def _open(memory: str, name: str, write: bool, owner: int = -1) -> int:
    where = _described(memory, name)
    try:
        return _open_file(memory, name, os.O_RDWR if write else os.O_RDONLY, os.geteuid() if owner < 0 else owner)
    except FileNotFoundError:
        raise AttachError("absent", f"{where} does not exist: start the service with `failstop run`") from None
    except PermissionError:
        raise AttachError(
            "permission", f"no permission on {where}: join the group `failstop`, or run as its user"
        ) from None
    except place.Untrusted as error:
        raise AttachError("owner", f"{where} is not the service's: {error.strerror}; remove it") from None
    except OSError as error:
        raise AttachError(
            "descriptors" if error.errno == errno.EMFILE else "damaged",
            f"{where} can't be opened ({error.strerror}): restart the service",
        ) from None


def _described(memory: str, name: str) -> str:
    """How messages name this segment."""
    return f"shared memory {name} of {memory.partition('.')[0]!r}"


def _check_header(fd: int, memory: str, spec: SegmentSpec, incarnation: int | None) -> int:
    """Return the segment's incarnation, or raise AttachError."""
    header, where = _header(os.pread(fd, HEADER_BYTES, 0)), _described(memory, spec.name)
    if header is None:
        raise AttachError("damaged", f"{where} has an incomplete header: restart the service")
    fingerprint, size, found, name, version = header
    if fingerprint != LAYOUT_HASH:
        raise AttachError(
            "version",
            f"{where} is of failstop {_version(version)}, this program is {VERSION} with another layout: "
            "use the service's own version, or restart the service after the upgrade",
        )
    if name != spec.name.encode() or size != spec.size or os.fstat(fd).st_size < spec.size:
        raise AttachError("damaged", f"{where} has the wrong size or name: restart the service")
    if incarnation is not None and found != incarnation:
        raise AttachError("damaged", f"{where} is of another run: restart the service")
    return found
