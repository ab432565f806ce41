"""Segments: who may do what with them, what is refused and how that is said."""

from __future__ import annotations

import errno
import fcntl
import gc
import os
import stat
import struct
from collections.abc import Callable

import pytest

from failstop.shm import segment
from failstop.shm.layout import BY_NAME, CLIENT_SLOTS, PROCESSES
from failstop.shm.segment import AttachError
from tests.support.children import NOBODY, Child, call, group, needs_root, umask
from tests.support.waiting import until

from .segments import (
    NAMES,
    PRIVATE_NAMES,
    RUN,
    SERVICE,
    content,
    create_all,
    path_of,
    refusal,
    write_header,
)


@pytest.mark.parametrize("of", SERVICE + PRIVATE_NAMES)
def test_attach_finds_what_was_created(name: str, of: str) -> None:
    made = segment.create(name, of, RUN)
    assert made.incarnation == RUN
    for expected in (RUN, None):
        found = segment.attach(name, of, expected)
        assert found.incarnation == RUN
        assert found.spec is BY_NAME[of]
        assert (found.mapped is None) is (of in PRIVATE_NAMES)
        assert (found.fileno() == -1) is (of in SERVICE), "a mapping needs no descriptor"
        found.close()
    assert os.stat(path_of(name, of)).st_size == BY_NAME[of].size
    made.close()


def test_a_new_segment_is_empty(name: str) -> None:
    create_all(name)
    for of in SERVICE:
        seen = segment.attach(name, of)
        for record in seen.spec.records.values():
            if record.kind == "word":
                assert seen.word(record.name).get() == 0
            elif record.kind == "latest":
                assert seen.latest_reader(record.name).read() is None
            else:
                assert seen.ring_reader(record.name, from_oldest=True).next() is None


@needs_root
@pytest.mark.parametrize("mask", [0o000, 0o022, 0o077, 0o777])
def test_modes_are_the_layout_s_whatever_the_umask(name: str, mask: int) -> None:
    with umask(mask):
        for of in NAMES:
            segment.create(name, of, RUN, client_gid=NOBODY).close()
    for of in NAMES:
        found = os.stat(path_of(name, of))
        assert stat.S_IMODE(found.st_mode) == BY_NAME[of].mode
        assert found.st_uid == 0
        assert found.st_gid == (NOBODY if BY_NAME[of].mode & 0o060 == 0o060 else 0)


@needs_root
def test_a_client_s_segment_is_of_the_group_that_is_told(name: str) -> None:
    for of, own, gid, wanted in (
        ("client.0", NOBODY, 0, 0),
        ("client.1", NOBODY, -1, NOBODY),
        ("gate", NOBODY, 0, NOBODY),
    ):
        with group(own):
            segment.create(name, of, RUN, client_gid=gid).close()
        assert os.stat(path_of(name, of)).st_gid == wanted


@needs_root
def test_nobody_reads_the_service_and_writes_nothing(name: str) -> None:
    create_all(name)

    def attempts() -> list[str]:
        kinds = []
        for of in NAMES:
            client = of.startswith("client.")
            for write in (False, True):
                try:
                    if client and not write:
                        segment.read_client_slot(name, int(of[-1]), RUN)
                    else:
                        segment.attach(name, of, RUN, write=write, owner=0)
                    kinds.append("attached")
                except AttachError as error:
                    kinds.append(f"{error.kind}: {'join the group `failstop`' in str(error)}")
        return kinds

    expected = []
    for of in NAMES:
        expected += ["attached" if of in SERVICE else "permission: True", "permission: True"]
    assert call(attempts, NOBODY) == expected
    assert len(SERVICE) == 5


