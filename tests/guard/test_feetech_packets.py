"""What a driver of Feetech's servos may write, held against the simulated servos, and what it reads of them."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

import pytest

from failstop.board.driver import DriverAnswer, DriverMotion, DriverRefusal, language_of
from failstop_lab.boards.feetech import Bus
from tests.support.amounts import amount

from .damage import damaged, judged

if TYPE_CHECKING:
    from failstop.board.driver import DriverLanguage

MS = 1_000_000
BYTE_NS = 10_000
WHEELS = (7, 8, 9)
ARM = (1, 2, 3, 4, 5, 6)
DRIVE = bytes.fromhex("fffffe0d832e02076984080000096904cf")
"""As LeKiwi's host: wheel 7 at -1129, wheel 9 at 1129 steps a second."""
SETTINGS: dict[str, float | str] = {
    f"joints.j{servo}.{key}": value
    for servo in ARM
    for key, value in (("servo", servo), ("low", 700 + servo), ("high", 3400 - servo), ("offset", -20 * servo))
}


def packet(to: int, kind: int, *data: int) -> bytes:
    body = bytes((to, len(data) + 2, kind, *data))
    return b"\xff\xff" + body + bytes((~sum(body) & 0xFF,))


def write(servo: int, address: int, *data: int) -> bytes:
    return packet(servo, 0x03, address, *data)


def read(servo: int, address: int, size: int) -> bytes:
    return packet(servo, 0x02, address, size)


def sync_write(address: int, size: int, *rows: tuple[int, ...]) -> bytes:
    return packet(0xFE, 0x83, address, size, *(value for row in rows for value in row))


def made() -> DriverLanguage:
    language = language_of("feetech", SETTINGS)
    assert language
    return language


def motions(chunk: bytes) -> list[tuple[float, ...]]:
    return [tuple(row.speeds) for row in made().wrote(chunk, 0) if isinstance(row, DriverMotion)]


def refusals(chunk: bytes) -> list[str]:
    return [row.what for row in made().wrote(chunk, 0) if isinstance(row, DriverRefusal)]


def answers(language: DriverLanguage, chunk: bytes) -> list[bytes]:
    return [row.data for row in language.wrote(chunk, 0) if isinstance(row, DriverAnswer)]


def commanded(chunk: bytes) -> list[tuple[float, ...]]:
    """The wheels' goals after each packet that writes one, on a bus where nothing else is said."""
    bus = Bus()
    bus.silent = set(range(1, 10))
    for at, value in enumerate(chunk):
        bus.byte(at * BYTE_NS, value)
    return [speeds for _, speeds in bus.commands]


def said(servo: int, memory: bytes) -> bytes:
    """A servo's answer with this part of its memory."""
    return packet(servo, 0, *memory)


def tell(language: DriverLanguage) -> None:
    """All that failstop's own questions bring."""
    for servo in WHEELS:
        memory = bytes((*bytes(12), servo, 0x80, 50, 0, 118, 31))  # 46 to 63, the speed at 58
        assert language.heard(said(servo, memory), 0) == []
    for servo in ARM:
        assert language.heard(said(servo, bytes((servo, 8, 0, 0, 0, 0, 118, 31))), 0) == []


@pytest.mark.parametrize(
    "chunk",
    [
        DRIVE,
        sync_write(46, 2, (7, 100, 0), (8, 200, 0x80), (9, 0, 0)),
        sync_write(46, 2, (9, 100, 0)) + sync_write(46, 2, (7, 50, 0)),  # the others keep their speed
        write(8, 46, 0x2C, 0x01),
        write(7, 41, 254, 0, 0, 0, 0, 100, 0),  # the vendor's WriteSpec
        b"\x00\xff" + write(9, 46, 1, 0),
        b"\xff" * 5 + DRIVE[2:],
        write(254, 46, 0, 0),
    ],
)
def test_each_packet_that_drives_is_taken(chunk: bytes) -> None:
    assert motions(chunk) == commanded(chunk)
    assert motions(chunk)


def test_packets_may_come_split_and_glued() -> None:
    text = DRIVE + write(7, 46, 0, 0) + sync_write(46, 2, (7, 1, 0), (8, 2, 0), (9, 3, 0))
    for cut in range(len(text)):
        language = made()
        rows = language.wrote(text[:cut], 0) + language.wrote(text[cut:], 0)
        assert [tuple(row.speeds) for row in rows if isinstance(row, DriverMotion)] == [
            (-1129, 0, 1129),
            (0, 0, 1129),
            (1, 2, 3),
        ]


