"""Segments whose file a client has truncated or unlinked: a reader takes a record that was written or
none, and never falls."""

from __future__ import annotations

import mmap
import os
import random
import signal
import time
from collections.abc import Callable

from failstop.messages import segments
from failstop.messages.layout import SEGMENT_BY_NAME
from failstop.shm.segment import Segment
from tests.support.children import Child

from .memory import genuine, payload_of, time_of
from .segments import RUN, path_of


def test_a_client_that_writes_to_its_truncated_segment_is_read_again(name: str) -> None:
    segments.create(name, "client.2", RUN).close()
    own = segments.attach(name, "client.2", RUN, write=True)
    seen = segments.read_client_slot(name, 2, RUN)
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
        readers = [seen.latest_reader(name) for name, record in seen.spec.records.items() if record.kind == "latest"]
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
    size = SEGMENT_BY_NAME[of].size
    own = segments.attach(name, of, RUN, write=True)
    with open(path_of(name, of), "rb") as file:
        image = file.read()
    writers = {
        own.latest_writer(name): record.capacity for name, record in own.spec.records.items() if record.kind == "latest"
    }
    fd = os.open(path_of(name, of), os.O_RDWR)
    watch = os.pidfd_open(child.pid)
    try:
        seq = 0
        limit = time.monotonic() + 30
        while time.monotonic() < limit and os.waitid(os.P_PIDFD, watch, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
            seq += 1
            for writer, capacity in writers.items():
                assert writer.write(payload_of(seq, min(40, capacity)), time_of(seq)) == seq
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
    segments.create(name, "client.0", RUN).close()
    with reading_child(name, "client.0", lambda: segments.read_client_slot(name, 0, RUN)) as child:
        assert child.receive() == "reading"
        truncate_all_the_while(name, "client.0", child)
        values, nones = child.result()
        assert child.wait() == 0
    assert values > 0
    assert nones > 0


def test_control_a_mapped_reader_dies_of_sigbus(name: str) -> None:
    """The harness can fail: the same through a mapping kills the reader."""
    segments.create(name, "client.0", RUN).close()

    def attach_mapped() -> Segment:
        with open(path_of(name, "client.0"), "rb") as file:
            mapped = mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ)
        return Segment(SEGMENT_BY_NAME["client.0"], RUN, mapped)

    for write in (False, True):
        attached = segments.attach(name, "client.0", RUN, write=write)
        assert attached.mapped is None
        attached.close()
    with reading_child(name, "client.0", attach_mapped) as child:
        assert child.receive() == "reading"
        truncate_all_the_while(name, "client.0", child)
        assert child.wait() == -signal.SIGBUS
