"""Segments: who may do what with them, what is refused and how that is said."""

from __future__ import annotations

import errno
import mmap
import os
import stat
from collections.abc import Callable

import posix_ipc
import pytest

from failstop.shm import segment, slot
from failstop.shm.layout import BY_NAME, HEADER_BYTES, LAYOUT_HASH, PRIVATE, PUBLIC, SEGMENTS
from failstop.shm.segment import AttachError, Segment
from failstop.shm.words import Word
from failstop.version import VERSION

from .children import NOBODY, Child, call, needs_root, umask

RUN = 0xABCDEF0123456789
NAMES = [spec.name for spec in SEGMENTS]
SERVICE = [spec.name for spec in SEGMENTS if spec.mode == PUBLIC]
PRIVATE_NAMES = [spec.name for spec in SEGMENTS if spec.mode == PRIVATE]


def path_of(instance: str, of: str) -> str:
    return "/dev/shm" + segment.shm_name(instance, of)


def content(path: str) -> bytes:
    with open(path, "rb") as file:
        return file.read()


def create_all(instance: str, run: int = RUN) -> None:
    for of in NAMES:
        segment.create(instance, of, run).close()


def refusal(attempt: Callable[[], object]) -> tuple[str, str]:
    """The kind and message with which an attempt is refused."""
    with pytest.raises(AttachError) as refused:
        attempt()
    assert "\n" not in str(refused.value)
    return refused.value.kind, str(refused.value)


def write_header(
    instance: str,
    of: str,
    *,
    magic: bytes = segment.MAGIC,
    layout: int = LAYOUT_HASH,
    size: int | None = None,
    run: int = RUN,
    name: str | None = None,
    version: str = VERSION,
) -> None:
    """Put a header of another program, run or layout into a segment."""
    header = segment._HEADER.pack(
        magic, layout, BY_NAME[of].size if size is None else size, run, (name or of).encode(), version.encode()
    )
    with open(path_of(instance, of), "r+b") as file:
        file.write(slot.build(1, 0, header, segment._HEADER_SEED, 104))


def test_the_header_fits_its_place() -> None:
    assert slot.HEADER_BYTES + segment._HEADER.size <= HEADER_BYTES
    assert len(VERSION.encode()) <= 24
    assert all(len(name) <= 24 for name in NAMES)


@pytest.mark.parametrize("of", SERVICE + PRIVATE_NAMES)
def test_attach_finds_what_was_created(name: str, of: str) -> None:
    made = segment.create(name, of, RUN)
    assert made.incarnation == RUN
    for expected in (RUN, None):
        found = segment.attach(name, of, expected)
        assert found.incarnation == RUN
        assert found.spec is BY_NAME[of]
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


def test_absent(name: str) -> None:
    for attempt in (
        lambda: segment.attach(name, "gate"),
        lambda: segment.attach(name, "gate", RUN, write=True),
        lambda: segment.attach_client_slot(name, 0, RUN),
        lambda: segment.read_client_slot(name, 0, RUN),
    ):
        kind, message = refusal(attempt)
        assert kind == "absent"
        assert repr(name) in message
        assert "failstop run" in message


@pytest.mark.parametrize("of", ["gate", "client.0"])
@pytest.mark.parametrize("damage", ["zeros", "noise", "one bit", "other magic", "short header", "empty", "cut"])
def test_a_damaged_header(name: str, of: str, damage: str) -> None:
    segment.create(name, of, RUN).close()
    path = path_of(name, of)
    with open(path, "r+b") as file:
        if damage == "zeros":
            file.write(bytes(128))
        elif damage == "noise":
            file.write(os.urandom(128))
        elif damage == "one bit":
            file.seek(90)
            byte = file.read(1)[0]
            file.seek(90)
            file.write(bytes([byte ^ 1]))
        elif damage == "short header":
            file.write(slot.build(1, 0, segment.MAGIC, segment._HEADER_SEED, 104))
        elif damage == "empty":
            file.truncate(0)
        elif damage == "cut":
            file.truncate(100)
    if damage == "other magic":
        write_header(name, of, magic=b"failstom")
    kind, message = refusal(lambda: attach_any(name, of))
    assert kind == "damaged"
    assert "no whole header" in message
    assert of in message
    assert "restart the service" in message


def attach_any(name: str, of: str, run: int = RUN) -> Segment:
    if of.startswith("client."):
        return segment.attach_client_slot(name, int(of[-1]), run)
    return segment.attach(name, of, run)


@pytest.mark.parametrize("of", ["gate", "client.0"])
def test_another_layout_is_another_version(name: str, of: str) -> None:
    """Said before anything else in the header is judged, since nothing else need mean the same there."""
    segment.create(name, of, RUN).close()
    for other in ({}, {"size": 77}, {"run": 1}, {"name": "other"}):
        write_header(name, of, layout=LAYOUT_HASH ^ 1, version="9.8.7", **other)
        kind, message = refusal(lambda: attach_any(name, of))
        assert kind == "version"
        assert "failstop 9.8.7" in message
        assert VERSION in message
        assert "restart the service" in message


