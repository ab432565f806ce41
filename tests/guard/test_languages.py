"""Whatever a driver or a board writes, no language of a board raises: the guard would end under a driving driver.

The pieces are whole: right checks, lengths and JSON, so that they come further than noise does. What is odd is in
them."""

from __future__ import annotations

import itertools
import random
import struct
from binascii import crc_hqx
from collections.abc import Callable

import pytest

from failstop.board.driver import DriverAnswer, DriverFrame, DriverMotion, DriverRefusal, language_of
from failstop.board.feetech import codec as feetech
from failstop.board.rrc import framing
from failstop.guard.talk import Talk
from failstop.policy.layouts import BOARDS
from failstop.policy.settings import Settings
from tests.support.amounts import amount

Piece = Callable[[random.Random], bytes]

VALUES = ("1", "-0.5", "1e400", "9" * 60, "true", "null", '"a"', '"0.2"', '""', "[]", '["a"]', "[[1]]", "{}", '{"a":1}')
"""A value of every type of JSON."""
KEYS = ("T", "L", "R", "X", "Y", "Z", "IO4", "SPD", "cmd", "mode", "lineNum", "Text", "other")
KINDS = ("0", "1", '"13"', "11", "126", "130", "139", "3", "-3", "132", "133", "141", "131", "142", "143", "300", "4")
"""Values of T, for each branch of a language."""


def arduino(random_: random.Random) -> bytes:
    words = [random_.choice("mobeuwrxcadpst?").encode(), *(_word(random_) for _ in range(random_.randrange(4)))]
    return b" ".join(words) + b"\r"


def _word(random_: random.Random) -> bytes:
    return random_.choice((b"0", b"-7", b"99999999999999999999", b"+", b"a", b"", b"\xff", b"13", b"\0"))


def damiao(random_: random.Random) -> bytes:
    can_id = random_.choice((1, 2, 3, 0x201, 0x202, 0x101, 0x301, 0x7FF, 0x11, 0x12, random_.randrange(0x800)))
    data = random_.choice((_noise(random_, 8), bytes((1, 0, random_.choice((0x33, 0x55, 0xAA, 0xCC)), 10)) + bytes(4)))
    data = data[: random_.choice((0, 3, 4, 7, 8, 8, 8, 8))]
    return random_.choice((b"S8\rO\r", b"C\r", b"T00000000\r", b"")) + b"t%03X%d%s\r" % (
        can_id,
        len(data),
        data.hex().encode(),
    )


def servos(random_: random.Random) -> bytes:
    address = random_.choice((0, 5, 33, 40, 42, 44, 46, 55, 56, 64, 65, 89, 250))
    data = bytes((address,)) + _noise(random_, 12)[: random_.randrange(13)]
    return feetech.packet(random_.choice((1, 7, 8, 9, 100, 254)), random_.choice((1, 2, 3, 4, 6, 0x82, 0x83)), data)


def hoverboard(random_: random.Random) -> bytes:
    size = random_.choice((8, 18, 22, 26))
    words = [0xABCD, *(random_.choice((0, 1, 0x7FFF, 0x8000, 0xFFFF, 300)) for _ in range(size // 2 - 2))]
    check = 0
    for word in words:
        check ^= word
    return struct.pack(f"<{size // 2}H", *words, check)


def rrc(random_: random.Random) -> bytes:
    data = bytes((random_.randrange(12),)) + _noise(random_, 24)[: random_.randrange(25)]
    return framing.seal(random_.choice((0, 1, 2, 3, 3, 4, 5, 6, 7, 9, 11)), data)


def ugv(random_: random.Random) -> bytes:
    fields = [f'"T":{random_.choice((*KINDS, "1001", "1002", *VALUES))}']
    fields += [f'"{random_.choice(KEYS)}":{random_.choice(VALUES)}' for _ in range(random_.randrange(4))]
    whole = random_.choice(("{%s}", "{%s}", "{%s}", "[{%s}]")) % ",".join(fields)
    return whole.encode() + b"\n"


def vesc(random_: random.Random) -> bytes:
    command = random_.choice((0, 4, 5, 6, 7, 8, 9, 10, 12, 13, 30, 34, random_.randrange(256)))
    data = _noise(random_, 4)[: random_.choice((0, 1, 2, 4, 4))] + bytes(random_.choice((0, 0, 251, 252, 400)))
    payload = random_.choice((b"", b"", b"\x22\1", b"\x22\1\x22\1")) + bytes((command,)) + data
    length = bytes((2, len(payload))) if len(payload) < 256 else b"\3" + len(payload).to_bytes(2, "big")
    return length + payload + crc_hqx(payload, 0).to_bytes(2, "big") + b"\3"


def _noise(random_: random.Random, size: int) -> bytes:
    return random_.choice((bytes(size), b"\xff" * size, random_.randbytes(size)))


PIECES: dict[str, Piece] = {
    "arduino": arduino,
    "damiao": damiao,
    "feetech": servos,
    "hoverboard": hoverboard,
    "rrc": rrc,
    "ugv": ugv,
    "vesc": vesc,
}
CAR: dict[str, object] = {"board.kind": "vesc", "wheels.layout": "ackermann"}


def held(kind: str, settings: dict[str, object], written: list[bytes], said: list[bytes]) -> None:
    """Let a driver write these chunks, and the board say those, in turn."""
    flat = Settings({"board.kind": kind, **settings}).flat()
    language = language_of(kind, flat)
    assert language
    talk = Talk(language, 2, 300_000_000, 300_000_000)
    for now_ns, (chunk, words) in enumerate(itertools.zip_longest(written, said, fillvalue=b"")):
        assert all(isinstance(data, bytes) for data in talk.heard(words, now_ns))
        assert all(isinstance(data, bytes) for data in talk.wrote(chunk, now_ns, now_ns))
        assert all(row.what.isprintable() and row.why.isprintable() for row in talk.refusals)
        talk.command(now_ns)
    talk.asked(written[0], len(written))
    talk.ended(written[-1], len(written))


def test_each_board_has_its_pieces() -> None:
    assert set(PIECES) == set(BOARDS)


@pytest.mark.parametrize(("kind", "settings"), [*((kind, {}) for kind in PIECES), ("vesc", CAR)])
def test_no_language_raises_on_bytes(kind: str, settings: dict[str, object]) -> None:
    random_, piece = random.Random(7), PIECES[kind]
    for _ in range(amount(150, 20_000)):
        written = [piece(random_) for _ in range(20)]
        if random_.randrange(4) == 0:
            damaged = bytearray(random_.choice(written))
            damaged[random_.randrange(len(damaged))] = random_.randrange(256)
            written.append(bytes(damaged))
        held(kind, settings, written, [piece(random_) for _ in range(20)])


@pytest.mark.parametrize("value", VALUES)
def test_a_board_of_json_takes_a_value_of_any_type_anywhere(value: str) -> None:
    for kind, key in itertools.product((*KINDS, "1001"), KEYS):
        line = f'{{"T":{kind},"{key}":{value}}}\n'.encode()
        held("ugv", {}, [line], [line])


def test_rows_are_of_the_four_kinds() -> None:
    random_ = random.Random(8)
    for kind, piece in PIECES.items():
        language = language_of(kind, Settings({"board.kind": kind}).flat())
        assert language
        rows = [row for _ in range(200) for row in language.wrote(piece(random_), 0)]
        found = {type(row) for row in rows}
        assert found <= {DriverMotion, DriverAnswer, DriverFrame, DriverRefusal}
        assert {DriverMotion, DriverRefusal} <= found, f"the pieces of {kind} reach too little: {found}"