@needs_root
def test_a_member_of_the_group_has_a_client_slot_and_no_more(name: str) -> None:
    for of in NAMES:
        segment.create(name, of, RUN, client_gid=NOBODY).close()

    def attempts() -> tuple[int, str]:
        own = segment.attach(name, "client.0", RUN, owner=0, write=True)
        seq = own.latest_writer("hello").write(b"hello", 1)
        try:
            segment.attach(name, "gate", RUN, write=True, owner=0)
        except AttachError as error:
            return seq, error.kind
        return seq, "attached"

    assert call(attempts, NOBODY) == (1, "permission")
    assert segment.read_client_slot(name, 0, RUN).latest_reader("hello").read() == (1, 1, b"hello")


@pytest.mark.parametrize("of", SERVICE)
def test_a_reader_s_mapping_can_not_be_written(name: str, of: str) -> None:
    segment.create(name, of, RUN).close()
    seen = segment.attach(name, of, RUN)
    before = content(path_of(name, of))
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
    assert content(path_of(name, of)) == before


def test_a_reader_of_a_client_s_segment_can_not_write_it(name: str) -> None:
    segment.create(name, "client.0", RUN).close()
    seen = segment.read_client_slot(name, 0, RUN)
    with pytest.raises(OSError, match=os.strerror(errno.EBADF)):
        seen.latest_writer("hello").write(b"x")
    seen.close()


def test_client_segments_are_not_mapped(name: str) -> None:
    segment.create(name, "client.0", RUN).close()
    for seen in (segment.attach(name, "client.0", RUN, write=True), segment.read_client_slot(name, 0, RUN)):
        assert seen.mapped is None
        path = os.path.realpath(path_of(name, "client.0"))
        with open("/proc/self/maps") as maps:
            assert path not in maps.read()
        seen.close()


CLIENT_RECORDS = [
    name for name, record in BY_NAME["client.0"].records.items() if record.kind == "latest" and name != "left"
]


def test_a_goodbye_outlives_the_next_holder_s_begin(name: str) -> None:
    segment.create(name, "client.0", RUN).close()
    own, seen = segment.attach(name, "client.0", RUN, write=True), segment.read_client_slot(name, 0, RUN)
    own.latest_writer("left").write(b"goodbye", 1)
    own.wipe()
    assert seen.latest_reader("left").read() == (1, 1, b"goodbye")
    assert own.latest_writer("left").write(b"another", 2) == 2
    own.close()
    seen.close()


def test_a_wiped_slot_is_empty_and_as_good_as_new(name: str) -> None:
    segment.create(name, "client.0", RUN).close()
    new = content(path_of(name, "client.0"))
    own, seen = segment.attach(name, "client.0", RUN, write=True), segment.read_client_slot(name, 0, RUN)
    for record in CLIENT_RECORDS:
        own.latest_writer(record).write(b"before", 1)
    own.wipe()
    assert content(path_of(name, "client.0")) == new
    for record in CLIENT_RECORDS:
        assert seen.latest_reader(record).read() is None
        assert own.latest_writer(record).write(b"new", 1) == 1
        assert seen.latest_reader(record).read() == (1, 1, b"new")
    own.close()
    seen.close()


def test_a_slot_that_can_not_be_opened_is_always_empty() -> None:
    for index in range(CLIENT_SLOTS):
        none = segment.no_client_slot(index, RUN)
        assert none.spec is BY_NAME[f"client.{index}"]
        assert none.incarnation == RUN
        assert not os.get_inheritable(none.fileno())
        for record in CLIENT_RECORDS:
            assert none.latest_reader(record).read() is None
            with pytest.raises(OSError, match=os.strerror(errno.EBADF)):
                none.latest_writer(record).write(b"x")
        none.close()


def test_a_closed_slot_writes_to_no_file_that_has_its_number_by_now(name: str) -> None:
    segment.create(name, "client.0", RUN).close()
    own = segment.attach(name, "client.0", RUN, write=True)
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
    segment.create(name, "gate", RUN).close()
    own = segment.attach(name, "gate", RUN, write=True)
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
    made = segment.create(name, "telemetry", RUN)
    with pytest.raises(TypeError, match="words are only read through a mapping"):
        made.word("beat_ns")
    made.close()