@pytest.mark.parametrize("of", ["gate", "client.0"])
def test_the_version_alone_is_no_reason(name: str, of: str) -> None:
    segment.create(name, of, RUN).close()
    write_header(name, of, version="9.8.7")
    attach_any(name, of).close()


@pytest.mark.parametrize("of", ["gate", "client.0"])
def test_another_run(name: str, of: str) -> None:
    segment.create(name, of, RUN).close()
    kind, message = refusal(lambda: attach_any(name, of, RUN + 1))
    assert kind == "damaged"
    assert "another run" in message


@pytest.mark.parametrize("wrong", [{"size": 4096 * 99}, {"name": "telemetry"}])
def test_a_header_of_another_segment(name: str, wrong: dict[str, object]) -> None:
    segment.create(name, "gate", RUN).close()
    write_header(name, "gate", **wrong)  # type: ignore[arg-type]
    kind, message = refusal(lambda: segment.attach(name, "gate", RUN))
    assert kind == "damaged"
    assert "wrong size or name" in message


@pytest.mark.parametrize("of", ["gate", "client.0"])
def test_a_file_that_is_too_small_is_not_mapped(name: str, of: str) -> None:
    segment.create(name, of, RUN).close()
    for size in (BY_NAME[of].size - 1, 4095, 128):
        os.truncate(path_of(name, of), size)
        kind, message = refusal(lambda: attach_any(name, of))
        assert kind == "damaged"
        assert "wrong size or name" in message


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
def test_nobody_reads_the_service_and_writes_nothing(name: str) -> None:
    create_all(name)

    def attempts() -> list[str]:
        kinds = []
        for of in NAMES:
            client = of.startswith("client.")
            for write in (False, True):
                try:
                    if client and write:
                        segment.attach_client_slot(name, int(of[-1]), RUN)
                    elif client:
                        segment.read_client_slot(name, int(of[-1]), RUN)
                    else:
                        segment.attach(name, of, RUN, write=write)
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
        own = segment.attach_client_slot(name, 0, RUN)
        seq = own.latest_writer("hello").write(b"hello", 1)
        try:
            segment.attach(name, "gate", RUN, write=True)
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
    for seen in (segment.attach_client_slot(name, 0, RUN), segment.read_client_slot(name, 0, RUN)):
        assert seen.mapped is None
        path = os.path.realpath(path_of(name, "client.0"))
        with open("/proc/self/maps") as maps:
            assert path not in maps.read()
        seen.close()


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


def test_create_replaces_what_a_dead_run_left(name: str) -> None:
    segment.create(name, "gate", 1).close()
    old_own, old_seen = segment.attach(name, "gate", 1, write=True), segment.attach(name, "gate", 1)
    old_own.latest_writer("state").write(b"old", 1)
    old_own.ring_writer("frames").put(b"old frame", 1)
    segment.create(name, "gate", 2).close()
    new = segment.attach(name, "gate", 2)
    assert new.latest_reader("state").read() is None
    assert new.ring_reader("frames", from_oldest=True).next() is None
    # Who still has the old one is not disturbed, and disturbs nobody.
    old_own.latest_writer("state").write(b"late", 2)
    assert old_seen.latest_reader("state").read() == (2, 2, b"late")
    assert new.latest_reader("state").read() is None


def test_create_replaces_whatever_has_the_name(name: str) -> None:
    with open(path_of(name, "gate"), "wb") as file:
        file.write(b"not a segment")
    segment.create(name, "gate", RUN).close()
    segment.attach(name, "gate", RUN)


def test_a_link_in_the_way_is_replaced_and_not_followed(name: str, tmp_path: object) -> None:
    victim = os.path.join(str(tmp_path), "victim")
    with open(victim, "w") as file:
        file.write("precious")
    os.symlink(victim, path_of(name, "gate"))
    with pytest.raises(OSError, match=r"symbolic links"):
        segment.attach(name, "gate", RUN)
    segment.create(name, "gate", RUN).close()
    segment.attach(name, "gate", RUN)
    with open(victim) as file:
        assert file.read() == "precious"


def test_slots_of_another_run_are_not_read(name: str) -> None:
    """Even with every byte of the dead run's records in place."""
    segment.create(name, "gate", 1).close()
    own = segment.attach(name, "gate", 1, write=True)
    own.latest_writer("state").write(b"old", 1)
    own.ring_writer("frames").put(b"old", 1)
    with open(path_of(name, "gate"), "rb") as file:
        old = file.read()
    segment.create(name, "gate", 2).close()
    with open(path_of(name, "gate"), "r+b") as file:
        file.seek(HEADER_BYTES)
        file.write(old[HEADER_BYTES:])
    seen = segment.attach(name, "gate", 2)
    assert seen.latest_reader("state").read() is None
    assert seen.ring_reader("frames", from_oldest=True).next() is None


