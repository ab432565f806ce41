"""Bytes that nobody wrote: scribbled over, copied about. A reader takes a record that was written or none, and never
falls."""

from __future__ import annotations

import os
import random

import pytest

from failstop.messages import records
from failstop.messages.layout import SEGMENTS
from failstop.messages.segments import AttachError
from tests.support.amounts import amount

from .segments import NAMES, path_of
from .written import Written

ROUNDS = amount(32, 1500)
TAKEN_OVER = amount(8, 80)


@pytest.mark.parametrize("of", NAMES)
@pytest.mark.slow
def test_scribbled_over(name: str, of: str) -> None:
    """With readers that were there before and ones that come after; now and then the segment is made whole again."""
    dice = random.Random(of)
    written = Written(name, of, dice)
    try:
        if not written.genuine:
            assert all(record.kind in ("word", "futexes") for record in written.spec.records.values())
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
        for _ in range(TAKEN_OVER):
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
    """A payload that passes the CRC was still written by a client: unpacking it must not do worse."""
    dice = random.Random(5)
    for _ in range(3000):
        payload = dice.randbytes(dice.randrange(0, 330))
        for unpack in (records.HELLO.unpack, records.COMMAND.unpack, records.REQUEST.unpack, records.LATCH.unpack):
            try:
                unpack(payload)
            except ValueError:
                continue