def test_a_ring_is_read_from_now_on_or_from_its_oldest_entry(name: str) -> None:
    segment.create(name, "gate", RUN).close()
    own = segment.attach(name, "gate", RUN, write=True)
    own.ring_writer("frames").put(b"before", 1)
    now, oldest = own.ring_reader("frames"), own.ring_reader("frames", from_oldest=True)
    assert now.next() is None
    assert oldest.next() == (1, 1, b"before")


def test_create_takes_nothing_that_is_there(name: str) -> None:
    """A run's names are its own: what has one was made by somebody else."""
    with open(path_of(name, "gate"), "wb") as file:
        file.write(b"not a segment")
    kind, message = refusal(lambda: segment.create(name, "gate", RUN))
    assert kind == "damaged"
    assert path_of(name, "gate") in message
    assert content(path_of(name, "gate")) == b"not a segment"


def test_a_link_in_the_way_is_not_followed(name: str, tmp_path: object) -> None:
    victim = os.path.join(str(tmp_path), "victim")
    with open(victim, "w") as file:
        file.write("precious")
    os.symlink(victim, path_of(name, "gate"))
    for attempt in (lambda: segment.attach(name, "gate", RUN), lambda: segment.create(name, "gate", RUN)):
        refusal(attempt)
    with open(victim) as file:
        assert file.read() == "precious"


def test_a_pipe_in_the_way_is_not_waited_for(name: str) -> None:
    os.mkfifo(path_of(name, "supervisor"))
    with pytest.raises(segment.AttachError, match=r"not a regular file"):
        segment.attach(name, "supervisor", RUN)
    assert not segment.living(name)


@needs_root
@pytest.mark.parametrize("of", ["gate", "client.0"])
def test_what_is_not_the_service_s_is_refused_by_path_and_owner(name: str, of: str) -> None:
    """To root as to everyone: what somebody else has put there is somebody else's to change."""
    create_all(name)
    os.chown(path_of(name, of), NOBODY, -1)
    for write in (False, True) if of == "gate" else (True,):
        if of == "gate":
            kind, message = refusal(lambda write=write: segment.attach(name, of, RUN, write=write, owner=0))  # type: ignore[misc]
        else:
            kind, message = refusal(lambda: segment.attach(name, "client.0", RUN, owner=0, write=True))
        assert kind == "owner"
        assert path_of(name, of) in message
        assert f"uid {NOBODY}" in message
        assert "remove it" in message
    if of == "gate":
        segment.attach(name, of, RUN, owner=NOBODY).close()
    else:
        segment.attach(name, "client.0", RUN, owner=NOBODY, write=True).close()


@needs_root
def test_a_dead_run_is_one_s_own(name: str) -> None:
    """Of what others have put there nothing is read, and nothing removed."""
    run, other = segment.memory(name, RUN), segment.memory(name, RUN + 1)
    create_all(run)
    create_all(other)
    try:
        assert sorted(segment.dead_runs(name)) == [run, other]
        for of in NAMES:
            os.chown(path_of(other, of), NOBODY, -1)
        assert segment.dead_runs(name) == [run]
        assert segment.open_all(other) == {}
    finally:
        segment.unlink_all(run)
        segment.unlink_all(other)


