"""What a driver of Hiwonder's RRC may write, held against the board's own receiver and motor handler."""

from __future__ import annotations

import random
import struct
from typing import TYPE_CHECKING

import pytest

from failstop.board.driver import DriverAnswer, DriverFrame, DriverMotion, DriverRefusal, language_of
from failstop_lab.sim.motors import Motors
from failstop_lab.sim.receiver import Receiver
from tests.support.amounts import amount

from .damage import damaged, judged

if TYPE_CHECKING:
    from failstop.board.driver import DriverLanguage

MOTOR = 3
NODE_OFFSET = bytes.fromhex("aa55040307010029")
NODE_REST = bytes.fromhex("aa5503160104000000000001000000000200000000030000000007")


def crc(data: bytes) -> int:
    value = 0
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ 0x8C if value & 1 else value >> 1
    return value


def frame(func: int, *data: int) -> bytes:
    body = bytes((func, len(data), *data))
    return b"\xaa\x55" + body + bytes((crc(body),))


def speeds(*told: tuple[int, float]) -> bytes:
    """As the SDK's set_motor_speed."""
    return frame(MOTOR, 1, len(told), *b"".join(struct.pack("<Bf", *each) for each in told))


def made() -> DriverLanguage:
    language = language_of("rrc", {})
    assert language
    return language


def motions(chunk: bytes) -> list[tuple[float, ...]]:
    return [tuple(row.speeds) for row in made().wrote(chunk, 0) if isinstance(row, DriverMotion)]


def refusals(chunk: bytes) -> list[str]:
    return [row.what for row in made().wrote(chunk, 0) if isinstance(row, DriverRefusal)]


def answers(language: DriverLanguage, chunk: bytes) -> list[bytes]:
    return [row.data for row in language.wrote(chunk, 0) if isinstance(row, DriverAnswer)]


def commanded(chunk: bytes) -> list[tuple[float, ...]]:
    """The speeds that the board has after each motor frame that it finds in these bytes."""
    motors = Motors()
    return [motors.execute(data) for _, func, data in Receiver().feed(chunk) if func == MOTOR and data]


@pytest.mark.parametrize(
    "chunk",
    [
        NODE_REST,
        speeds((0, 0.5), (1, -0.5), (2, 0.25), (3, -0.25)),
        speeds((0, 0.5), (1, -0.5), (2, 0.25), (3, -0.25)) + speeds((2, 1.0)),  # the others keep their speed
        frame(MOTOR, 0, 3, *struct.pack("<f", 1.5)),
        speeds((1, 1.0), (3, 1.0)) + frame(MOTOR, 2, 1),
        speeds((1, 1.0), (3, 1.0), (0, 2.0)) + frame(MOTOR, 3, 0b1001),
        b"\xaa" + speeds((0, 1.0)) + speeds((1, 1.0)),
        b"noise" + speeds((0, 1.0)),
    ],
)
def test_each_frame_that_the_board_takes_is_taken(chunk: bytes) -> None:
    own = commanded(chunk)
    assert own
    assert [found for found in motions(chunk) if any(found)] == [found for found in own if any(found)]
    assert motions(chunk)[-1] == own[-1]


def test_frames_may_come_split_and_glued() -> None:
    text = speeds((0, 0.5), (1, 0.5)) + NODE_REST + frame(MOTOR, 0, 3, *struct.pack("<f", 1.5))
    for cut in range(len(text)):
        language = made()
        rows = language.wrote(text[:cut], 0) + language.wrote(text[cut:], 0)
        found = [tuple(row.speeds) for row in rows if isinstance(row, DriverMotion)]
        assert found == [(0.5, 0.5, 0, 0), (0, 0, 0, 0), (0, 0, 0, 1.5)]


@pytest.mark.parametrize(
    ("chunk", "what"),
    [
        (speeds((0, float("nan"))), "a speed that is not a number"),
        (speeds((0, 1.0), (1, float("-inf"))), "a speed that is not a number"),
        (speeds((4, 1.0)), "motor 5"),
        (frame(MOTOR, 2, 200), "motor 201"),
        (frame(MOTOR, 1, 3, *struct.pack("<Bf", 0, 1.0)), "a motor frame that does not fit its length"),
        (frame(MOTOR, 1, 1, *struct.pack("<BfB", 0, 1.0, 9)), "a motor frame that does not fit its length"),
        (frame(MOTOR, 0, 1, 0), "a motor frame that does not fit its length"),
        (frame(MOTOR, 9, 1), "a motor frame that does not fit its length"),
        (frame(MOTOR), "a motor frame that does not fit its length"),
        (frame(MOTOR, 5, 1, *struct.pack("<Bf", 0, 50.0)), "a duty cycle (set_motor_duty)"),
        (speeds((0, 1.0))[:-1] + b"\0", "a frame with a wrong check"),
        (b"m 10 10\r", "bytes that are not a frame"),
    ],
)
def test_what_is_no_motion_is_refused_whole_and_stops_the_wheels(chunk: bytes, what: str) -> None:
    language = made()
    language.wrote(speeds((0, 1.0), (1, 1.0)), 0)
    rows = language.wrote(chunk, 0)
    assert [row.what for row in rows if isinstance(row, DriverRefusal)] == [what]
    assert [tuple(row.speeds) for row in rows if isinstance(row, DriverMotion)] == [(0, 0, 0, 0)]