@pytest.mark.parametrize(
    ("chunk", "what"),
    [
        (write(7, 42, 0, 8), "a wheel's position, PWM or mode (33, 42 to 45)"),
        (write(8, 44, 100, 0), "a wheel's position, PWM or mode (33, 42 to 45)"),
        (write(8, 33, 0), "a wheel's position, PWM or mode (33, 42 to 45)"),
        (sync_write(33, 1, (7, 3)), "a wheel's position, PWM or mode (33, 42 to 45)"),
        (write(9, 41, 254, 0, 8, 0, 0, 100, 0), "a wheel's position, PWM or mode (33, 42 to 45)"),
        (write(7, 46, 100), "half of a wheel's speed (46 or 47)"),
        (write(254, 46, 100, 0), "a write to every servo (address 46)"),
        (write(254, 40, 0), "a write to every servo (address 40)"),
    ],
)
def test_what_would_turn_a_wheel_without_a_speed_stops_all_of_them(chunk: bytes, what: str) -> None:
    language = made()
    language.wrote(DRIVE, 0)
    rows = language.wrote(chunk, 0)
    assert what in [row.what for row in rows if isinstance(row, DriverRefusal)]
    assert [tuple(row.speeds) for row in rows if isinstance(row, DriverMotion)] == [(0, 0, 0)]


def test_a_wheel_without_torque_turns_at_no_speed() -> None:
    off, on = write(7, 40, 0), write(7, 40, 1)
    assert motions(DRIVE + off) == [(-1129, 0, 1129), (0, 0, 0)]
    assert motions(off + DRIVE + on) == [(0, 0, 0), (0, 0, 1129)]
    assert motions(off + on + DRIVE) == [(0, 0, 0), (-1129, 0, 1129)]


@pytest.mark.parametrize(
    ("chunk", "what"),
    [
        (write(3, 42, 0, 8), "moving the arm (42 to 49)"),
        (sync_write(42, 2, *((servo, 0, 8) for servo in ARM)), "moving the arm (42 to 49)"),
        (write(3, 46, 100, 0), "moving the arm (42 to 49)"),
        (write(3, 40, 0), "torque of the arm (40)"),
        (write(3, 40, 128), "a setting of a servo (address 40)"),
        (write(7, 5, 12), "a setting of a servo (address 5)"),
        (write(1, 31, 5, 0), "a setting of a servo (address 31)"),
        (write(7, 21, 30), "a setting of a servo (address 21)"),
        (packet(7, 0x04, 46, 100, 0), "the instruction 0x04"),
        (packet(7, 0x06), "the instruction 0x06"),
        (DRIVE[:-1] + b"\0", "a packet with a wrong check"),
        (read(12, 3, 2), "servo 12"),
    ],
)
def test_what_is_refused_is_named_and_moves_nothing(chunk: bytes, what: str) -> None:
    assert what in refusals(chunk)
    assert motions(chunk) == []
    if chunk[2] in (*WHEELS, *ARM) and chunk[4] == 0x03:
        assert answers(made(), chunk) == [packet(chunk[2], 0)], "LeRobot's host ends when a write is not answered"


def test_the_wheels_drive_while_the_arm_in_the_same_packet_is_refused() -> None:
    chunk = sync_write(46, 2, (7, 10, 0), (3, 10, 0))
    assert motions(chunk) == [(10, 0, 0)]
    assert set(refusals(chunk)) == {"moving the arm (42 to 49)"}


