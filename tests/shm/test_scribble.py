"""Bytes that nobody wrote: scribbled over, copied about, truncated, unlinked. A reader takes a record that was written
or none, and never falls."""

from __future__ import annotations

import mmap
import os
import random
import signal
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

from failstop.shm import records, segment
from failstop.shm.latest import LatestReader
from failstop.shm.layout import BY_NAME, CLIENT_SLOTS, SEGMENTS, SegmentSpec
from failstop.shm.ring import RingReader
from failstop.shm.segment import AttachError, Segment
from failstop.shm.views import FileView

from .children import Child
from .memory import genuine, payload_of, time_of

if TYPE_CHECKING:
    from failstop.shm.slot import Entry

RUN = 0xFEEDFACE
ROUNDS = 1500
NAMES = [spec.name for spec in SEGMENTS]
CLIENT_NAMES = [f"client.{i}" for i in range(CLIENT_SLOTS)]


def path_of(instance: str, of: str) -> str:
    return "/dev/shm" + segment.shm_name(instance, of)


class Written:
    """A segment with a history in every record, the readers on it, and what may be read from each."""

    def __init__(self, instance: str, of: str, dice: random.Random) -> None:
        self.spec: SegmentSpec = BY_NAME[of]
        self.dice = dice
        segment.create(instance, of, RUN).close()
        self.instance = instance
        self.client = of in CLIENT_NAMES
        writes = self.attached(write=True)
        self.genuine: dict[str, set[Entry]] = {}
        for record in self.spec.records.values():
            if record.kind == "word":
                writes.word(record.name).set(dice.getrandbits(64))
                continue
            if record.kind == "mutexes":
                continue
            self.genuine[record.name] = found = set()
            put = (
                writes.latest_writer(record.name).write
                if record.kind == "latest"
                else writes.ring_writer(record.name).put
            )
            for seq in range(1, record.slots + 6):
                payload = payload_of(seq, dice.randrange(record.capacity + 1))
                assert put(payload, time_of(seq)) == seq
                found.add((seq, time_of(seq), payload))
        writes.close()
        self.reads = self.attached(write=False)
        with open(path_of(instance, of), "rb") as file:
            self.image = file.read()
        self.fd = os.open(path_of(instance, of), os.O_RDWR)
        self.seen = 0

    def attached(self, *, write: bool) -> Segment:
        index = int(self.spec.name.rpartition(".")[2]) if self.client else -1
        if not self.client:
            return segment.attach(self.instance, self.spec.name, RUN, write=write)
        if write:
            return segment.attach_client_slot(self.instance, index, RUN)
        return segment.read_client_slot(self.instance, index, RUN)

    def close(self) -> None:
        os.close(self.fd)
        self.reads.close()

    def readers(self) -> dict[str, list[LatestReader | RingReader]]:
        """A reader of each kind for each record."""
        found: dict[str, list[LatestReader | RingReader]] = {}
        for record in self.spec.records.values():
            if record.kind == "latest":
                found[record.name] = [self.reads.latest_reader(record.name)]
            elif record.kind == "ring":
                found[record.name] = [
                    self.reads.ring_reader(record.name, from_oldest=oldest) for oldest in (True, False)
                ]
        return found

    def read_all(self, readers: dict[str, list[LatestReader | RingReader]]) -> None:
        """Read every record to its end: whatever comes out was written to that record."""
        for name, several in readers.items():
            for reader in several:
                if isinstance(reader, LatestReader):
                    entry = reader.read()
                    assert entry is None or entry in self.genuine[name]
                    self.seen += entry is not None
                    continue
                last = 0
                for _ in range(self.spec.records[name].slots + 1):
                    entry = reader.next()
                    if entry is None:
                        break
                    assert entry in self.genuine[name]
                    assert entry[0] > last
                    last = entry[0]
                    self.seen += 1
                assert reader.next() is None
        for record in self.spec.records.values():
            if record.kind == "word" and not self.client:
                assert 0 <= self.reads.word(record.name).get() < 2**64

    def span(self) -> tuple[int, int]:
        """A random place, more often a small one."""
        size = min(self.spec.size, 1 << self.dice.randrange(0, 17))
        at = self.dice.randrange(self.spec.size - size + 1)
        return at, size

    def scribble(self) -> None:
        """One of many ways to spoil the segment."""
        at, size = self.span()
        way = self.dice.randrange(7)
        if way == 0:
            data = self.dice.randbytes(size)
        elif way == 1:
            data = bytes(size)
        elif way == 2:
            data = b"\xff" * size
        elif way == 3:
            data = bytes([self.image[at] ^ 1 << self.dice.randrange(8)])
        elif way == 4:  # bytes from elsewhere in the same segment, records and all
            source = self.dice.randrange(self.spec.size - size + 1)
            data = self.image[source : source + size]
        elif way == 5:  # the same by lines, so that whole slots move
            at, size = at // 64 * 64, max(64, size // 64 * 64)
            source = self.dice.randrange(self.spec.size // 64) * 64
            data = self.image[source : source + size]
        else:
            at, data = 0, self.dice.randbytes(self.spec.size)
        os.pwrite(self.fd, data[: self.spec.size - at], at)

    def restore(self) -> None:
        os.ftruncate(self.fd, self.spec.size)
        os.pwrite(self.fd, self.image, 0)


@pytest.mark.parametrize("of", NAMES)
def test_scribbled_over(name: str, of: str) -> None:
    """With readers that were there before and ones that come after; now and then the segment is made whole again."""
    dice = random.Random(of)
    written = Written(name, of, dice)
    try:
        if not written.genuine:
            assert all(record.kind in ("word", "mutexes") for record in written.spec.records.values())
        resident = written.readers()
        written.read_all(written.readers())
        assert written.seen >= len(written.genuine)
        for round_number in range(ROUNDS):
            if round_number % 8 == 0:
                written.restore()
                resident = written.readers()
            written.scribble()
            written.read_all(resident)
            if round_number % 4 == 0:
                written.read_all(written.readers())
        written.restore()
        written.read_all(written.readers())
    finally:
        written.close()


@pytest.mark.parametrize("of", NAMES)
def test_a_scribbled_segment_is_attached_whole_or_refused(name: str, of: str) -> None:
    dice = random.Random(of)
    written = Written(name, of, dice)
    refused = attached = 0
    try:
        for _ in range(ROUNDS):
            written.restore()
            written.scribble()
            with open(path_of(name, of), "rb") as file:
                whole = file.read(128)[:104] == written.image[:104]
            if whole:
                attached += 1
                written.attached(write=True).close()
                continue
            refused += 1
            with pytest.raises(AttachError, match="no whole header"):
                written.attached(write=True)
    finally:
        written.close()
    assert refused > 0
    assert attached > 0


@pytest.mark.parametrize("of", [spec.name for spec in SEGMENTS if spec.records and not spec.name.startswith("client")])
def test_writers_of_scribbled_segments_go_on(name: str, of: str) -> None:
    """A successor that takes over what is damaged writes what readers can read."""
    dice = random.Random(of)
    written = Written(name, of, dice)
    try:
        for _ in range(20):
            for _ in range(dice.randrange(1, 6)):
                written.scribble()
            os.pwrite(written.fd, written.image[:128], 0)
            own = written.attached(write=True)
            for record in written.genuine:
                kind = written.spec.records[record].kind
                if kind == "latest":
                    reader = own.latest_reader(record)
                    seq = own.latest_writer(record).write(b"new", 5)
                    assert reader.read() == (seq, 5, b"new")
                else:
                    ring = own.ring_reader(record)
                    seq = own.ring_writer(record).put(b"new", 5)
                    assert ring.next() == (seq, 5, b"new")
            written.restore()
    finally:
        written.close()


def test_garbage_payloads_are_value_errors_at_most() -> None:
    """What passes the CRC of a client segment was still written by a client: unpacking it must not do worse."""
    dice = random.Random(5)
    for _ in range(3000):
        payload = dice.randbytes(dice.randrange(0, 330))
        for unpack in (records.unpack_hello, records.unpack_command, records.unpack_request, records.unpack_cause):
            try:
                unpack(payload)
            except ValueError:
                continue


@pytest.mark.parametrize("of", CLIENT_NAMES)
def test_truncated_to_every_kind_of_size(name: str, of: str) -> None:
    dice = random.Random(of)
    written = Written(name, of, dice)
    try:
        resident = written.readers()
        sizes = [
            0,
            1,
            23,
            24,
            127,
            128,
            129,
            written.spec.size - 1,
            *(dice.randrange(written.spec.size) for _ in range(60)),
        ]
        for size in sizes:
            os.ftruncate(written.fd, size)
            written.read_all(resident)
            written.read_all(written.readers())
            with pytest.raises(AttachError, match=r"damaged|whole header|wrong size"):
                segment.attach_client_slot(name, int(of[-1]), RUN)
            if dice.random() < 0.5:  # grown again: zeros where its bytes were
                os.ftruncate(written.fd, written.spec.size)
                written.read_all(resident)
            written.restore()
        os.ftruncate(written.fd, written.spec.size * 4)
        written.read_all(written.readers())
        assert written.seen > 0
    finally:
        written.close()


def test_a_copy_of_a_truncated_file_is_short() -> None:
    fd = os.memfd_create("cut")
    view = FileView(fd)
    view[0:8] = b"12345678"
    assert view[0:8] == b"12345678"
    assert view[4:100] == b"5678"
    os.ftruncate(fd, 3)
    assert view[0:8] == b"123"
    assert view[3:8] == b""
    os.close(fd)


def test_a_client_that_writes_to_its_truncated_segment_is_read_again(name: str) -> None:
    segment.create(name, "client.2", RUN).close()
    own = segment.attach_client_slot(name, 2, RUN)
    seen = segment.read_client_slot(name, 2, RUN)
    writer, reader = own.latest_writer("command"), seen.latest_reader("command")
    writer.write(b"before", 1)
    os.truncate(path_of(name, "client.2"), 0)
    assert reader.read() is None
    seq = writer.write(b"after", 2)
    assert reader.read() == (seq, 2, b"after")
    own.close()
    seen.close()


def reading_child(name: str, of: str, attach: Callable[[], Segment]) -> Child:
    """A child that reads a client's records until told to end; returns how many values and how many Nones it got."""

    def work(send: Callable[[object], None], wait: Callable[[], None]) -> tuple[int, int]:
        seen = attach()
        readers = [seen.latest_reader(record) for record in seen.spec.records]
        for reader in readers:  # before the truncating starts
            reader.read()
        send("reading")
        values = nones = 0
        end = time.monotonic() + 1.0
        limit = time.monotonic() + 20
        while time.monotonic() < end or (not (values and nones) and time.monotonic() < limit):
            for reader in readers:
                entry = reader.read()
                if entry is None:
                    nones += 1
                    continue
                assert genuine(entry)
                values += 1
        return values, nones

    return Child(work)


def truncate_all_the_while(name: str, of: str, child: Child) -> None:
    """Truncate, regrow, scribble and write, until the reader has ended."""
    dice = random.Random(1)
    size = BY_NAME[of].size
    own = segment.attach_client_slot(name, int(of[-1]), RUN)
    with open(path_of(name, of), "rb") as file:
        image = file.read()
    writers = [own.latest_writer(record) for record in own.spec.records]
    fd = os.open(path_of(name, of), os.O_RDWR)
    watch = os.pidfd_open(child.pid)
    try:
        seq = 0
        limit = time.monotonic() + 30
        while time.monotonic() < limit and os.waitid(os.P_PIDFD, watch, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
            seq += 1
            for writer in writers:
                writer.write(payload_of(writer._seq + 1, 40), time_of(writer._seq + 1))
            if dice.random() < 0.3:
                os.ftruncate(fd, dice.choice([0, 0, size, dice.randrange(size)]))
            if dice.random() < 0.3:
                os.pwrite(fd, dice.randbytes(100), dice.randrange(size))
            if dice.random() < 0.1:
                os.ftruncate(fd, size)
                os.pwrite(fd, image[:128], 0)
    finally:
        os.close(watch)
        os.close(fd)
        own.close()


def test_a_truncating_client_costs_the_reader_no_sigbus(name: str) -> None:
    segment.create(name, "client.0", RUN).close()
    with reading_child(name, "client.0", lambda: segment.read_client_slot(name, 0, RUN)) as child:
        assert child.receive() == "reading"
        truncate_all_the_while(name, "client.0", child)
        values, nones = child.result()
        assert child.wait() == 0
    assert values > 0
    assert nones > 0


def test_control_a_mapped_reader_dies_of_sigbus(name: str) -> None:
    """The harness can fail: the same through a mapping kills the reader."""
    segment.create(name, "client.0", RUN).close()

    def attach_mapped() -> Segment:
        with open(path_of(name, "client.0"), "rb") as file:
            mapped = mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ)
        return Segment(BY_NAME["client.0"], RUN, mapped, mapped, -1)

    with pytest.raises(TypeError, match="is written by clients"):
        segment.attach(name, "client.0", RUN)
    with reading_child(name, "client.0", attach_mapped) as child:
        assert child.receive() == "reading"
        truncate_all_the_while(name, "client.0", child)
        assert child.wait() == -signal.SIGBUS


def test_an_unlinked_client_segment_is_read_on(name: str) -> None:
    """Its holder and the service have it open; only who comes later finds nothing."""
    segment.create(name, "client.3", RUN).close()
    own = segment.attach_client_slot(name, 3, RUN)
    seen = segment.read_client_slot(name, 3, RUN)
    writer, reader = own.latest_writer("command"), seen.latest_reader("command")
    writer.write(b"one", 1)
    os.unlink(path_of(name, "client.3"))
    assert reader.read() == (1, 1, b"one")
    writer.write(b"two", 2)
    assert reader.read() == (2, 2, b"two")
    for attach in (segment.attach_client_slot, segment.read_client_slot):
        with pytest.raises(AttachError) as refused:
            attach(name, 3, RUN)
        assert refused.value.kind == "absent"
    own.close()
    seen.close()


def test_unlinked_service_segments_are_read_on(name: str) -> None:
    segment.create(name, "gate", RUN).close()
    own, seen = segment.attach(name, "gate", RUN, write=True), segment.attach(name, "gate", RUN)
    segment.unlink_all(name)
    own.ring_writer("frames").put(b"frame", 1)
    assert seen.ring_reader("frames", from_oldest=True).next() == (1, 1, b"frame")
    own.word("beat_ns").set(77)
    assert seen.word("beat_ns").get() == 77
