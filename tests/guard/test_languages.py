"""Whatever a driver or a board writes, no language of a board raises: the guard would end under a driving driver.

The pieces are whole: right checks, lengths and JSON, so that they come further than noise does. What is odd is in
them."""

from __future__ import annotations

import itertools
import random
import struct
from binascii import crc_hqx
from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

from failstop.board.driver import DriverAnswer, DriverFrame, DriverMotion, DriverRefusal, language_of
from failstop.board.feetech import codec as feetech
from failstop.board.rrc import framing
from failstop.guard.talk import Talk
from failstop.policy.layouts import BOARDS
from failstop.policy.settings import Settings
from tests.support.amounts import amount

if TYPE_CHECKING:
    from failstop.board.driver import DriverLanguage

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


def codec_frame(steer: int, speed: int) -> bytes:
    return struct.pack("<HhhH", 0xABCD, steer, speed, 0xABCD ^ steer ^ speed)


def vesc_packet(payload: bytes) -> bytes:
    return bytes((2, len(payload))) + payload + crc_hqx(payload, 0).to_bytes(2, "big") + b"\3"


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
    resumed = language_of(kind, flat)
    assert resumed
    resumed.resume(language)
    assert all(isinstance(data, bytes) for chunk in said for data in resumed.heard(chunk, len(written)))
    resumed.wrote(written[-1], len(written))
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


# A language that goes on where another one was: after the service has restarted, or after another program has closed
# the port.

ALL_WHEELS = {
    "arduino": b"m 20 30\r",
    "damiao": b"t20140000803F\rt20240000803F\r",
    "feetech": b"".join(feetech.packet(wheel, feetech.WRITE, bytes((46, 44, 1))) for wheel in feetech.WHEELS),
    "hoverboard": codec_frame(0, 100),
    "rrc": framing.seal(3, struct.pack("<BB", 1, 4) + b"".join(struct.pack("<Bf", motor, 0.5) for motor in range(4))),
    "ugv": b'{"T":1,"L":0.1,"R":0.1}\n',
    "vesc": vesc_packet(b"\x08\0\0\3\xe8") + vesc_packet(b"\x22\1\x08\0\0\3\xe8"),
}
"""What gives every wheel a speed."""
ONE_WHEEL = {
    "damiao": b"t20140000803F\r",
    "feetech": feetech.packet(7, feetech.WRITE, bytes((46, 44, 1))),
    "rrc": framing.seal(3, struct.pack("<BBBf", 1, 1, 0, 0.5)),
    "vesc": vesc_packet(b"\x08\0\0\3\xe8"),
}
"""What gives one wheel a speed, for the boards where the others then keep theirs."""
SET_UP = {
    "arduino": [b"r\r"],
    "damiao": [b"C\r", b"t0018FFFFFFFFFFFFFFFD\r", b"t201400\r", b"t7FF8010055 0A01000000\r".replace(b" ", b"")],
    "feetech": [feetech.packet(7, feetech.WRITE, b"\x28\0"), feetech.packet(8, feetech.WRITE, b"\x37\0")],
    "hoverboard": [b""],
    "rrc": [b""],
    "ugv": [b'{"T":131,"cmd":0}\n', b'{"T":142,"cmd":500}\n'],
    "vesc": [vesc_packet(b"\x0c\1\x90")],
}
"""What a driver sets up once, and does not repeat."""
READS = {
    "arduino": b"e\r",
    "damiao": b"t7FF80100CC0000000000\r",
    "feetech": feetech.packet(7, feetech.READ, b"\x28\2") + feetech.packet(8, feetech.READ, b"\x37\1"),
    "rrc": framing.seal(5, b"\5\1"),
    "ugv": b'{"T":130}\n',
}


def made(kind: str, settings: dict[str, object]) -> DriverLanguage:
    language = language_of(kind, Settings({"board.kind": kind, **settings}).flat())
    assert language
    return language


def continued(kind: str, settings: dict[str, object], before: DriverLanguage) -> DriverLanguage:
    language = made(kind, settings)
    language.resume(before)
    return language


def shown(language: DriverLanguage, chunk: bytes) -> list[object]:
    return [(type(row), {key: getattr(row, key) for key in row.__annotations__}) for row in language.wrote(chunk, 1)]


EVERY = [*((kind, {}) for kind in PIECES), ("vesc", CAR)]


@pytest.mark.parametrize(("kind", "settings"), EVERY)
def test_what_a_driver_has_set_up_holds_in_the_next_conversation(kind: str, settings: dict[str, object]) -> None:
    for set_up in SET_UP[kind]:
        before = made(kind, settings)
        random_ = random.Random(3)
        for _ in range(50):
            before.heard(PIECES[kind](random_), 0)
        before.heard(b"5000 -300\r\n5010 -310\r\n" if kind == "arduino" else b"", 0)
        before.wrote(set_up, 0)
        after = continued(kind, settings, before)
        for chunk in (READS.get(kind, b""), ALL_WHEELS[kind]):
            assert shown(after, chunk) == shown(before, chunk), set_up
        if kind == "ugv":
            report = b'{"T":1001,"L":0,"R":0}\r\n'
            assert [after.heard(report, at) for at in (0, 1)] == [before.heard(report, at) for at in (0, 1)], set_up


@pytest.mark.parametrize(("kind", "settings"), EVERY)
def test_a_frame_that_is_cut_by_a_new_conversation_is_whole(kind: str, settings: dict[str, object]) -> None:
    whole = ONE_WHEEL.get(kind, ALL_WHEELS[kind])
    for cut in range(1, len(whole)):
        before = made(kind, settings)
        before.wrote(whole[:cut], 1)
        after = continued(kind, settings, before)
        assert shown(after, whole[cut:]) == shown(before, whole[cut:]), "both go on by themselves"
        assert shown(after, whole) == shown(before, whole)


@pytest.mark.parametrize("kind", ONE_WHEEL)
def test_no_speed_is_taken_over_into_the_next_conversation(kind: str) -> None:
    before = made(kind, {})
    before.wrote(ALL_WHEELS[kind], 1)
    after = continued(kind, {}, before)
    *_, speeds = [row.speeds for row in after.wrote(ONE_WHEEL[kind], 1) if isinstance(row, DriverMotion)]
    assert [bool(speed) for speed in speeds].count(True) == 1, speeds


@pytest.mark.parametrize(
    ("was", "becomes", "speeds"),
    [("mecanum", "differential", (1.0, 0.0)), ("differential", "mecanum", (1.0, 0.0, 0.0, 0.0))],
)
def test_a_motor_stays_disabled_when_the_service_comes_back_with_other_wheels(
    was: str, becomes: str, speeds: tuple[float, ...]
) -> None:
    before = made("damiao", {"wheels.layout": was})
    before.wrote(b"t0028FFFFFFFFFFFFFFFD\r", 0)
    after = continued("damiao", {"wheels.layout": becomes}, before)
    found = [tuple(row.speeds) for row in after.wrote(ALL_WHEELS["damiao"], 1) if isinstance(row, DriverMotion)]
    assert found == [speeds]