def test_client_records_of_another_run_are_not_read(name: str) -> None:
    """The header of a client's segment is not looked at by the service: each record must say its run."""
    segment.create(name, "client.0", 1).close()
    segment.attach_client_slot(name, 0, 1).latest_writer("command").write(b"drive", 1)
    assert segment.read_client_slot(name, 0, 1).latest_reader("command").read() == (1, 1, b"drive")
    assert segment.read_client_slot(name, 0, 2).latest_reader("command").read() is None


@needs_root
def test_another_user_s_segment_is_in_the_way(name: str) -> None:
    segment.create(name, "gate", RUN).close()
    before = os.stat(path_of(name, "gate"))

    def attempts() -> list[tuple[str, str]]:
        found = []
        for attempt in (
            lambda: segment.create(name, "gate", RUN),
            lambda: segment.unlink(name, "gate"),
            lambda: segment.unlink_all(name),
        ):
            try:
                attempt()
            except AttachError as error:
                found.append((error.kind, str(error)))
        return found

    found = call(attempts, NOBODY)
    assert [kind for kind, _ in found] == ["permission"] * 3
    assert all("belongs to another user" in message and "--name" in message for _, message in found)
    assert os.stat(path_of(name, "gate")).st_ino == before.st_ino


def test_unlink_of_what_is_not_there_is_fine(name: str) -> None:
    segment.unlink(name, "gate")
    segment.unlink_all(name)
    create_all(name)
    segment.unlink_all(name)
    assert not [entry for entry in os.listdir("/dev/shm") if entry.startswith(f"failstop.{name}.")]


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
    before = len(open_fds())
    for _ in range(20):
        refusal(lambda: segment.attach_client_slot(name, 1, RUN))
        refusal(lambda: segment.attach_client_slot(name, 0, RUN + 1))
        refusal(lambda: segment.attach(name, "telemetry", RUN))
        refusal(lambda: segment.attach(name, "gate", RUN + 1))
    assert len(open_fds()) == before


def test_close_is_idempotent_and_frees_the_descriptor(name: str) -> None:
    before = len(open_fds())
    made = segment.create(name, "client.0", RUN)
    own = segment.attach_client_slot(name, 0, RUN)
    assert len(open_fds()) == before + 2
    for _ in range(2):
        made.close()
        own.close()
    assert len(open_fds()) == before


def test_no_descriptor_crosses_an_exec(name: str) -> None:
    create_all(name)

    def work(send: object, wait: object) -> list[str]:
        made = segment.create(name, "stopper", RUN)
        held = [segment.attach(name, of, RUN) for of in SERVICE if of != "stopper"]
        held += [segment.attach_client_slot(name, 0, RUN), segment.read_client_slot(name, 1, RUN), made]
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


def test_words_are_shared_between_processes(name: str) -> None:
    segment.create(name, "supervisor", RUN).close()
    epoch = segment.attach(name, "supervisor", RUN).word("epoch")

    def work(send: Callable[[object], None], wait: Callable[[], None]) -> None:
        own = segment.attach(name, "supervisor", RUN, write=True).word("epoch")
        for value in (1, 2**32, 2**63, 2**64 - 1):
            own.set(value)
            send(value)
            wait()

    with Child(work) as child:
        for _ in range(4):
            value = child.receive()
            assert epoch.get() == value
            child.go()
        child.result()


def test_words_refuse_what_does_not_fit_and_where_they_may_not_lie(name: str) -> None:
    segment.create(name, "supervisor", RUN).close()
    word = segment.attach(name, "supervisor", RUN, write=True).word("epoch")
    word.set(5)
    for wrong in (-1, 2**64):
        with pytest.raises(ValueError, match="memoryview"):
            word.set(wrong)
    assert word.get() == 5
    for offset in (8, 32, 63):
        with pytest.raises(ValueError, match="64-byte line"):
            Word(mmap.mmap(-1, 4096), offset)


def test_a_word_is_never_seen_half_written(name: str) -> None:
    """Two patterns that differ in every byte, set flat out by another process."""
    segment.create(name, "supervisor", RUN).close()
    patterns = (0x5555555555555555, 0xAAAAAAAAAAAAAAAA)
    segment.attach(name, "supervisor", RUN, write=True).word("epoch").set(patterns[0])

    def work(send: Callable[[object], None], wait: object) -> None:
        word = segment.attach(name, "supervisor", RUN, write=True).word("epoch")
        send("writing")
        for _ in range(400_000):
            word.set(patterns[0])
            word.set(patterns[1])

    word = segment.attach(name, "supervisor", RUN).word("epoch")
    with Child(work) as child:
        assert child.receive() == "writing"
        seen = {word.get() for _ in range(400_000)}
        child.result()
    assert seen <= set(patterns)


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


def test_a_name_taken_meanwhile_is_not_used(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Somebody else's segment that appears between unlinking and creating must not become ours."""
    with open(path_of(name, "gate"), "wb") as file:
        file.write(b"planted")
    monkeypatch.setattr(segment, "unlink", lambda instance, of: None)
    with pytest.raises(posix_ipc.ExistentialError):
        segment.create(name, "gate", RUN)
