"""Segments: POSIX shared memory objects, created by the supervisor and attached by everyone else.

Attaching checks size, magic, layout and the run's incarnation, and refuses with a message that says what to do. A
restart of the service makes new segments; nothing is ever repaired.
"""

from __future__ import annotations

import errno
import mmap
import os
import stat
import struct

import posix_ipc

from failstop.shm import slot
from failstop.shm.latest import LatestReader, LatestWriter
from failstop.shm.layout import BY_NAME, CLIENTS, HEADER_BYTES, LAYOUT_HASH, PROCESSES, SEGMENTS
from failstop.shm.mutex import Mutexes
from failstop.shm.ring import RingReader, RingWriter
from failstop.shm.views import FileView
from failstop.shm.words import Word
from failstop.version import VERSION

MAGIC = b"failstop"
SUPERVISOR_COMM = "fs:supervisor"
"""What the kernel shows as the supervisor's name."""
_HEADER = struct.Struct("<8sQQQ24s24s")
_HEADER_SEED = slot.seed("header", 0)

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.shm.layout import Record, SegmentSpec
    from failstop.shm.views import View


class AttachError(Exception):
    """A segment was refused; the message says why and what to do. `kind`: absent, permission, damaged, version, or
    descriptors (this process has none left)."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


def shm_name(instance: str, segment: str) -> str:
    """Name of a segment's POSIX shared memory object."""
    return f"/failstop.{instance}.{segment}"


class Segment:
    """One segment as this process sees it: mapped (its own, or read-only), or through pread for client segments."""

    __slots__ = ("_fd", "incarnation", "mapped", "spec", "view")

    def __init__(self, spec: SegmentSpec, incarnation: int, view: View, mapped: mmap.mmap | None, fd: int) -> None:
        self.spec = spec
        self.incarnation = incarnation
        self.view = view
        self.mapped = mapped
        self._fd = fd

    def _place(self, name: str, kind: str) -> tuple[Record, int, int]:
        record = self.spec.records[name]
        if record.kind != kind:
            raise TypeError(f"{self.spec.name}.{name} is a {record.kind}, not a {kind}")
        return record, self.spec.offsets[name], slot.seed(f"{self.spec.name}.{name}", self.incarnation)

    def word(self, name: str) -> Word:
        """A lone u64; only in mapped segments."""
        _, offset, _ = self._place(name, "word")
        if self.mapped is None:
            raise TypeError(f"{self.spec.name}.{name}: words are only read through a mapping")
        return Word(self.mapped, offset)

    def latest_reader(self, name: str) -> LatestReader:
        """Reader of a Latest record."""
        record, offset, seed = self._place(name, "latest")
        return LatestReader(self.view, offset, record.capacity, seed)

    def latest_writer(self, name: str) -> LatestWriter:
        """The writer of a Latest record; only for the segment's declared writer."""
        record, offset, seed = self._place(name, "latest")
        return LatestWriter(self.view, offset, record.capacity, seed)

    def ring_reader(self, name: str, *, from_oldest: bool = False) -> RingReader:
        """Reader of a Ring record, from the oldest entry still there or from the next one to come."""
        record, offset, seed = self._place(name, "ring")
        return RingReader(self.view, offset, record.capacity, record.slots, seed, from_oldest=from_oldest)

    def ring_writer(self, name: str) -> RingWriter:
        """The writer of a Ring record; only for the segment's declared writer."""
        record, offset, seed = self._place(name, "ring")
        return RingWriter(self.view, offset, record.capacity, record.slots, seed)

    def mutexes(self, name: str) -> Mutexes:
        """The mutexes that lifelines hang on; only in a segment that is mapped for writing."""
        _, offset, _ = self._place(name, "mutexes")
        if self.mapped is None:
            raise TypeError(f"{self.spec.name}.{name}: mutexes need a mapping")
        return Mutexes(self.mapped, offset)

    def wipe(self) -> None:
        """Empty every record of a client's own slot, whatever its holder before left there."""
        self.view[HEADER_BYTES : self.spec.size] = bytes(self.spec.size - HEADER_BYTES)

    def fileno(self) -> int:
        """The descriptor of an unmapped segment; else -1."""
        return self._fd

    def close(self) -> None:
        """Give the descriptor of an unmapped segment back; a mapping ends when its last word or reader is gone."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


def create(instance: str, name: str, incarnation: int, client_gid: int = -1) -> Segment:
    """Create a segment of this run; one that a dead run left is unlinked first. The supervisor only.

    Raises AttachError (permission) when another user's segment of that name is in the way.
    """
    spec = BY_NAME[name]
    unlink(instance, name)
    memory = posix_ipc.SharedMemory(shm_name(instance, name), posix_ipc.O_CREX, mode=0o600, size=spec.size)
    fd: int = memory.fd
    try:
        os.posix_fallocate(fd, 0, spec.size)
    except OSError as error:
        os.close(fd)
        unlink(instance, name)
        # Found at the first touch it would be a SIGBUS.
        raise AttachError(
            "damaged", f"no room in /dev/shm for {spec.size} bytes ({error.strerror}): look at `df /dev/shm`"
        ) from None
    header = _HEADER.pack(MAGIC, LAYOUT_HASH, spec.size, incarnation, name.encode(), VERSION.encode())
    os.pwrite(fd, slot.build(1, 0, header, _HEADER_SEED, HEADER_BYTES - slot.HEADER_BYTES), 0)
    if spec.mode & 0o020 and client_gid >= 0:
        os.fchown(fd, -1, client_gid)
    os.fchmod(fd, spec.mode)
    return Segment(spec, incarnation, FileView(fd), None, fd)


def unlink(instance: str, name: str) -> None:
    """Remove a segment's name; one that is not there is fine."""
    try:
        posix_ipc.unlink_shared_memory(shm_name(instance, name))
    except posix_ipc.ExistentialError:
        pass
    except (posix_ipc.PermissionsError, OSError):
        raise AttachError(
            "permission",
            f"shared memory {shm_name(instance, name)} belongs to another user: stop that service, or use --name",
        ) from None


