"""Latest: the newest whole value, with a writer that runs, dies in mid-write, and has a successor."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.shm import cell
from failstop.shm.cell import LatestReader, LatestWriter, cell_bytes

from .memory import Death, Memory, genuine, payload_of, time_of

if TYPE_CHECKING:
    from failstop.shm.cell import View

SEED = cell.seed("test.latest", 1)
AT = 128


def pair(view: View, capacity: int) -> tuple[LatestWriter, LatestReader]:
    return LatestWriter(view, AT, capacity, 2, SEED), LatestReader(view, AT, capacity, 2, SEED)


def made() -> tuple[Memory, LatestWriter, LatestReader]:
    """Memory, a writer and a reader of a record of 40 bytes."""
    memory = Memory(AT + 2 * cell_bytes(40))
    return memory, *pair(memory, 40)


def write(writer: LatestWriter, seq: int, size: int) -> None:
    assert writer.write(payload_of(seq, size), time_of(seq)) == seq


def test_one_store_and_one_copy() -> None:
    """The rule everything rests on: a write is one slice assignment, a read of whole memory one slice copy."""
    memory, writer, reader = made()
    memory.copies.clear()
    write(writer, 1, 40)
    write(writer, 2, 13)
    assert [(at, len(data)) for at, data in memory.stores] == [(AT + cell_bytes(40), 64), (AT, 37)]
    assert memory.copies == []
    for _ in range(3):
        reader.read()
    assert memory.copies == [slice(AT, AT + 2 * cell_bytes(40))] * 3


def test_a_copy_is_made_again_only_where_it_may_have_been_overtaken_and_then_twice() -> None:
    memory, writer, reader = made()

    def copies() -> int:
        memory.copies.clear()
        reader.read()
        return len(memory.copies)

    assert copies() == 1, "nobody has written it"
    for seq in (1, 2, 3):
        write(writer, seq, 40)
        assert copies() == 1, "a newer value"
    memory.data[AT] ^= 1
    assert copies() == 1, "the next value is being written"
    memory.data[AT + cell_bytes(40)] ^= 1
    assert copies() == 3, "no value is whole"
    assert reader.read() is None


@pytest.mark.parametrize("damage", ["first byte", "last byte", "zeroed", "filled", "other record", "other run"])
def test_a_damaged_newest_falls_back_to_the_one_before(damage: str) -> None:
    memory, writer, reader = made()
    for seq in range(1, 8):
        write(writer, seq, 40)
        at = AT + (seq & 1) * cell_bytes(40)
        whole = bytes(memory.data[at : at + 64])
        foreign = cell.seed("test.other" if damage == "other record" else "test.latest", 2)
        memory.data[at : at + 64] = {
            "first byte": bytes([whole[0] ^ 1]) + whole[1:],
            "last byte": whole[:-1] + bytes([whole[-1] ^ 0x80]),
            "zeroed": bytes(64),
            "filled": b"\xff" * 64,
            "other record": cell.build(seq, time_of(seq), payload_of(seq, 40), foreign, 40),
            "other run": cell.build(seq, time_of(seq), payload_of(seq, 40), foreign, 40),
        }[damage]
        assert reader.read() == ((seq - 1, time_of(seq - 1), payload_of(seq - 1, 40)) if seq > 1 else None)
        memory.data[at : at + 64] = whole
        assert reader.read() == (seq, time_of(seq), payload_of(seq, 40))


@pytest.mark.parametrize("filler", [b"\0", b"\xff"])
def test_a_length_that_leads_into_the_other_cell_is_no_value_even_with_a_right_crc(filler: bytes) -> None:
    """The bytes in the other cell's place say a number below or above, so that either cell is looked at first."""
    memory = Memory(AT + 2 * cell_bytes(40))
    data = cell.build(2, 1, filler * 80, SEED, 80)
    memory.data[AT : AT + len(data)] = data
    assert LatestReader(memory, AT, 40, 2, SEED).read() is None