def test_dead_runs_are_found_by_whatever_they_have_left_the_newest_last(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    older, newer = segment.memory(name, RUN + 1), segment.memory(name, RUN)
    strange = [f"/dev/shm/{name}.gate", f"/dev/shm/failstop.{name}.gate", f"/dev/shm/failstop.{name}.1234.unknown"]
    listed = os.listdir
    monkeypatch.setattr(os, "listdir", lambda path: [f"failstop.{name}.gone.gate", *listed(path)])
    try:
        for path in strange:
            open(path, "w").close()
        assert segment.dead_runs(name) == []
        segment.create(older, "client.3", RUN + 1).close()
        segment.create(newer, "client.0", RUN).close()

        def touched() -> bool:
            os.utime(path_of(newer, "client.0"))
            return os.stat(path_of(newer, "client.0")).st_ctime_ns > os.stat(path_of(older, "client.3")).st_ctime_ns

        until(touched, "the clock of the file system has gone on")
        assert segment.dead_runs(name) == [older, newer]
    finally:
        for path in strange:
            os.unlink(path)
        segment.unlink_all(older)
        segment.unlink_all(newer)


def test_what_is_left_of_a_run_is_opened_whatever_is_missing(name: str, fds: list[int]) -> None:
    create_all(name)
    segment.unlink(name, PROCESSES[0])
    segment.unlink(name, PROCESSES[2])
    found = segment.open_all(name)
    fds += found.values()
    assert list(found) == [PROCESSES[1], *PROCESSES[3:]]


def test_a_run_without_its_supervisor_s_segment_does_not_live(name: str) -> None:
    assert not segment.living(name)


def test_a_lock_that_can_not_be_asked_for_is_nobody_s(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    segment.create(name, "supervisor", RUN).close()
    monkeypatch.setattr(fcntl, "fcntl", refuse)
    assert not segment.living(name)


def test_a_run_lives_as_long_as_its_supervisor(name: str) -> None:
    run = segment.memory(name, RUN)

    def work(send: Callable[[object], None], wait: Callable[[], None]) -> None:
        made = [segment.create(run, of, RUN) for of in NAMES]
        send(len(made))
        wait()

    try:
        with Child(work) as child:
            child.receive()
            assert segment.living(run)
            assert segment.dead_runs(name) == []
            child.kill()
        assert not segment.living(run)
        assert segment.dead_runs(name) == [run]
    finally:
        segment.unlink_all(run)


def test_it_is_the_supervisor_s_segment_that_tells_so(name: str) -> None:
    """Each is made and held by this process; its copies for other names are not asked."""
    made = {of: segment.create(name, of, RUN) for of in ("gate", "supervisor")}
    assert segment.living(name)
    made["supervisor"].close()
    assert not segment.living(name)
    os.rename(path_of(name, "gate"), path_of(name, "supervisor"))
    assert not segment.living(name), "the gate's is not locked"


@pytest.mark.parametrize(("number", "look"), [(errno.EFBIG, "ulimit -f"), (errno.ENOSPC, "df /dev/shm")])
def test_what_keeps_a_segment_from_its_size_is_told(
    name: str, monkeypatch: pytest.MonkeyPatch, number: int, look: str
) -> None:
    def fallocate(*_: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "posix_fallocate", fallocate)
    with pytest.raises(AttachError, match=rf"\({os.strerror(number)}\): look at `{look}`$"):
        segment.create(name, "gate", RUN)
    assert not os.path.exists(path_of(name, "gate"))


@pytest.mark.parametrize(("number", "kind"), [(errno.EMFILE, "descriptors"), (errno.EIO, "damaged")])
def test_a_program_without_descriptors_is_no_damage(
    name: str, monkeypatch: pytest.MonkeyPatch, number: int, kind: str
) -> None:
    create_all(name)

    def refused(*_: object) -> int:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "open", refused)
    with pytest.raises(AttachError, match="can't be opened") as told:
        segment.attach(name, "gate", RUN)
    assert told.value.kind == kind


def test_who_may_only_read_it_can_not_make_a_dead_run_look_alive(name: str) -> None:
    """Everyone may read the supervisor's segment, and lock what they may read, for reading."""
    create_all(name)
    with open(path_of(name, "supervisor"), "rb") as file:
        fcntl.fcntl(file.fileno(), fcntl.F_OFD_SETLK, struct.pack("hhqqi4x", fcntl.F_RDLCK, os.SEEK_SET, 0, 0, 0))
        assert not segment.living(name)


def test_unlink_of_what_is_not_there_is_fine(name: str) -> None:
    segment.unlink(name, "gate")
    segment.unlink_all(name)
    create_all(name)
    segment.unlink_all(name)
    assert not [entry for entry in os.listdir("/dev/shm") if entry.startswith(f"failstop.{name}.")]


@needs_root
def test_what_can_not_be_unlinked_stays(name: str) -> None:
    """Another user's, or a directory that somebody has put there: nobody needs the name again."""
    segment.create(name, "gate", RUN).close()
    os.mkdir(path_of(name, "stopper"))
    call(lambda: segment.unlink(name, "gate"), NOBODY)
    segment.unlink(name, "stopper")
    assert os.path.exists(path_of(name, "gate"))
    os.rmdir(path_of(name, "stopper"))


def test_instances_do_not_see_each_other(name: str) -> None:
    """Nor one whose name begins with another's."""
    longer = name + "-2"
    try:
        create_all(name, 1)
        create_all(longer, 2)
        segment.attach(name, "gate", 1, write=True).word("beat_ns").set(11)
        assert segment.attach(longer, "gate", 2).word("beat_ns").get() == 0
        segment.unlink_all(name)
        segment.attach(longer, "gate", 2)
    finally:
        segment.unlink_all(longer)


def open_fds() -> set[int]:
    return {int(fd) for fd in os.listdir("/proc/self/fd")}


def test_refused_attempts_leave_no_descriptor_open(name: str) -> None:
    create_all(name)
    write_header(name, "client.1", layout=0)
    write_header(name, "telemetry", layout=0)
    gc.collect()  # what other tests have dropped
    before = len(open_fds())
    for _ in range(20):
        refusal(lambda: segment.attach(name, "client.1", RUN, write=True))
        refusal(lambda: segment.attach(name, "client.0", RUN + 1, write=True))
        refusal(lambda: segment.attach(name, "telemetry", RUN))
        refusal(lambda: segment.attach(name, "gate", RUN + 1))
    assert len(open_fds()) == before


def test_close_is_idempotent_and_frees_the_descriptor(name: str) -> None:
    before = len(open_fds())
    made = segment.create(name, "client.0", RUN)
    own = segment.attach(name, "client.0", RUN, write=True)
    assert len(open_fds()) == before + 2
    for _ in range(2):
        made.close()
        own.close()
    assert len(open_fds()) == before


def test_no_descriptor_crosses_an_exec(name: str) -> None:
    create_all(name)

    def work(send: object, wait: object) -> list[str]:
        segment.unlink(name, "stopper")
        made = segment.create(name, "stopper", RUN)
        held = [segment.attach(name, of, RUN) for of in SERVICE if of != "stopper"]
        held += [segment.attach(name, "client.0", RUN, write=True), segment.read_client_slot(name, 1, RUN), made]
        assert any(name in link for link in links())
        reading, writing = os.pipe()
        os.set_inheritable(writing, True)
        if os.fork() == 0:
            os.dup2(writing, 1)
            os.execv("/bin/sh", ["sh", "-c", "ls -l /proc/$$/fd"])
        os.close(writing)
        found = b""
        while part := os.read(reading, 65536):
            found += part
        os.wait()
        assert held
        return found.decode().splitlines()

    with Child(work) as child:
        lines = child.result()
    assert len(lines) > 3
    assert not [line for line in lines if name in line]


def links() -> list[str]:
    """What this process's descriptors are."""
    found = []
    for fd in os.listdir("/proc/self/fd"):
        try:
            found.append(os.readlink(f"/proc/self/fd/{fd}"))
        except FileNotFoundError:  # the listing's own
            continue
    return found


def test_readers_outlive_the_segment_object(name: str) -> None:
    """A mapping ends with its last reader, not with the object it came from."""
    segment.create(name, "gate", RUN).close()
    writer = segment.attach(name, "gate", RUN, write=True).latest_writer("state")
    seen = segment.attach(name, "gate", RUN)
    reader, word = seen.latest_reader("state"), seen.word("beat_ns")
    seen.close()
    del seen
    writer.write(b"still here", 1)
    assert reader.read() == (1, 1, b"still here")
    assert word.get() == 0