def living_supervisor(instance: str) -> int:
    """Pid of the supervisor that these segments say they are of, if it lives; else 0. It may serve another runtime
    directory, under the same name."""
    try:
        pid = attach(instance, "supervisor").word("beat_pid").get()
        with open(f"/proc/{pid}/comm", encoding="ascii", errors="replace") as file:
            return pid if file.read() == f"{SUPERVISOR_COMM}\n" else 0
    except (AttachError, OSError):
        return 0


def unlink_all(instance: str) -> None:
    """Remove every segment of an instance."""
    for spec in SEGMENTS:
        unlink(instance, spec.name)


def attach(instance: str, name: str, incarnation: int | None = None, *, write: bool = False) -> Segment:
    """Map a service segment: read-only, or for writing when this process is its declared writer. Never a client's:
    what clients may truncate is not mapped.

    `incarnation` is the run that is expected; None takes the run that is there (clients). Raises AttachError.
    """
    spec = BY_NAME[name]
    if spec.mode == CLIENTS:
        raise TypeError(f"{name} is written by clients: use attach_client_slot or read_client_slot")
    fd = _open(instance, name, write)
    try:
        found = _check_header(fd, instance, spec, incarnation)
        prot = mmap.PROT_READ | (mmap.PROT_WRITE if write else 0)
        mapped = mmap.mmap(fd, spec.size, flags=mmap.MAP_SHARED, prot=prot)
    finally:
        os.close(fd)
    return Segment(spec, found, mapped, mapped, -1)


def attach_client_slot(instance: str, index: int, incarnation: int) -> Segment:
    """A client's own segment, through pread and pwrite: another client that truncates it costs no SIGBUS here."""
    name = f"client.{index}"
    fd = _open(instance, name, True)
    try:
        _check_header(fd, instance, BY_NAME[name], incarnation)
    except BaseException:
        os.close(fd)
        raise
    return Segment(BY_NAME[name], incarnation, FileView(fd), None, fd)


