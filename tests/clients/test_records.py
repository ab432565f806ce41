"""Records as C writes and reads them: each is what Python writes and reads, for every value."""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import math
import os
import random
import struct
from collections.abc import Iterator
from zlib import crc32

import msgpack
import pytest

from failstop.messages import layout, records
from failstop.messages.packing import Value
from failstop.policy import causes, kinematics
from failstop.policy.causes import Kind
from failstop.policy.layouts import BOARDS, LAYOUTS
from failstop.policy.setting import SettingError
from failstop.policy.settings import Settings, mounted_wheels
from failstop.shm import cell
from tests.support.amounts import amount
from tests.support.c_client import whole_library

ROUNDS = amount(5_000, 1_000_000)
SPACE = ctypes.create_string_buffer(65536)


class Entry(ctypes.Structure):
    _fields_ = [
        ("seq", ctypes.c_uint64),
        ("t_ns", ctypes.c_uint64),
        ("data", ctypes.c_void_p),
        ("size", ctypes.c_size_t),
    ]


class Wheels(ctypes.Structure):
    _fields_ = [
        ("count", ctypes.c_int),
        ("speeds", ctypes.c_int),
        ("id", ctypes.c_int * 4),
        ("sign", ctypes.c_int * 4),
        ("names", ctypes.c_char_p * 4),
        ("known", ctypes.c_bool),
        ("steered", ctypes.c_bool),
        ("back", ctypes.c_double * 5 * 3),
        ("wheelbase_m", ctypes.c_double),
        ("most_rad", ctypes.c_double),
    ]


class Text(ctypes.Structure):
    _fields_ = [("at", ctypes.c_void_p), ("size", ctypes.c_size_t), ("whole", ctypes.c_size_t)]


@pytest.fixture(scope="module")
def c() -> ctypes.CDLL:
    """The library with its internal functions."""
    found = whole_library()
    found.fsi_crc.restype = ctypes.c_uint32
    found.fsi_seed.restype = ctypes.c_uint32
    found.fsi_seed.argtypes = [ctypes.c_char_p, ctypes.c_uint64]
    found.fsi_build.restype = ctypes.c_size_t
    found.fsi_build.argtypes = [
        ctypes.c_void_p, ctypes.c_uint64, ctypes.c_uint64, ctypes.c_char_p, ctypes.c_size_t, ctypes.c_uint32,
    ]  # fmt: skip
    found.fsi_check.restype = ctypes.c_bool
    found.fsi_check.argtypes = [ctypes.c_char_p, ctypes.c_size_t, ctypes.c_uint32, ctypes.c_void_p]
    found.fsi_newest.restype = ctypes.c_bool
    found.fsi_newest.argtypes = [ctypes.c_char_p, ctypes.c_size_t, ctypes.c_uint32, ctypes.c_void_p]
    found.fsi_wheels.restype = ctypes.c_bool
    found.fsi_of_wheels.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p]
    found.fsi_stop_line.restype = ctypes.c_size_t
    found.fsi_stop_line.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_char_p, ctypes.c_int]
    found.fs_cause_name.restype = ctypes.c_char_p
    return found


def drawn() -> Iterator[random.Random]:
    seed = os.environ.get("FAILSTOP_SEED", "1")
    for number in range(ROUNDS):
        yield random.Random(f"{seed} {number}")


def test_a_cell_of_c_is_that_of_python_byte_for_byte(c: ctypes.CDLL) -> None:
    for draw in drawn():
        payload, seq, t_ns = (
            draw.randbytes(draw.choice((0, 1, 7, 8, 49, 512))),
            draw.getrandbits(63) + 1,
            draw.getrandbits(64),
        )
        seed = cell.seed(name := f"client.{draw.randrange(8)}.command", run := draw.getrandbits(64))
        assert c.fsi_seed(name.encode(), run) == seed
        size = c.fsi_build(SPACE, seq, t_ns, payload, len(payload), seed)
        assert SPACE.raw[:size] == cell.build(seq, t_ns, payload, seed, 512)
        assert cell.check(SPACE.raw[:size], seed) == (seq, t_ns, payload)