def test_a_death_at_any_byte_of_a_write_leaves_the_value_before_to_a_successor() -> None:
    capacity = 40
    size = cell.CELL_HEADER_BYTES + capacity
    for cut in range(size + 1):
        memory = Memory(AT + 2 * cell_bytes(capacity))
        writer, reader = pair(memory, capacity)
        last = 0
        for generation in range(4):
            for _ in range(1 + (generation + cut) % 3):
                last += 1
                write(writer, last, capacity)
            memory.left = cut
            with pytest.raises(Death):
                writer.write(payload_of(last + 1, capacity), time_of(last + 1))
            last += cut == size
            assert reader.read() == (last, time_of(last), payload_of(last, capacity))
            writer = LatestWriter(memory, AT, capacity, 2, SEED)
            for _ in range(generation):  # successors that die in the same cell
                memory.left = min(cut, size - 1)
                with pytest.raises(Death):
                    writer.write(payload_of(last + 1, capacity), time_of(last + 1))
                writer = LatestWriter(memory, AT, capacity, 2, SEED)
                assert reader.read() == (last, time_of(last), payload_of(last, capacity))


class Overtaken(Memory):
    """A view one copy of which is overtaken: `meanwhile` runs when the copy has come to its byte `at`."""

    def __init__(self, memory: Memory, at: int) -> None:
        super().__init__(0)
        self.memory = memory
        self.at = at
        self.meanwhile: Callable[[], object] | None = None

    def __getitem__(self, where: slice) -> bytes:
        early = self.memory[where]
        if self.meanwhile is None:
            return early
        self.meanwhile()
        self.meanwhile = None
        return early[: self.at] + self.memory[where][self.at :]


@pytest.mark.parametrize("writes", [1, 2, 3, 4])
@pytest.mark.parametrize("cut", [0, 1, 20, 40, 63, 64])
def test_a_copy_that_is_overtaken_gives_a_value_and_none_older_than_seen(writes: int, cut: int) -> None:
    """A reader that sleeps anywhere in its copy may find both cells torn, or a whole cell older than what it read
    before: though there always was a whole value, and a newer one."""
    for at in range(2 * cell_bytes(40) + 1):
        memory, writer, _ = made()
        for seq in (1, 2, 3):
            write(writer, seq, 40)

        def meanwhile(writer: LatestWriter = writer, memory: Memory = memory) -> None:
            for seq in range(4, 3 + writes):
                write(writer, seq, 40)
            memory.left = cut
            with pytest.raises(Death):
                write(writer, 3 + writes, 40)

        view = Overtaken(memory, at)
        reader = LatestReader(view, AT, 40, 2, SEED)
        assert reader.read() == (3, time_of(3), payload_of(3, 40))
        view.meanwhile = meanwhile
        entry = reader.read()
        assert entry is not None
        assert entry[0] >= 3
        assert genuine(entry, 40)


def test_a_value_that_was_seen_and_is_damaged_since_falls_back_too() -> None:
    memory, writer, reader = made()
    write(writer, 1, 40)
    write(writer, 2, 40)
    assert reader.read() == (2, time_of(2), payload_of(2, 40))
    memory.data[AT] ^= 1
    for _ in range(3):
        assert reader.read() == (1, time_of(1), payload_of(1, 40))


@given(cuts=st.lists(st.tuples(st.integers(0, 70), st.integers(0, 46), st.booleans()), max_size=40))
def test_model(cuts: list[tuple[int, int, bool]]) -> None:
    memory, writer, reader = made()
    seq, value = 0, None
    for cut, size, dies in cuts:
        payload = payload_of(seq + 1, size)
        if size > 40:
            with pytest.raises(cell.PayloadTooLarge):
                writer.write(payload, 5)
        elif not dies:
            seq, value = seq + 1, payload
            assert writer.write(payload, 5) == seq
        else:
            memory.left = cut
            with pytest.raises(Death):
                writer.write(payload, 5)
            found = reader.read()
            # The model is told what the death left; a cut behind the last byte that differs is a whole write.
            if found is not None and found[0] == seq + 1:
                assert found[2] == payload
                seq, value = found[0], payload
            writer = LatestWriter(memory, AT, 40, 2, SEED)
        assert reader.read() == (None if value is None else (seq, 5, value))