def read_client_slot(instance: str, index: int, incarnation: int) -> Segment:
    """A client's segment as the service reads it. Its header is not looked at: clients may have scribbled over it,
    and each record carries the incarnation in its CRC."""
    name = f"client.{index}"
    return Segment(BY_NAME[name], incarnation, FileView(fd := _open(instance, name, False)), None, fd)


def no_client_slot(index: int, incarnation: int) -> Segment:
    """In the place of a client's segment that can't be opened: nothing is ever in it."""
    fd = os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC)
    return Segment(BY_NAME[f"client.{index}"], incarnation, FileView(fd), None, fd)


def open_all(instance: str) -> dict[str, int]:
    """Read-only descriptors of the processes' segments, by name, as far as they are there: what is unlinked later can
    still be read through them. Only files of this user's: a dead run's names may have been taken by others."""
    found = {}
    for name in PROCESSES:
        try:
            fd = _open_file(instance, name, os.O_RDONLY)
        except OSError:
            continue
        if os.fstat(fd).st_uid == os.geteuid():
            found[name] = fd
        else:
            os.close(fd)
    return found


def copy(fd: int, instance: str, name: str) -> tuple[int, bytes]:
    """A private copy of a whole segment that is open as `fd`: (incarnation, bytes). Raises AttachError."""
    spec = BY_NAME[name]
    incarnation = _check_header(fd, instance, spec, None)
    data = os.pread(fd, spec.size, 0)
    return incarnation, data


def _open_file(instance: str, name: str, flags: int) -> int:
    """A segment's descriptor. Raises OSError. Not by shm_open, which waits for ever on a pipe that somebody has put
    there."""
    fd = os.open(f"/dev/shm{shm_name(instance, name)}", flags | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC)
    if not stat.S_ISREG(os.fstat(fd).st_mode):
        os.close(fd)
        raise OSError(errno.EINVAL, "not a regular file", shm_name(instance, name))
    return fd


def _open(instance: str, name: str, write: bool) -> int:
    try:
        return _open_file(instance, name, os.O_RDWR if write else os.O_RDONLY)
    except FileNotFoundError:
        raise AttachError(
            "absent", f"no service named {instance!r} has shared memory {name}: start it with `failstop run`"
        ) from None
    except PermissionError:
        raise AttachError(
            "permission",
            f"no permission on shared memory {name} of {instance!r}: join the group `failstop`, or run as its user",
        ) from None
    except OSError as error:
        raise AttachError(
            "descriptors" if error.errno == errno.EMFILE else "damaged",
            f"shared memory {name} of {instance!r} can't be opened ({error.strerror}): restart the service",
        ) from None


def _check_header(fd: int, instance: str, spec: SegmentSpec, incarnation: int | None) -> int:
    """Return the segment's incarnation, or raise AttachError."""
    entry = slot.check(os.pread(fd, HEADER_BYTES, 0), _HEADER_SEED)
    where = f"shared memory {spec.name} of {instance!r}"
    if entry is None or len(entry[2]) != _HEADER.size or not entry[2].startswith(MAGIC):
        raise AttachError("damaged", f"{where} has no whole header: restart the service")
    _, layout, size, found, name, version = _HEADER.unpack(entry[2])
    if layout != LAYOUT_HASH:
        theirs = version.rstrip(b"\0").decode("ascii", "replace")
        raise AttachError(
            "version",
            f"{where} is of failstop {theirs}, this program is {VERSION} with another layout: "
            "use the service's own version, or restart the service after the upgrade",
        )
    if name.rstrip(b"\0") != spec.name.encode() or size != spec.size or os.fstat(fd).st_size < spec.size:
        raise AttachError("damaged", f"{where} has the wrong size or name: restart the service")
    if incarnation is not None and found != incarnation:
        raise AttachError("damaged", f"{where} is of another run: restart the service")
    incarnation_found: int = found
    return incarnation_found
