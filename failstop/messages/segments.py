"""Segments: the blocks of POSIX shared memory of a running service, which are files on Linux. The supervisor makes
them, and the other processes attach to them.

Every user may write to /dev/shm, so a malicious user could put files with the names of segments there in advance. For
this reason, the names contain the run's incarnation. This is a random number in the file `run` of the runtime
directory. A process that attaches to a segment also checks the owner, magic number, layout, name, size and incarnation.
If a check fails, the process refuses the segment, with a message that says what to do. A damaged segment is never
repaired, because a restart of the service makes new segments.
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
"""The header of a segment: magic number, hash of the layout, size, incarnation, name, hash of the layout that the C
library knows, version."""
_HEADER_SEED = cell.seed("header", 0)


class AttachError(Exception):
    """A segment can't be used or made. The message says why, and what to do. `kind` is absent, permission, owner,
    damaged, version, or descriptors (this process can open no more files)."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


def memory(instance: str, incarnation: int) -> str:
    """The name that all segments of one run of the service share: the instance and the incarnation of the run."""
    return f"{instance}.{incarnation:016x}"


def path_of(memory: str, segment: str, folder: str = SHM) -> str:
    return f"{folder}/failstop.{memory}.{segment}"


def create(memory: str, name: str, incarnation: int, client_gid: int = -1) -> Segment:
    """Make a segment for this run. Only the supervisor does this. The supervisor also locks its own segment for as long
    as it lives, and lives() checks this lock. If the segment can't be made, raises AttachError, and leaves no
    unfinished segment behind."""
    spec, path = SEGMENT_BY_NAME[name], path_of(memory, name)
    try:
        fd = _make(path)
    except OSError as error:
        raise AttachError("damaged", f"{path} can't be made: {error}") from None
    try:
        if name == SUPERVISOR:
            claim.acquire(fd, 0)
        # Reserve the memory now. If there is not enough, a later access would kill the process with SIGBUS.
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
    """Make a new shared memory object, and return its descriptor. Raises OSError.

    Uses the package posix-ipc if it is installed (it has no wheel for Python 3.14). Otherwise makes the same system
    call as glibc's shm_open()."""
    try:
        import posix_ipc  # imported only here, so that processes that only attach don't load it
    except ModuleNotFoundError:
        return os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | _FLAGS, 0o600)
    try:
        fd: int = posix_ipc.SharedMemory(path.removeprefix(SHM), posix_ipc.O_CREX, mode=0o600).fd
    except posix_ipc.Error as error:
        raise OSError(str(error)) from None
    return fd


def unlink(memory: str, name: str) -> None:
    """Remove the name of a segment. Errors are ignored, because every new run uses new names."""
    with contextlib.suppress(OSError):
        os.unlink(path_of(memory, name))


def unlink_all(memory: str) -> None:
    for spec in layout.SEGMENTS:
        unlink(memory, spec.name)


def living(memory: str) -> bool:
    """True if the supervisor of this run is alive."""
    try:
        fd = os.open(path_of(memory, SUPERVISOR), os.O_RDONLY | _FLAGS)
    except OSError:
        return False
    try:
        return lives(fd)
    except OSError:  # the path is not a regular file
        return False
    finally:
        os.close(fd)


def open_life(memory: str, owner: int) -> int:
    """Open the supervisor's segment, and return a descriptor for lives(). Raises AttachError."""
    return _open(memory, SUPERVISOR, False, owner)


def lives(fd: int) -> bool:
    """True if the supervisor of this run is alive. `fd`: a descriptor of the supervisor's segment. Raises OSError if
    `fd` is not a regular file.

    A live supervisor holds the lock on its segment. Another user can't hold this lock, because it needs the permission
    to write the segment. The check uses no pid, so it works in every container."""
    return claim.held(fd, 0, by_writer=True)


def version(memory: str) -> str:
    """The version of failstop that made the segments of a run. Empty if it can't be read."""
    try:
        with open(path_of(memory, SUPERVISOR), "rb") as file:
            header = _header(file.read(HEADER_BYTES))
    except OSError:
        return ""
    return _version(header[-1]) if header else ""


def _header(raw: bytes) -> tuple[int, int, int, bytes, bytes] | None:
    """Return layout, size, incarnation, name and version from the first bytes of a segment. None if they are not a
    valid header."""
    entry = cell.check(raw, _HEADER_SEED)
    if entry is None or len(entry[2]) != SEGMENT_HEADER.size or not entry[2].startswith(MAGIC):
        return None
    _, fingerprint, size, incarnation, name, _, version = SEGMENT_HEADER.unpack(entry[2])
    return fingerprint, size, incarnation, name.rstrip(b"\0"), version


def _version(told: bytes) -> str:
    return told.rstrip(b"\0").decode("ascii", "replace")


def dead_runs(instance: str) -> list[str]:
    """List this user's runs of an instance that have ended without removing their segments, the newest last. Each run
    has the name that memory() returns."""
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
    """Attach to a segment. Pass write=True only in the process that is declared as the writer of this segment.
    `incarnation`: the expected run; None to accept any. `owner`: the uid of the service; -1 for this process's user.
    Raises AttachError.

    Most segments are mapped into memory. If somebody truncates a mapped file, the kernel kills each process that has
    mapped it (SIGBUS). Therefore the segments that clients may write (their own, and `lifelines`) are not mapped, but
    accessed through their files.
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
    """Open a client's segment so that the service can read it. If this fails, for example because the client has
    removed the segment's name, returns an empty segment.

    The header is not checked, because a client may have overwritten it. The CRC of each record shows whether the record
    belongs to this run, because the CRC includes the run's incarnation."""
    name = f"client.{index}"
    try:
        fd = _open(memory, name, False)
    except AttachError:
        fd = os.open(os.devnull, os.O_RDONLY)
    return Segment(SEGMENT_BY_NAME[name], incarnation, fd=fd)


def open_all(memory: str) -> dict[str, int]:
    """Open the segments of all processes of a run for reading. Returns the descriptors by process name, without
    segments that can't be opened or that belong to another user. The descriptors stay readable after the names of the
    segments were removed."""
    found = {}
    for name in layout.PROCESS_NAMES:
        try:
            found[name] = _open_file(memory, name, os.O_RDONLY, os.geteuid())
        except OSError:
            continue
    return found


def copy(fd: int, memory: str, name: str) -> tuple[int, bytes]:
    """Copy the whole segment that is open as `fd`. Returns (incarnation, bytes). Raises AttachError."""
    return _check_header(fd, memory, SEGMENT_BY_NAME[name], None), os.pread(fd, SEGMENT_BY_NAME[name].size, 0)


def _open_file(memory: str, name: str, flags: int, owner: int) -> int:
    """Open a segment's file, and return the descriptor. Opening never waits, even if somebody has put a pipe at the
    path of the segment. Raises OSError, or place.Untrusted if the file does not belong to `owner`."""
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
    """The words for a segment in messages to people."""
    return f"shared memory {name} of {memory.partition('.')[0]!r}"


def _check_header(fd: int, memory: str, spec: SegmentSpec, incarnation: int | None) -> int:
    """Check a segment's header, and return the segment's incarnation. Raises AttachError."""
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
