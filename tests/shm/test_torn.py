"""Writers killed in mid-write: no reader ever takes a torn record, and what would happen without the CRC."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import pytest

from failstop.shm import cell
from failstop.shm.cell import LatestReader, LatestWriter, RingReader, RingWriter, cell_bytes
from tests.support.amounts import amount
from tests.support.pages import ROOT

from .killing import Separate, check_without_crc
from .memory import Memory, genuine, payload_of, time_of

KILLS = amount(50, 1700)
CONTROL_KILLS = 50
ROUNDS = 5
CASES = [("latest", 64), ("latest", 2048), ("latest", 65536), ("ring", 64), ("ring", 512), ("ring", 65536)]


def kill(kind: str, size: int, kills: int, mode: str) -> dict[str, Any]:
    """Run the killing in a small process of its own; returns its account."""
    words = ("tests.shm.killing", kind, size, kills, 20, mode)
    command = [sys.executable, "-m", *map(str, words)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=110, check=False)
    assert done.returncode == 0, done.stderr
    account: dict[str, Any] = json.loads(done.stdout)
    assert account["kills"] == kills
    print(f"{kind} {size} {mode}: {account}")
    return account


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "size"), CASES)
def test_killed_writers_leave_no_torn_record(kind: str, size: int) -> None:
    """Also: never older than seen before, gaps are what was counted as lost, and each successor goes on by one."""
    left = 0
    for _ in range(ROUNDS):
        account = kill(kind, size, KILLS, "real")
        assert (account["torn_accepted"], account["faults"]) == (0, [])
        assert account["reads_while_writing"] > KILLS
        assert min(account["accepted"], account["written"]) >= KILLS
        left += account["kills_that_left_a_torn_cell"]
        if left or size < 65536:
            return
    pytest.fail("no kill landed in the middle of a store")


@pytest.mark.parametrize(("kind", "size"), [CASES[1], CASES[3]])
def test_control_the_same_without_the_crc_reads_torn_records(kind: str, size: int) -> None:
    """With header, payload and CRC as separate stores and no CRC compared, this harness must see torn records."""
    account = kill(kind, size, CONTROL_KILLS, "control")
    assert account["torn_accepted"] > 0


class Stepwise:
    """A view that stores a byte at a time and calls `each` after every one."""

    def __init__(self, memory: Memory) -> None:
        self.memory = memory
        self.each: Callable[[], object] = lambda: None

    def __getitem__(self, where: slice) -> bytes:
        return self.memory[where]

    def __setitem__(self, where: slice, data: bytes) -> None:
        for i, byte in enumerate(data):
            self.memory.data[where.start + i] = byte
            self.each()


SEED = cell.seed("test.torn", 1)
Patch = pytest.MonkeyPatch


@pytest.mark.parametrize("stores", ["one", "separate"])
@pytest.mark.parametrize("kind", ["latest", "ring"])
@pytest.mark.parametrize("crc", [True, False])
def test_a_reader_after_every_byte_of_a_store(kind: str, crc: bool, stores: str, monkeypatch: Patch) -> None:
    """No luck is in it: with the CRC nothing torn is read, without it much is."""
    if not crc:
        monkeypatch.setattr(cell, "check", check_without_crc)
    view = Stepwise(Memory(max(2 * cell_bytes(40), 4 * 64)))
    target = view if stores == "one" else Separate(view)
    latest = kind == "latest"
    writer = LatestWriter(target, 0, 40, 2, SEED) if latest else RingWriter(target, 0, 40, 4, SEED)
    reader = LatestReader(view, 0, 40, 2, SEED) if latest else RingReader(view, 0, 40, 4, SEED)
    torn = seen = 0

    def look() -> None:
        nonlocal torn, seen
        entry = reader.read() if isinstance(reader, LatestReader) else reader.next()
        if entry:
            seen = entry[0]
            torn += not genuine(entry)

    view.each = look
    for seq in range(1, 30):
        put = writer.write if isinstance(writer, LatestWriter) else writer.put
        assert put(payload_of(seq, 16 + seq % 25), time_of(seq)) == seq
    if crc:
        assert torn == 0
        assert seen == 29
    else:
        assert torn > 0
