"""What a driver of Damiao's motors may write, held against the adapter's and the motors' own receiver, and what it
hears."""

from __future__ import annotations

import json
import random
from itertools import combinations, product
from pathlib import Path
from struct import pack
from typing import TYPE_CHECKING

import pytest

from failstop.board.damiao import codec
from failstop.board.damiao.driver import MOTOR_NS
from failstop.board.damiao.wire import WIRE
from failstop.board.driver import DriverAnswer, DriverFrame, DriverMotion, DriverRefusal, language_of
from failstop.guard.scale import Scale
from failstop.policy.settings import Settings
from failstop_lab.boards.damiao import LOST, OVER_HEATED, Adapter, Damiao, said
from tests.support.amounts import amount

from .damage import damaged, judged

if TYPE_CHECKING:
    from failstop.board.driver import DriverLanguage

HOST = json.loads((Path(__file__).parent.parent / "board" / "recorded_damiao_host.json").read_text())
MS = 1_000_000
MOTOR_MS = MOTOR_NS // MS
BYTE_NS = 10_000
FRAME_NS = 200_000
ENABLE, DISABLE, CLEAR, ZERO = (b"\xff" * 7 + bytes((last,)) for last in (0xFC, 0xFD, 0xFB, 0xFE))


def speed(motor: int, value: float, size: int = 8) -> bytes:
    return said(0x200 + motor, (pack("<f", value) + bytes(4))[:size])


def switch(motor: int, what: bytes) -> bytes:
    return said(motor, what)


def register(motor: int, what: int, index: int = 0, value: int = 0) -> bytes:
    return said(0x7FF, bytes((motor, 0, what, index)) + value.to_bytes(4, "little"))


def made(layout: str = "differential") -> DriverLanguage:
    language = language_of("damiao", Settings({"board.kind": "damiao", "wheels.layout": layout}).flat())
    assert language
    return language


def motions(chunk: bytes, language: DriverLanguage | None = None) -> list[tuple[float, ...]]:
    rows = (language or made()).wrote(chunk, 0)
    return [tuple(row.speeds) for row in rows if isinstance(row, DriverMotion)]


def refusals(chunk: bytes) -> list[str]:
    return [row.what for row in made().wrote(chunk, 0) if isinstance(row, DriverRefusal)]


def commanded(chunk: bytes) -> list[tuple[float, ...]]:
    """What the motors turn at after each line."""
    board, now_ns = Damiao(armed=True), 0
    found: list[tuple[float, ...]] = []
    for value in chunk:
        now_ns += BYTE_NS
        board.byte(now_ns, value)
        if value == ord("\r"):
            now_ns += FRAME_NS
            board.until(now_ns)
            found.append(board.wheels)
    return found


def heard(language: DriverLanguage, board: Damiao, chunk: bytes) -> list[bytes]:
    """What a driver hears of what the board says to these bytes."""
    now_ns = 0
    for value in chunk:
        now_ns += BYTE_NS
        board.byte(now_ns, value)
    board.until(now_ns + 100_000_000)
    answers, board.said = board.said, []
    return [each for _, data in answers for value in data for each in language.heard(bytes((value,)), 0)]


def test_what_a_foreign_host_writes_is_taken_as_it_is_meant() -> None:
    """damiao-motor 1.0.6 through the slcan of python-can 4.6.1, at a pseudo-terminal."""
    language = made()
    assert motions(HOST["opened"].encode(), language) == []
    names = []
    for name, text in HOST["wrote"]:
        chunk = text.encode()
        names.append(name.split()[0])
        rows = language.wrote(chunk, 0)
        found = [tuple(row.speeds) for row in rows if isinstance(row, DriverMotion)]
        if names[-1] == "speed":
            value = float(name.split()[1])
            assert found[-1] == (value, value) == commanded(chunk)[-1]
        else:
            assert not any(map(any, found)), name
        if names[-1] == "read":
            (row,) = rows
            assert isinstance(row, DriverFrame)
            assert row.data == chunk
            assert WIRE.aux
            assert WIRE.aux(row.data) == ""
        refused = [row.what for row in rows if isinstance(row, DriverRefusal)]
        assert refused == (["the time of the motors' watchdog"] if names[-1] == "timeout" else [])
    assert {*names} == {"enable", "clear", "timeout", "mode", "report", "read", "speed"}


def test_every_motor_is_driven_by_one_driver() -> None:
    chunk = speed(1, 3.0) + speed(2, -7.5) + speed(1, 0.0) + speed(2, 0.0)
    assert motions(chunk) == [(3, 0), (3, -7.5), (0, -7.5), (0, 0)] == commanded(chunk)
    four = made("mecanum")
    assert motions(b"".join(speed(motor, motor) for motor in (1, 2, 3, 4)), four)[-1] == (1, 2, 3, 4)


