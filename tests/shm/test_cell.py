"""The cell: what one slice copy accepts, over every mix of old and new bytes that a write can leave."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.messages.layout import SEGMENTS
from failstop.shm import cell

SEED = cell.seed("gate.state", 0x0123456789ABCDEF)


def image(seq: int, t_ns: int, payload: bytes, seed: int = SEED) -> bytes:
    return cell.build(seq, t_ns, payload, seed, len(payload))


def mixes(old: bytes, new: bytes, word: int) -> list[bytes]:
    """All 2**n mixes of the n words of two images of one size."""
    assert len(old) == len(new)
    words = ((old[at : at + word], new[at : at + word]) for at in range(0, len(old), word))
    return [b"".join(mix) for mix in itertools.product(*words)]


def padded(data: bytes, size: int, rest: bytes = b"") -> bytes:
    """The cell's bytes in memory: the image, then whatever an older and longer one left behind it."""
    left = (rest or bytes(size))[len(data) : size]
    return data + left + bytes(size - len(data) - len(left))


def only_pure(old: bytes, new: bytes, word: int) -> tuple[int, int]:
    """Check every mix; returns how many were checked and how many were accepted."""
    allowed = {cell.check(old, SEED), cell.check(new, SEED)}
    assert None not in allowed
    checked = accepted = 0
    for mix in mixes(old, new, word):
        checked += 1
        entry = cell.check(mix, SEED)
        if entry is None:
            continue
        accepted += 1
        assert entry in allowed
        # Accepted only when all that the CRC covers is of one image; behind it anything may lie.
        stop = cell.CELL_HEADER_BYTES + len(entry[2])
        assert mix[:stop] in (old[:stop], new[:stop])
    return checked, accepted