def test_c_believes_the_same_cells_as_python_whole_cut_and_damaged(c: ctypes.CDLL) -> None:
    entry = Entry()
    for draw in drawn():
        seed = draw.getrandbits(32)
        raw = bytearray(
            cell.build(draw.getrandbits(40) + 1, draw.getrandbits(64), draw.randbytes(draw.randrange(90)), seed, 90)
        )
        raw += bytes(draw.choice((0, 1, 40)))
        for _ in range(draw.choice((0, 0, 1, 3))):
            raw[draw.randrange(len(raw))] = draw.getrandbits(8)
        given = bytes(raw[: draw.choice((len(raw), len(raw), draw.randrange(len(raw) + 1)))])
        wanted = cell.check(given, seed)
        assert c.fsi_check(given, len(given), seed, ctypes.byref(entry)) == (wanted is not None)
        if wanted:
            where = ctypes.string_at(entry.data, entry.size)
            assert (entry.seq, entry.t_ns, where) == wanted


def test_of_two_cells_c_takes_the_one_that_python_takes(c: ctypes.CDLL) -> None:
    entry, size = Entry(), cell.cell_bytes(40)
    for draw in drawn():
        seed, both = draw.getrandbits(32), b""
        for _ in range(2):
            made = cell.build(draw.randrange(1, 5), 7, draw.randbytes(draw.randrange(41)), seed, 40).ljust(size, b"\0")
            both += draw.choice((made, made, bytes(size), draw.randbytes(size), made[:30] + draw.randbytes(size - 30)))
        one, other = cell.check(both[:size], seed), cell.check(both[size:], seed)
        wanted = {found for found in (one, other) if found}
        newest = max((found[0] for found in wanted), default=0)
        assert c.fsi_newest(both, size, seed, ctypes.byref(entry)) == bool(wanted)
        if wanted:
            assert entry.seq == newest


def test_the_crc_is_zlib_s(c: ctypes.CDLL) -> None:
    for draw in drawn():
        data, start = draw.randbytes(draw.randrange(70)), draw.getrandbits(32)
        assert c.fsi_crc(data, ctypes.c_size_t(len(data)), ctypes.c_uint32(start)) == crc32(data, start)


def told(c: ctypes.CDLL, packed: bytes) -> str:
    text = Text(ctypes.addressof(SPACE), len(SPACE), 0)
    c.fsi_add_cause(ctypes.byref(text), packed, ctypes.c_size_t(len(packed)))
    c.fsi_end(ctypes.byref(text))
    return SPACE.value.decode("utf-8", "replace")


def arguments(draw: random.Random, kind: Kind) -> list[Value]:
    """Arguments for a cause, empty ones and zeros among them."""
    texts: tuple[Value, ...] = ("", "gate", "two words", "\u00e4\u20ac", "x" * 30)
    numbers: tuple[Value, ...] = (0, 1, 250, 40321, 2**31) if ":04X" in kind.template else (0, 1, -3, 250, 40321, 2**31)
    floats: tuple[Value, ...] = (0.0, 0.05, -1.5, 12.345, 1e-05, 3.0e10)
    return [draw.choice(texts if of is str else numbers if of is int else floats) for _, of in kind.parameters]


@pytest.mark.parametrize("kind", causes.BY_NUMBER.values(), ids=lambda kind: kind.name)
def test_a_cause_has_the_text_that_python_gives_it(c: ctypes.CDLL, kind: Kind) -> None:
    draw = random.Random(kind.name)
    assert c.fs_cause_name(kind.number).decode() == kind.name
    for _ in range(200):
        cause = kind(*arguments(draw, kind))
        packed = cause.pack()
        assert c.fsi_cause_number(packed, ctypes.c_size_t(len(packed))) == kind.number
        assert told(c, packed) == str(causes.read(packed))


def test_a_damaged_cause_is_a_stop_all_the_same(c: ctypes.CDLL) -> None:
    for packed in (b"", b"\x01", b"\xff\xff", b"\x02\0gate\x1fsoon", b"\x17\0much"):
        assert c.fsi_cause_number(packed, ctypes.c_size_t(len(packed))) == causes.UNKNOWN.number
        assert told(c, packed) == str(causes.read(packed)) == "stopped by the supervisor"


def test_a_stop_s_line_is_what_python_sends(c: ctypes.CDLL) -> None:
    pieces = ("a", "hand near wheel", " ", "  ", "\n", "\t", "\u00e4", "\u20ac", "\U0001f916", "x" * 100, "\u00e9" * 90)
    for draw in drawn():
        why = "".join(draw.choices(pieces, k=draw.randrange(8)))
        who = "".join(draw.choices(pieces, k=draw.randrange(1, 4))).strip() or "me"
        pid = draw.randrange(1, 4_000_000)
        size = c.fsi_stop_line(SPACE, why.encode(), who.encode(), pid)
        assert SPACE.raw[:size] == records.asking(why, who, pid)