def test_a_speed_of_one_motor_keeps_no_other_one_turning() -> None:
    """Each motor may have a thread of its own, and one of them may hang."""
    language = made()
    language.wrote(speed(2, 5.0), 0)
    for at_ms in range(100, MOTOR_MS, 100):
        (row,) = language.wrote(speed(1, 3.0), at_ms * MS)
        assert isinstance(row, DriverMotion)
        assert (tuple(row.speeds), row.refused) == ((3, 5), False)
    for value in (3.0, 0.0):
        refusal, row = language.wrote(speed(1, value), MOTOR_MS * MS)
        assert isinstance(refusal, DriverRefusal)
        assert "has not commanded this one for too long" in refusal.why
        assert isinstance(row, DriverMotion)
        assert (tuple(row.speeds), row.refused) == ((value, 0), True), "the driver has not ended driving"
    (row,) = language.wrote(speed(2, 0.0), MOTOR_MS * MS)
    assert isinstance(row, DriverMotion)
    assert (tuple(row.speeds), row.refused) == ((0, 0), False)


def test_a_motor_keeps_its_speed_for_as_long_as_the_settings_let_a_speed_count() -> None:
    language = language_of("damiao", Settings({"board.kind": "damiao", "guard.timeout_s": 2.5}).flat())
    assert language
    found = []
    for at_ms in (0, 2000, 4000):
        for motor in (1, 2):
            (row,) = language.wrote(speed(motor, 3.0), (at_ms + motor) * MS)
            assert isinstance(row, DriverMotion)
            found.append((tuple(row.speeds), row.refused))
    assert found == [((3, 0), False), *[((3, 3), False)] * 5]


@pytest.mark.parametrize("size", [4, 5, 8])
def test_a_speed_has_four_bytes_or_more_and_digits_of_either_case(size: int) -> None:
    for text in (speed(1, -20.5, size), speed(1, -20.5, size).replace(b"A", b"a").replace(b"C", b"c")):
        assert motions(text) == [(-20.5, 0)] == commanded(text)
    assert motions(speed(1, 3.0, 3)) == [(0, 0)]


def test_lines_may_come_split_and_glued() -> None:
    text = speed(1, 9.0) + speed(2, 5.0) + register(1, codec.REPORT) + speed(1, 0.0)
    for cut in range(len(text)):
        language = made()
        found = motions(text[:cut], language) + motions(text[cut:], language)
        assert found == [(9, 0), (9, 5), (0, 5)]


@pytest.mark.parametrize(
    ("chunk", "what"),
    [
        (said(1, bytes(range(8))), "an MIT command"),
        (said(0x101, bytes(8)), "a position"),
        (said(0x302, bytes(8)), "a position with a force"),
        (register(1, codec.WRITE, codec.MODE, 1), "another mode for motor 1"),
        (speed(1, 5.0)[:-3] + b"\r", "bytes that are no line of slcan"),
        (b"C\r" + speed(1, 5.0), "a frame while the adapter is closed"),
        (speed(1, float("nan")), "a speed that is no number"),
        (speed(2, float("-inf")), "a speed that is no number"),
    ],
)
def test_what_would_turn_a_motor_without_a_speed_stops_all(chunk: bytes, what: str) -> None:
    language = made()
    language.wrote(speed(1, 3.0) + speed(2, 3.0), 0)
    rows = language.wrote(chunk, 0)
    assert what in [row.what for row in rows if isinstance(row, DriverRefusal)]
    assert [(tuple(row.speeds), row.refused) for row in rows if isinstance(row, DriverMotion)] == [((0, 0), True)]


@pytest.mark.parametrize(
    ("chunk", "what"),
    [
        (speed(3, 1.0), "a frame for motor 3"),
        (register(9, codec.READ, 10), "a frame for motor 9"),
        (register(1, codec.WRITE, 25, 1), "a value for register 25 of motor 1"),
        (register(2, 0xAA), "to store registers"),
        (register(2, 0x11), "another frame about registers"),
        (register(2, codec.READ, codec.MOST_REGISTER + 1), "another frame about registers"),
        (switch(1, ZERO), "the zero of motor 1's position"),
        (b"S6\r", "another bit rate of the CAN"),
        (b"V\r", "the adapter's command V"),
        (b"T000002018" + b"0" * 16 + b"\r", "a frame with an extended id, or without data"),
        (b"C\r" + speed(1, 3.0), "a frame while the adapter is closed"),
        (switch(1, DISABLE) + speed(1, 3.0), "a speed for motor 1, which the driver has disabled"),
        (speed(1, 3.0)[:-3] + b"\r", "bytes that are no line of slcan"),
        (speed(1, 3.0).replace(b"8", b"G"), "bytes that are no line of slcan"),
        (b"0" * 200 + speed(1, 3.0), "bytes that are no line of slcan"),
        (b"O" * 31 + b"\r", "bytes that are no line of slcan"),
        (b"\n" + speed(1, 3.0), "bytes that are no line of slcan"),
    ],
)
def test_what_is_refused_is_named_and_moves_nothing(chunk: bytes, what: str) -> None:
    assert refusals(chunk) == [what]
    assert not any(map(any, motions(chunk)))