def counter(value: int, size: int) -> bytes:
    return (value.to_bytes(8, "little") * (size // 8 + 1))[:size]


PAIRS_OF_PAYLOADS: dict[str, tuple[Callable[[int], bytes], Callable[[int], bytes]]] = {
    "counter + 1": (lambda n: counter(41, n), lambda n: counter(42, n)),
    "counter wraps a byte": (lambda n: counter(255, n), lambda n: counter(256, n)),
    "zeros to zeros": (bytes, bytes),
    "zeros to ones": (bytes, lambda n: b"\1" * n),
    "zeros to 0xff": (bytes, lambda n: b"\xff" * n),
    "complement": (lambda n: b"\x55" * n, lambda n: b"\xaa" * n),
    "same text": (lambda n: (b"front_left " * 20)[:n], lambda n: (b"front_left " * 20)[:n]),
    "one bit": (lambda n: b"\x10" * n, lambda n: b"\x10" * (n - 1) + b"\x11"),
    "first bit": (lambda n: b"\x10" * n, lambda n: b"\x11" + b"\x10" * (n - 1)),
    "floats": (
        lambda n: struct.pack(f"<{n // 8}d", *range(n // 8)),
        lambda n: struct.pack(f"<{n // 8}d", *[0.2] * (n // 8)),
    ),
}
STEPS = {"next ms": (7, 10**15, 8, 10**15 + 10**6), "same time": (7, 9, 8, 9), "carry": (255, 5, 256, 6)}


@pytest.mark.parametrize("pair", PAIRS_OF_PAYLOADS)
@pytest.mark.parametrize(("word", "sizes"), [(8, (64, 96)), (4, (48,))])
def test_every_mix_of_the_words_of_two_images(word: int, sizes: tuple[int, ...], pair: str) -> None:
    before, after = PAIRS_OF_PAYLOADS[pair]
    for size, (seq, t_ns, seq_after, t_after_ns) in itertools.product(sizes, STEPS.values()):
        room = size - cell.CELL_HEADER_BYTES
        old, new = image(seq, t_ns, before(room)), image(seq_after, t_after_ns, after(room))
        checked, accepted = only_pure(old, new, word)
        assert checked == 2 ** (size // word)
        # Words that are the same in both images make several mixes one image.
        same = sum(old[i : i + word] == new[i : i + word] for i in range(0, size, word))
        assert accepted == 2 * 2**same


@pytest.mark.parametrize(("shorter", "longer"), [(0, 24), (8, 24), (16, 20), (17, 24), (23, 24), (1, 2), (24, 24)])
def test_every_mix_of_payloads_of_different_length(shorter: int, longer: int) -> None:
    oldest = image(3, 1, b"\xee" * 24)
    for first, second in ((shorter, longer), (longer, shorter)):
        old = padded(image(5, 2, counter(7, first)), 48, oldest)
        new = padded(image(7, 3, counter(8, second)), 48, old)
        for word in (8, 4):
            only_pure(old, new, word)


@pytest.mark.parametrize("pair", PAIRS_OF_PAYLOADS)
def test_every_window_of_new_bytes_and_of_old_ones(pair: str) -> None:
    """A store that goes up, down, or outwards from any byte to any other, and one that left a hole."""
    before, after = PAIRS_OF_PAYLOADS[pair]
    old, new = image(1, 5, before(72)), image(3, 6, after(72))
    allowed = {cell.check(old, SEED): old, cell.check(new, SEED): new}
    for first, second in ((old, new), (new, old)):
        for start, stop in itertools.combinations(range(len(old) + 1), 2):
            mix = first[:start] + second[start:stop] + first[stop:]
            entry = cell.check(mix, SEED)
            assert entry is None or allowed[entry] == mix


def test_every_single_bit_error_is_refused() -> None:
    whole = image(77, 88, counter(12345, 40))
    for bit in range(len(whole) * 8):
        flipped = bytearray(whole)
        flipped[bit // 8] ^= 1 << bit % 8
        assert cell.check(bytes(flipped), SEED) is None


@given(
    seq=st.integers(1, 2**64 - 1),
    t_ns=st.integers(0, 2**64 - 1),
    payload=st.binary(max_size=300),
    tail=st.binary(max_size=40),
    seed=st.integers(0, 2**32 - 1),
)
def test_round_trip_with_anything_behind_it(seq: int, t_ns: int, payload: bytes, tail: bytes, seed: int) -> None:
    raw = cell.build(seq, t_ns, payload, seed, 300) + tail
    assert cell.check(raw, seed) == (seq, t_ns, payload)


@given(payload=st.binary(max_size=60), cut=st.integers(0, 84))
def test_a_cut_copy_is_not_whole(payload: bytes, cut: int) -> None:
    raw = image(9, 9, payload)
    assert cell.check(raw[:cut], SEED) == ((9, 9, payload) if len(raw) <= cut else None)


def test_sequence_0_is_never_a_record() -> None:
    assert cell.check(image(0, 1, b"payload"), SEED) is None


def test_a_length_beyond_the_cell_is_refused_even_with_a_right_crc() -> None:
    """The length leads into the next cell: its bytes must not be taken for this one's."""
    raw = image(1, 1, b"x" * 100)
    assert cell.check(raw, SEED) is not None
    assert cell.check(raw[:64], SEED) is None


def test_a_payload_over_the_capacity_is_refused_by_name() -> None:
    cell.build(1, 1, b"12345678", SEED, 8)
    with pytest.raises(cell.PayloadTooLarge, match="payload of 9 bytes, the record holds 8"):
        cell.build(1, 1, b"123456789", SEED, 8)


def test_every_record_of_every_run_has_its_own_seed() -> None:
    """A cell copied to the place of another record, or left from another run, never passes there."""
    names = ["header"] + [f"{spec.name}.{record}" for spec in SEGMENTS for record in spec.records]
    runs = (0, 1, 2, 0x0123456789ABCDEF, 2**64 - 1)
    assert len({cell.seed(name, run) for name in names for run in runs}) == len(names) * len(runs)


def test_the_seed_of_the_headers_is_the_same_in_every_version() -> None:
    """Programs of different layouts read each other's headers, to say so."""
    assert cell.seed("header", 0) == 0x0E0B70A5


@given(payload=st.binary(max_size=100), one=st.integers(0, 2**32 - 1), two=st.integers(0, 2**32 - 1))
def test_a_cell_passes_with_no_other_seed(payload: bytes, one: int, two: int) -> None:
    raw = cell.build(1, 1, payload, one, 100)
    assert (cell.check(raw, two) is not None) == (one == two)
