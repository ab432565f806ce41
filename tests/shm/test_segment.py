"""Segments: who may do what with them, what is refused and how that is said."""

from __future__ import annotations

import errno
import itertools
import os
import stat
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from failstop.messages import segments
from failstop.messages.layout import CLIENT_SLOTS, SEGMENT_BY_NAME
from failstop.shm.segment import HEADER_BYTES, Segment
from tests.support.children import NOBODY

from .segments import NAMES, PRIVATE_NAMES, RUN, SERVICE, path_of
from .simulated import content, open_fds, put, refusing, user


@pytest.mark.parametrize("of", SERVICE + PRIVATE_NAMES)
def test_attach_finds_what_was_created(name: str, of: str) -> None:
    made = segments.create(name, of, RUN)
    assert made.incarnation == RUN
    for expected in (RUN, None):
        found = segments.attach(name, of, expected)
        assert found.incarnation == RUN
        assert found.spec is SEGMENT_BY_NAME[of]
        assert (found.mapped is None) is (of in PRIVATE_NAMES)
        assert (found.fileno() == -1) is (of in SERVICE), "a mapping needs no descriptor"
        found.close()
    assert os.stat(path_of(name, of)).st_size == SEGMENT_BY_NAME[of].size
    made.close()


@pytest.mark.parametrize("lacking", [False, True], ids=["posix-ipc", "no posix-ipc"])
def test_segments_are_made_alike_where_posix_ipc_has_no_wheel(
    name: str, lacking: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if lacking:
        monkeypatch.setitem(sys.modules, "posix_ipc", None)
    of = SERVICE[0]
    made = segments.create(name, of, RUN)
    assert stat.S_IMODE(os.stat(path_of(name, of)).st_mode) == SEGMENT_BY_NAME[of].mode
    with pytest.raises(segments.AttachError, match=r"can't be made: .*exists"):
        segments.create(name, of, RUN)
    made.close()
    segments.unlink(name, of)
    assert not os.path.exists(path_of(name, of))


@pytest.mark.parametrize("lacking", [False, True], ids=["posix-ipc", "no posix-ipc"])
def test_a_segment_is_its_maker_s_alone_until_it_is_given(
    name: str, lacking: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever opened it before could keep it open."""
    modes, fchmod = [], os.fchmod

    def seen(fd: int, mode: int) -> None:
        modes.append(stat.S_IMODE(os.fstat(fd).st_mode))
        fchmod(fd, mode)

    if lacking:
        monkeypatch.setitem(sys.modules, "posix_ipc", None)
    monkeypatch.setattr(os, "fchmod", seen)
    mask = os.umask(0)
    try:
        segments.create(name, SERVICE[0], RUN).close()
    finally:
        os.umask(mask)
    assert modes == [0o600]


@pytest.mark.parametrize(("own", "gid", "group"), [(0, NOBODY, NOBODY), (NOBODY, 0, 0), (NOBODY, -1, NOBODY)])
def test_modes_and_groups_are_the_layout_s(on: SimpleNamespace, own: int, gid: int, group: int) -> None:
    for mask, of in itertools.product((0o000, 0o022, 0o077, 0o777), NAMES):
        on.own.umask = mask
        with user(on, 0, own):
            on.segments.create(f"r{mask}", of, RUN, *([gid] if gid >= 0 else []))
        found = on.os.stat(path_of(f"r{mask}", of))
        assert stat.S_IMODE(found.st_mode) == SEGMENT_BY_NAME[of].mode
        assert (found.st_uid, found.st_gid) == (0, group if SEGMENT_BY_NAME[of].mode & 0o060 == 0o060 else own)


def test_everybody_reads_the_service_and_the_group_has_the_clients_slots(on: SimpleNamespace) -> None:
    for of in NAMES:
        on.segments.create("r", of, RUN, client_gid=NOBODY)
    clients = [f"client.{index}" for index in range(CLIENT_SLOTS)]
    for gid, slots in ((NOBODY, clients), (NOBODY - 1, [])):
        with user(on, NOBODY, gid):
            for of, write in itertools.product(NAMES, (False, True)):
                if of in slots or (of in SERVICE and not write):
                    on.segments.attach("r", of, RUN, write=write, owner=0)
                    continue
                with pytest.raises(on.segments.AttachError, match="join the group `failstop`") as refused:
                    on.segments.attach("r", of, RUN, write=write, owner=0)
                assert refused.value.kind == "permission"
    assert len(SERVICE) == 5


@pytest.mark.parametrize("of", SERVICE)
def test_a_reader_s_mapping_can_not_be_written(name: str, of: str) -> None:
    segments.create(name, of, RUN).close()
    seen = segments.attach(name, of, RUN)
    before = Path(path_of(name, of)).read_bytes()
    for record in seen.spec.records.values():
        attempt: Callable[[], object] = {
            "word": lambda record=record: seen.word(record.name).set(1),
            "latest": lambda record=record: seen.latest_writer(record.name).write(b"x"),
            "ring": lambda record=record: seen.ring_writer(record.name).put(b"x"),
        }[record.kind]
        with pytest.raises(TypeError):
            attempt()
    assert seen.mapped is not None
    with pytest.raises(TypeError):
        memoryview(seen.mapped)[200] = 1
    assert Path(path_of(name, of)).read_bytes() == before


Slot = tuple[Segment, Segment]


@pytest.fixture
def slot(name: str) -> Iterator[Slot]:
    """A client's segment, as the client has it and as the service does."""
    segments.create(name, "client.0", RUN).close()
    own, seen = segments.attach(name, "client.0", RUN, write=True), segments.read_client_slot(name, 0, RUN)
    yield own, seen
    own.close()
    seen.close()


def test_client_segments_are_not_mapped_and_written_by_the_client_alone(name: str, slot: Slot) -> None:
    assert path_of(name, "client.0") not in Path("/proc/self/maps").read_text()
    assert [each.mapped for each in slot] == [None, None]
    with pytest.raises(OSError, match=os.strerror(errno.EBADF)):
        slot[1].latest_writer("hello").write(b"x")


OF_CLIENT = SEGMENT_BY_NAME["client.0"].records
CLIENT_RECORDS = [name for name, record in OF_CLIENT.items() if record.kind == "latest" and name != "left"]


def test_a_goodbye_outlives_the_next_holder_s_begin(slot: Slot) -> None:
    own, seen = slot
    own.latest_writer("left").write(b"goodbye", 1)
    own.wipe()
    assert seen.latest_reader("left").read() == (1, 1, b"goodbye")
    assert own.latest_writer("left").write(b"another", 2) == 2


def test_a_wiped_slot_is_empty_and_as_good_as_new(name: str, slot: Slot) -> None:
    new = Path(path_of(name, "client.0")).read_bytes()
    own, seen = slot
    for record in CLIENT_RECORDS:
        own.latest_writer(record).write(b"before", 1)
    own.wipe()
    assert Path(path_of(name, "client.0")).read_bytes() == new
    for record in CLIENT_RECORDS:
        assert seen.latest_reader(record).read() is None
        assert own.latest_writer(record).write(b"new", 1) == 1
        assert seen.latest_reader(record).read() == (1, 1, b"new")


def test_a_slot_that_can_not_be_opened_is_always_empty() -> None:
    nowhere = segments.memory("nobody", RUN)
    for index in range(CLIENT_SLOTS):
        none = segments.read_client_slot(nowhere, index, RUN)
        assert none.spec is SEGMENT_BY_NAME[f"client.{index}"]
        assert none.incarnation == RUN
        assert not os.get_inheritable(none.fileno())
        for record in CLIENT_RECORDS:
            assert none.latest_reader(record).read() is None
            with pytest.raises(OSError, match=os.strerror(errno.EBADF)):
                none.latest_writer(record).write(b"x")
        none.close()


def test_a_closed_slot_writes_to_no_file_that_has_its_number_by_now(slot: Slot) -> None:
    own, _ = slot
    writer, number = own.latest_writer("hello"), own.fileno()
    own.close()
    assert own.fileno() == -1
    other = os.memfd_create("other")
    try:
        assert other == number
        with pytest.raises(OSError, match=os.strerror(errno.EBADF)):
            writer.write(b"x")
        assert os.fstat(other).st_size == 0
    finally:
        os.close(other)


def test_records_are_reached_as_what_they_are(name: str) -> None:
    segments.create(name, "gate", RUN).close()
    own = segments.attach(name, "gate", RUN, write=True)
    for wrong in (
        lambda: own.word("state"),
        lambda: own.latest_reader("frames"),
        lambda: own.ring_writer("state"),
        lambda: own.latest_writer("beat_ns"),
    ):
        with pytest.raises(TypeError, match=r"gate\.\w+ is a (word|latest|ring), not a (word|latest|ring)"):
            wrong()
    with pytest.raises(KeyError):
        own.word("no_such_record")
    made = segments.create(name, "telemetry", RUN)
    with pytest.raises(TypeError, match="words are only read through a mapping"):
        made.word("beat_ns")
    made.close()


def test_a_reader_of_a_ring_begins_with_the_next_entry_or_with_the_oldest(name: str) -> None:
    writer = segments.create(name, "gate", RUN).ring_writer("frames")
    writer.put(b"before", 1)
    seen = segments.attach(name, "gate", RUN)
    late, oldest = seen.ring_reader("frames"), seen.ring_reader("frames", from_oldest=True)
    writer.put(b"after", 2)
    assert list(iter(late.next, None)) == [(2, 2, b"after")]
    assert list(iter(oldest.next, None)) == [(1, 1, b"before"), (2, 2, b"after")]


def test_create_takes_nothing_that_is_there(on: SimpleNamespace) -> None:
    """A run's names are its own: what has one was made by somebody else."""
    for there in ("file", "link"):
        if there == "file":
            put(on, path_of("r", "gate"), "precious")
        else:
            on.os.rename(path_of("r", "gate"), "/tmp/victim")
            on.os.symlink("/tmp/victim", path_of("r", "gate"))
        for attempt in (on.segments.create, on.segments.attach):
            with pytest.raises(on.segments.AttachError) as refused:
                attempt("r", "gate", RUN)
            assert refused.value.kind == "damaged"
            assert attempt is on.segments.attach or path_of("r", "gate") in str(refused.value)
        assert content(on, path_of("r", "gate")) == b"precious"


def test_a_pipe_in_the_way_is_not_waited_for(on: SimpleNamespace) -> None:
    on.os.mkfifo(path_of("r", "supervisor"))
    with pytest.raises(on.segments.AttachError, match=r"not a regular file"):
        on.segments.attach("r", "supervisor", RUN)
    assert not on.segments.living("r")
    assert open_fds(on) == 0


@pytest.mark.parametrize(("of", "write"), [("gate", False), ("gate", True), ("client.0", True)])
def test_what_is_not_the_service_s_is_refused_by_path_and_owner(on: SimpleNamespace, of: str, write: bool) -> None:
    """To root as to everyone: what somebody else has put there is somebody else's to change."""
    on.segments.create("r", of, RUN)
    on.os.chown(path_of("r", of), NOBODY, -1)
    with pytest.raises(on.segments.AttachError) as refused:
        on.segments.attach("r", of, RUN, owner=0, write=write)
    assert refused.value.kind == "owner"
    for part in (path_of("r", of), f"uid {NOBODY}", "the service to root (uid 0)", "remove it"):
        assert part in str(refused.value)
    on.segments.attach("r", of, RUN, owner=NOBODY, write=write)


@pytest.mark.parametrize(("number", "look"), [(errno.EFBIG, "ulimit -f"), (errno.ENOSPC, "df /dev/shm")])
def test_what_keeps_a_segment_from_its_size_is_told(on: SimpleNamespace, number: int, look: str) -> None:
    expected = rf"no room in /dev/shm for \d+ bytes \({os.strerror(number)}\): look at `{look}`$"
    with refusing(on, "fallocate", number), pytest.raises(on.segments.AttachError, match=expected) as refused:
        on.segments.create("r", "gate", RUN)
    assert refused.value.kind == "damaged"
    assert on.os.listdir("/dev/shm") == []
    assert open_fds(on) == 0


@pytest.mark.parametrize(("number", "kind"), [(errno.EMFILE, "descriptors"), (errno.EIO, "damaged")])
def test_a_program_without_descriptors_is_no_damage(on: SimpleNamespace, number: int, kind: str) -> None:
    on.segments.create("r", "gate", RUN)
    with refusing(on, "open", number), pytest.raises(on.segments.AttachError, match="can't be opened") as told:
        on.segments.attach("r", "gate", RUN)
    assert told.value.kind == kind


def test_what_can_not_be_unlinked_stays(on: SimpleNamespace) -> None:
    """Another user's, or a directory that somebody has put there: nobody needs the name again."""
    on.segments.create("r", "gate", RUN)
    on.os.mkdir(path_of("r", "stopper"))
    with user(on, NOBODY):
        on.segments.unlink("r", "gate")
    on.segments.unlink("r", "stopper")
    on.segments.unlink("r", "telemetry")
    assert len(on.os.listdir("/dev/shm")) == 2


def test_refused_attempts_leave_no_descriptor_open(on: SimpleNamespace) -> None:
    for of in ("gate", "telemetry", "client.0", "client.1"):
        on.segments.create("r", of, RUN)
    for of in ("telemetry", "client.1"):
        on.os.pwrite(on.os.open(path_of("r", of), os.O_RDWR), bytes(HEADER_BYTES), 0)
    before = open_fds(on)
    for of, run in (("client.1", RUN), ("client.0", RUN + 1), ("telemetry", RUN), ("gate", RUN + 1)):
        with pytest.raises(on.segments.AttachError):
            on.segments.attach("r", of, run, write=True)
    assert open_fds(on) == before


def test_no_descriptor_crosses_an_exec_or_outlives_its_segment(on: SimpleNamespace) -> None:
    held = [on.segments.create("r", of, RUN) for of in NAMES]
    held += [on.segments.attach("r", of, RUN, write=True) for of in NAMES]
    held += [on.segments.read_client_slot("r", 1, RUN)]
    assert open_fds(on) == 2 * len(NAMES) - len(SERVICE) + 1, "a mapping needs none"
    assert not on.own.inheritable
    for _ in range(2):
        for each in held:
            each.close()
    assert open_fds(on) == 0