@pytest.mark.parametrize(
    ("chunk", "what"),
    [
        (frame(MOTOR, 5, 1), "the type of the motors (3, 5)"),
        (frame(1, 1, 100, 0, 100, 0, 1, 0), "an LED (1)"),
        (frame(2, 0x6C, 7, 100), "the buzzer (2)"),
        (frame(11, 1, 0, 255, 0, 0), "RGB lights (11)"),
        (frame(0, 1, 1), "a setting of the board (0)"),
        (frame(4, 1, 20, 0, 1, 1, 220, 5), "moving a PWM servo (4, 01)"),
        (frame(4, 7, 1, 5), "the offset of a PWM servo (4, 07)"),
        (frame(5, 1, 20, 0, 1, 9, 244, 1), "moving a bus servo (5, 01)"),
        (frame(5, 0x0B, 1), "moving a bus servo (5, 0B)"),
        (frame(5, 0x10, 1, 2), "a setting of a bus servo (5, 10)"),
        (frame(5), "moving a bus servo (5, 00)"),
        (frame(7), "a frame of function 7"),
    ],
)
def test_what_is_refused_is_named_and_moves_nothing(chunk: bytes, what: str) -> None:
    assert refusals(chunk) == [what]
    assert motions(chunk) == []
    assert answers(made(), chunk) == []


@pytest.mark.parametrize("chunk", [frame(MOTOR, 1, 0), frame(MOTOR, 3, 0), frame(MOTOR, 3, 0xF0)])
def test_a_motor_frame_that_names_no_motor_renews_no_speed(chunk: bytes) -> None:
    language = made()
    language.wrote(speeds((0, 1.0)), 0)
    assert language.wrote(chunk, 0) == []
    assert commanded(speeds((0, 1.0)) + chunk) == [(1.0, 0, 0, 0)] * 2, "nor does it change one on the board"


def test_the_buzzer_s_tones_are_passed_on() -> None:
    tone = frame(2, 0x6C, 7, 100, 0, 100, 0, 1, 0)
    [row] = made().wrote(tone, 0)
    assert isinstance(row, DriverFrame)
    assert row.data == tone


def test_the_vendor_s_node_starts_without_a_refusal() -> None:
    assert refusals(NODE_OFFSET + NODE_REST) == []
    assert motions(NODE_OFFSET + NODE_REST) == [(0, 0, 0, 0)]


@pytest.mark.parametrize(
    ("kind", "form"),
    [
        *((0x05, "<BBbh"), (0x07, "<BBbH"), (0x09, "<BBbB"), (0x0D, "<BBbb"), (0x12, "<BBbB"), (0x22, "<BBbb")),
        *((0x32, "<BBb2H"), (0x36, "<BBb2H"), (0x3A, "<BBbB")),
    ],
)
def test_a_bus_servo_s_question_fails_at_once_with_an_answer_of_the_sdk_s_form(kind: int, form: str) -> None:
    """The SDK waits for it forever, and unpacks it by this form."""
    [answer] = answers(made(), frame(5, kind, 9))
    assert answer == frame(5, *answer[4:-1])
    servo, asked, success, *_ = struct.unpack(form, answer[4:-1])
    assert (servo, asked, success) == (9, kind, -1)


def test_a_question_that_failstop_has_asked_too_has_the_board_s_answer() -> None:
    language = made()
    bus, pwm = frame(5, 9, 5, 0, 0xF4, 1), frame(4, 2, 5, 0xDC, 5)
    assert language.heard(bus + pwm, 0) == [], "nobody has asked for it"
    assert answers(language, frame(5, 5, 9) + frame(4, 5, 2)) == [bus, pwm]
    assert answers(language, frame(4, 5, 3)) == [frame(4, 3, 5, 0, 0)]


def test_reports_are_passed_on_whole_as_they_came() -> None:
    reports = [frame(0, 4, 0xE0, 0x2E), frame(7, *struct.pack("<6f", 0, 0, 1, 0, 0, 0)), frame(6, 1, 0x20)]
    reports.append(frame(8, 1, 0, 0, 1, 2, 3, 4))
    text = b"\x55" + b"".join(reports) + frame(4, 1, 5, 0xDC, 5) + reports[0][:-1] + b"\0" + reports[1]
    language = made()
    heard = [part for at in range(0, len(text), 5) for part in language.heard(text[at : at + 5], at)]
    assert heard == [*reports, reports[1]]


def mutated(random_: random.Random) -> bytes:
    def one() -> bytes:
        motors = random_.sample(range(4), random_.randrange(1, 5))
        return random_.choice(
            (
                speeds(*((motor, random_.choice((0.0, 0.5, -1.25, 3.0))) for motor in motors)),
                speeds(*((motor, random_.choice((0.5, -1.25))) for motor in motors)),
                frame(MOTOR, 0, motors[0], *struct.pack("<f", random_.choice((2.0, -0.5)))),
                frame(MOTOR, random_.choice((2, 3)), random_.randrange(6)),
                frame(MOTOR, 5, 1),
                frame(2, 0x6C, 7, 100, 0, 100, 0, 1, 0),
                NODE_REST,
            )
        )

    return damaged(random_, one, (0xAA, 0x55, 3), b"\xaa\x55\x03\x00\x01", 28)


@pytest.mark.claim("GUARD-1")
def test_nothing_moves_that_the_board_itself_would_not_move() -> None:
    """After each frame each wheel has the speed that the board has, or none."""
    random_ = random.Random(59)
    moved = 0
    for _ in range(amount(10_000, 1_000_000)):
        moved += judged(mutated(random_), motions, commanded)
    assert moved > 5_000