def test_lekiwi_s_connect() -> None:
    """LeRobot 0.4.4's, exchange by exchange: each has one answer, and no write is refused but those to the arm's
    torque."""
    language = made()
    for servo in (*ARM, *WHEELS):
        assert answers(language, packet(servo, 0x01)) == [packet(servo, 0)]
        assert answers(language, read(servo, 3, 2)) == [said(servo, b"\x09\x03")]
        assert [answers(language, read(servo, at, 1)) for at in (0, 1)] == [
            [said(servo, b"\x03")],
            [said(servo, b"\n")],
        ]
    for servo in (*ARM, *WHEELS):
        low, high, offset = (700 + servo, 3400 - servo, 0x800 + 20 * servo) if servo in ARM else (0, 4095, 0)
        for at, value in ((9, low), (11, high), (31, offset)):
            assert answers(language, read(servo, at, 2)) == [said(servo, value.to_bytes(2, "little"))]
    configure = [
        write(servo, at, value)
        for servo in (*ARM, *WHEELS)
        for at, value in (
            *((40, 0), (55, 0), (7, 0), (85, 254), (41, 254)),
            *(((33, 0), (21, 16), (23, 0), (22, 32)) if servo in ARM else ((33, 1),)),
            *((40, 1), (55, 1)),
        )
    ]
    for chunk in configure:
        rows = language.wrote(chunk, 0)
        assert [row.data for row in rows if isinstance(row, DriverAnswer)] == [packet(chunk[2], 0)]
        assert not any(any(row.speeds) for row in rows if isinstance(row, DriverMotion))
        refused = [row.what for row in rows if isinstance(row, DriverRefusal)]
        assert refused == (["torque of the arm (40)"] if chunk[2] in ARM and chunk[5] == 40 else [])
    tell(language)
    positions = answers(language, bytes.fromhex("fffffe0a82380201020304050626"))
    assert positions == [b"".join(said(servo, bytes((servo, 8))) for servo in ARM)]
    speeds = answers(language, bytes.fromhex("fffffe07823a0207080924"))
    assert speeds == [b"".join(said(servo, bytes((servo, 0x80))) for servo in WHEELS)]
    assert [tuple(row.speeds) for row in language.wrote(DRIVE, 0) if isinstance(row, DriverMotion)] == [
        (-1129, 0, 1129)
    ]


def test_a_sync_read_is_answered_in_the_order_asked() -> None:
    language = made()
    tell(language)
    order = (9, 3, 7)
    assert answers(language, packet(0xFE, 0x82, 62, 1, *order)) == [b"".join(said(servo, b"\x76") for servo in order)]


def test_what_no_servo_has_said_yet_is_not_answered() -> None:
    language = made()
    assert answers(language, read(7, 58, 2) + read(1, 56, 2)) == []
    tell(language)
    assert len(answers(language, read(7, 58, 2) + read(1, 56, 2))) == 2


def test_a_servo_s_own_error_is_passed_on() -> None:
    language = made()
    language.heard(packet(7, 0x20, *bytes(18)), 0)
    assert answers(language, write(7, 46, 0, 0)) == [packet(7, 0x20)]
    assert answers(language, read(7, 58, 2)) == [packet(7, 0x20, 0, 0)]


def test_a_servo_that_the_settings_do_not_name_is_not_there() -> None:
    language = language_of("feetech", {})
    assert language
    assert answers(language, packet(1, 0x01) + packet(7, 0x01)) == [packet(7, 0)]


def test_answers_to_failstop_s_questions_may_come_split_and_garbled() -> None:
    language = made()
    text = b"\xff\xff\x07" + said(7, bytes(18)) + said(8, bytes(18))[:-1] + b"\0" + said(9, bytes(19))
    for value in text:
        assert language.heard(bytes((value,)), 0) == []
    asked = packet(0xFE, 0x82, 58, 2, *WHEELS)
    assert answers(language, asked) == [said(7, b"\0\0") + said(9, b"\0\0")]


def mutated(random_: random.Random) -> bytes:
    def speed() -> tuple[int, int]:
        return random_.randrange(256), random_.choice((0, 1, 4, 0x80, 0x84))

    def one() -> bytes:
        return random_.choice(
            (
                DRIVE,
                sync_write(46, 2, *((wheel, *speed()) for wheel in WHEELS)),
                write(random_.choice(WHEELS), 46, *speed()),
                write(random_.choice(WHEELS), 41, 254, 0, 0, 0, 0, *speed()),
                write(random_.choice(WHEELS), random_.choice((40, 33, 42, 47)), random_.randrange(3)),
                sync_write(46, 2, (random_.choice((*ARM, *WHEELS)), *speed())),
                read(7, 58, 2),
                write(254, 46, *speed()),
            )
        )

    return damaged(random_, one, (0xFF, 0xFE, 0x2E), b"\xff\xfe\x03\x07\x2e\x00", 12)


@pytest.mark.claim("GUARD-1")
def test_nothing_moves_that_the_servos_themselves_would_not_move() -> None:
    """After each packet each wheel has the speed that the servos have, or none."""
    random_ = random.Random(59)
    moved = 0
    for _ in range(amount(10_000, 1_000_000)):
        moved += judged(mutated(random_), motions, commanded)
    assert moved > 5_000