def test_an_adapter_that_was_closed_and_a_motor_that_was_disabled_move_again_when_the_driver_says_so() -> None:
    language = made()
    language.wrote(speed(1, 3.0) + speed(2, 4.0), 0)
    assert motions(switch(1, DISABLE), language) == [(0, 4)], "failstop brakes, and the bare motor would roll"
    assert motions(switch(1, ENABLE), language) == []
    assert motions(b"C\rO\r" + speed(1, 6.0), language) == [(6, 4)]
    assert motions(switch(1, ENABLE), language) == [], "it is enabled"
    assert motions(register(2, codec.WRITE, codec.MODE, 2) + speed(2, 5.0), language) == [(0, 0)]
    assert motions(register(2, codec.WRITE, codec.MODE, 3) + speed(2, 5.0), language) == [(0, 5)]


def test_behind_a_line_that_could_mean_anything_a_driver_sets_up_adapter_and_motors_again() -> None:
    """It may ask for the mode, as damiao-motor does, or set it."""
    language, board = made(), Damiao(armed=True)
    assert motions(speed(1, 3.0) + b"t2018123\r" + speed(1, 3.0), language) == [(3, 0), (0, 0), (0, 0)]
    assert not any(map(any, motions(b"O\r" + switch(1, ENABLE) + switch(2, ENABLE) + speed(1, 3.0), language)))
    language.wrote(register(1, codec.READ, codec.MODE), 0)
    heard(language, board, register(1, codec.READ, codec.MODE))
    assert motions(speed(1, 3.0) + speed(2, 3.0), language) == [(3, 0)]
    assert motions(register(2, codec.WRITE, codec.MODE, 3) + speed(2, 4.0), language) == [(3, 4)]


def test_failstop_s_own_stop_is_a_stop_at_its_guard_port_too() -> None:
    """As of another failstop. Its motors 3 and 4 are not there."""
    language = made()
    assert motions(speed(1, 3.0) + speed(2, 4.0), language)[-1] == (3, 4)
    assert motions(WIRE.stop.writes[0].data, language)[-1] == (0, 0)
    assert motions(speed(1, 3.0), language) == [(3, 0)]
    assert motions(b"t2018CDCC" + WIRE.stop.writes[0].data + speed(1, 3.0), language)[-1] == (0, 0), "cut before it"


def test_each_frame_is_answered_by_the_newest_report_of_its_motor() -> None:
    language, board = made(), Damiao(armed=True, turns=True)
    assert language.wrote(speed(1, 3.0), 0)[1:] == [], "nothing was heard yet"
    heard(language, board, codec.Motors(2).frame((3.0, -2.0), 10.0) + codec.Motors(2).questions[0])
    (_, answer) = language.wrote(speed(2, -2.0), 0)
    assert isinstance(answer, DriverAnswer)
    assert answer.data == said(0x12, board.motors[1].report(-2.0))
    (answer,) = language.wrote(register(1, codec.REPORT), 0)
    assert isinstance(answer, DriverAnswer)
    assert answer.data == said(0x11, board.motors[0].report(3.0))


@pytest.mark.parametrize(("status", "switched", "shown"), [(0, ENABLE, 1), (1, DISABLE, 0), (OVER_HEATED, ENABLE, 11)])
def test_a_report_has_the_status_that_the_driver_gave_it_or_the_motor_s_fault(
    status: int, switched: bytes, shown: int
) -> None:
    """Motors are not enabled before somebody enables motion, and the driver would wait for them."""
    language, board = made(), Damiao()
    board.motors[0].status = status
    heard(language, board, b"S8\rO\r" + register(1, codec.REPORT))
    answer = language.wrote(switch(1, switched), 0)[-1]
    assert isinstance(answer, DriverAnswer)
    assert int(answer.data[5:6], 16) == shown