def test_a_stop_s_reason_may_be_any_bytes(c: ctypes.CDLL) -> None:
    for draw in drawn():
        why = bytes(byte or 1 for byte in draw.randbytes(draw.randrange(400)))
        size = c.fsi_stop_line(SPACE, why, b"driver", 7)
        line = SPACE.raw[:size]
        assert len(line) <= records.ASKED_BYTES + records.WHO_BYTES + 32
        line.decode()
        assert line.count(b"\t") == 2
        assert line.endswith(b"\tdriver\t7\n")


def test_a_number_is_written_as_python_does(c: ctypes.CDLL) -> None:
    given = [0.0, 1.0, 20.0, 0.08, 1e-05, 1e-4, 1e15, 1e16, 1.5e300, -2.5, 0.1 + 0.2]
    c.fsi_add_number.argtypes = [ctypes.c_void_p, ctypes.c_double]
    for number in (*given, *(draw.uniform(-1e3, 1e3) for draw in drawn())):
        text = Text(ctypes.addressof(SPACE), len(SPACE), 0)
        c.fsi_add_number(ctypes.byref(text), number)
        c.fsi_end(ctypes.byref(text))
        assert SPACE.value.decode() == repr(number)


def bases() -> Iterator[Settings]:
    """Bases of every layout that each board drives, with drawn sizes, signs and ids."""
    draw = random.Random(3)
    for board, name in itertools.product(BOARDS, LAYOUTS):
        for _ in range(8):
            one = (board, name) == ("vesc", "ackermann")
            signs = {f"wheels.sign_{number}": draw.choice((1, -1)) for number in ((1,) if one else (1, 2))}
            has = ("diameter", "lever") if name == "omni3" else ("diameter", "wheelbase", "track")
            sizes = {f"wheels.{size}_m": draw.uniform(0.05, 0.9) for size in has}
            with contextlib.suppress(SettingError):
                yield Settings({"board.kind": board, "wheels.layout": name, **sizes, **signs})


def test_wheel_speeds_are_the_same_velocity_as_in_python(c: ctypes.CDLL) -> None:
    tried = set()
    draw = random.Random(5)
    for settings in bases():
        packed = msgpack.packb(settings.flat())
        wheels = Wheels()
        assert c.fsi_wheels(ctypes.byref(wheels), packed, ctypes.c_size_t(len(packed)))
        mounted, base = mounted_wheels(settings.flat()), kinematics.from_settings(settings)
        assert (wheels.count, wheels.known, wheels.steered) == (
            len(mounted),
            True,
            isinstance(base, kinematics.Steered),
        )
        tried.add((settings.text("wheels.layout"), wheels.count))
        for _ in range(50):
            speeds = [draw.uniform(-20, 20) for _ in mounted]
            steering = draw.choice((None, draw.uniform(-1, 1))) if wheels.steered else None
            given, velocity = (ctypes.c_double * 4)(*speeds), (ctypes.c_double * 3)()
            c.fsi_of_wheels(ctypes.byref(wheels), given, math.nan if steering is None else steering, velocity)
            wanted = kinematics.of_wheels(base, mounted, speeds, steering)
            assert list(velocity) == pytest.approx(wanted, rel=1e-12, abs=1e-12)
    assert tried == {(name, count) for name, counts in LAYOUTS.items() for count in counts}


def test_a_wheel_whose_number_is_no_number_is_refused(c: ctypes.CDLL) -> None:
    for number in (math.nan, -1, 5, 1e300):
        packed = msgpack.packb({**Settings({}).flat(), "wheels.id_1": number})
        assert not c.fsi_wheels(ctypes.byref(Wheels()), packed, ctypes.c_size_t(len(packed)))


def test_the_client_s_hash_changes_with_what_the_library_reads() -> None:
    """It has the place, the size and the form of each record of OF_LIBRARY."""
    text = layout._OF_LIBRARY
    for name, used in layout.OF_LIBRARY.items():
        spec = layout.SEGMENT_BY_NAME[name]
        for record, shape in used.items():
            line = next(line for line in text.splitlines() if line.split()[0] == name and line.split()[2] == record)
            declared = spec.records[record]
            assert line.split()[3:6] == [str(declared.capacity), str(declared.cells), str(spec.offsets[record])]
            if shape:
                assert line.endswith(shape.form)
                assert struct.calcsize(shape.form) <= declared.capacity