def test_a_driver_hears_the_answers_to_its_own_questions_alone() -> None:
    language, board = made(), Damiao(armed=True)
    own = b"".join(codec.Motors(2).questions)
    assert heard(language, board, own) == []
    (row,) = language.wrote(register(2, codec.READ, codec.V_MAX), 0)
    assert isinstance(row, DriverFrame)
    assert heard(language, board, row.data) == [said(0x12, bytes((2, 0, 0x33, codec.V_MAX)) + pack("<f", 45.0))]
    assert heard(language, board, own) == [], "it has its answer"


def test_values_for_the_mode_and_the_watchdog_are_answered_as_a_motor_would() -> None:
    language, board = made(), Damiao()
    heard(language, board, b"S8\rO\r" + b"".join(codec.Motors(2).questions))
    for index, value in ((codec.MODE, codec.SPEED_MODE), (codec.TIMEOUT, 40_000)):
        asked = register(1, codec.WRITE, index, value)
        (*_, answer) = language.wrote(asked, 0)
        board.motors[0].fed_ns = 0
        (_, own) = _answers(board, asked)
        assert isinstance(answer, DriverAnswer)
        assert answer.data == own


def _answers(board: Damiao, chunk: bytes) -> tuple[int, bytes]:
    for value in chunk:
        board.byte(0, value)
    board.until(1_000_000_000)
    (answer,) = board.said
    board.said = []
    return answer


@pytest.mark.parametrize("lost", [1, 2])
def test_a_question_that_lost_characters_moves_nothing_and_sets_nothing(lost: int) -> None:
    """Behind a line that left the worst digits: those of a speed, or of a value for a register."""
    left = (speed(1, 280.0), said(0x201, b"\x55" * 8), register(1, codec.WRITE, codec.MODE, 1))
    for motor, index in product((1, 4), range(codec.MOST_REGISTER + 1)):
        line = codec.register(motor, codec.READ, index)
        for places in combinations(range(len(line) - 1), lost):
            text = bytes(value for at, value in enumerate(line) if at not in places)
            for before in left:
                adapter = Adapter(before)
                for can_id, data in filter(None, map(adapter.byte, text)):
                    assert can_id >> 8 == 7, text
                    assert data[2:3] not in (b"\x55", b"\xaa"), text


@pytest.mark.parametrize("index", [0, 9, 22, codec.MOST_REGISTER])
def test_only_questions_for_registers_of_its_motors_are_passed_on(index: int) -> None:
    aux = WIRE.aux
    assert aux
    assert aux(codec.register(2, codec.READ, index)) == ""
    for frame in (
        codec.register(3, codec.READ, index),
        codec.register(1, codec.READ, codec.MOST_REGISTER + 1),
        codec.register(1, codec.WRITE, index),
        codec.register(1, codec.REPORT, index),
        codec.register(1, codec.READ, index, 1),
        codec.register(1, codec.READ, index).lower(),
        codec.register(1, codec.READ, index)[:-1],
        codec.register(1, codec.READ, index) * 2,
        speed(1, 3.0),
        switch(1, ENABLE),
        b"C\r",
        b"\r",
        b"",
    ):
        assert aux(frame)


def test_speeds_are_rad_per_second_of_the_wheels() -> None:
    settings = Settings({"board.kind": "damiao"})
    scale = Scale(settings, WIRE.motion.per_rps(0.08), WIRE.motion.step)
    vx, vy, wz = scale.velocity((5.0, 5.0))
    assert (vx, vy, wz) == (pytest.approx(5.0 * settings["wheels.diameter_m"] / 2, rel=0.01), 0.0, pytest.approx(0.0))


@pytest.mark.claim("GUARD-1")
def test_nothing_moves_that_the_board_itself_would_not_move() -> None:
    """After each line each motor has the speed that it has at the bare adapter, or none."""
    random_ = random.Random(37)

    def one() -> bytes:
        motor = random_.choice((1, 2))
        value = random_.choice((0.0, 1.0, -12.25, 20.5, 280.0, -0.015625))
        what = random_.choice((ENABLE, DISABLE, CLEAR))
        size = random_.choice((8, 8, 4))
        mode = register(motor, codec.WRITE, codec.MODE, random_.choice((1, 3, 3)))
        moves = speed(motor, value, size)
        return random_.choice((moves, moves, moves, switch(motor, what), mode, b"C\r", b"O\r"))

    moved = 0
    for _ in range(amount(1000, 1_000_000)):
        chunk = damaged(random_, one, b"0128t\r", b"\r0tCO8F", 22)
        moved += judged(chunk, motions, commanded)
    assert moved > 100
    assert LOST not in (motor.status for motor in Damiao(armed=True).motors)
