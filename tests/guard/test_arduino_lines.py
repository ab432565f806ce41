"""What a driver of ros_arduino_bridge may write, held against the board's own receiver."""

from __future__ import annotations

import random
from itertools import pairwise
from typing import TYPE_CHECKING

import pytest

from failstop.board.arduino.driver import ArduinoDriver
from failstop.board.driver import DriverAnswer, DriverFrame, DriverMotion, DriverRefusal, language_of
from failstop.board.kinds import board_of
from failstop.guard.talk import Talk
from failstop_lab.boards.arduino import Arduino
from tests.support.amounts import amount

if TYPE_CHECKING:
    from failstop.board.driver import DriverLanguage

OK = b"OK\r\n"
BOARD = board_of("arduino", 0.08, 0.0)


def answers(*lines: bytes) -> list[bytes]:
    """What a new driver gets for these lines."""
    language = language_of("arduino", {})
    assert language
    return [row.data for line in lines for row in language.wrote(line, 0) if isinstance(row, DriverAnswer)]


def motions(chunk: bytes) -> list[tuple[float, ...]]:
    language = language_of("arduino", {})
    assert language
    return [tuple(row.speeds) for row in language.wrote(chunk, 0) if isinstance(row, DriverMotion)]


def commanded(chunk: bytes) -> list[tuple[float, ...]]:
    """The commands that the board itself finds in these bytes, given time for each."""
    board = Arduino()
    for value in chunk:
        board.take(value)
    return [speeds for _, speeds in board.commands]


@pytest.mark.parametrize(
    "line",
    [
        *(b"m 10 -20\r", b"m +10, +20\r", b"m 10 20 30\r", b"m  10 20\r", b"m 10\r", b"m\r", b"m 10,20\r"),
        *(b"xm 10 20\r", b"\nm 10 20\r", b"\n\nm 7 8\r", b"m \t10 \n20\r", b"m 10x 2y\r", b"m 1e2 0x10\r"),
        *(b"m 32767 -32767\r", b"m 000000000000010 1\r", b"m - +\r", b"m 10\x009 20\r", b"m 5 6 \r"),
    ],
)
def test_each_spelling_that_the_board_takes_is_taken(line: bytes) -> None:
    assert motions(line) == commanded(line)
    assert answers(line) == [OK]


def test_lines_may_come_split_and_glued() -> None:
    text = b"\rm 10 20\re\rm 3 -4\ru 30:20:0:100\r"
    for cut in range(len(text)):
        language = language_of("arduino", {})
        assert language
        rows = language.wrote(text[:cut], 0) + language.wrote(text[cut:], 0)
        assert [tuple(row.speeds) for row in rows if isinstance(row, DriverMotion)] == [(10, 20), (3, -4)]
        assert [row.data for row in rows if isinstance(row, DriverAnswer)] == [
            b"Invalid Command\r\n", OK, b"0 0\r\n", OK, OK,
        ]  # fmt: skip


def test_a_session_of_diffdrive_arduino() -> None:
    """Its first lines, and then what it writes 30 times a second."""
    start = b"\r", b"u 30:20:0:100\r"
    loop = b"e\r", b"m 10 20\r", b"e\r", b"m 0 0\r"
    assert answers(*start, *loop) == [b"Invalid Command\r\n", OK, b"0 0\r\n", OK, b"0 0\r\n", OK]


def test_a_session_of_hbrobotics_node() -> None:
    """It exits unless the board says its rate within two tries, and asks forever for an OK that is missing."""
    lines = b"b\r", b"u 20:12:0:50\r", b"r\r", b"c 13 1\r", b"w 13 0\r", b"x 5 100\r", b"s 0 90\r", b"a 3\r", b"d 4\r"
    assert answers(*lines) == [b"57600\r\n", OK, OK, OK, OK, OK, OK, b"0\r\n", b"0\r\n"]
    assert motions(b"".join(lines)) == [(0.0, 0.0)], "by r"


@pytest.mark.parametrize(("setting", "answer"), [(0, b"57600\r\n"), (115_200, b"115200\r\n")])
def test_the_rate_is_the_one_of_the_board(setting: int, answer: bytes) -> None:
    """hbrobotics' node has the board's rate in its parameters, and compares."""
    language = language_of("arduino", {"board.baud": setting})
    assert language
    assert [row.data for row in language.wrote(b"b\r", 0) if isinstance(row, DriverAnswer)] == [answer]


@pytest.mark.parametrize("line", [b"m 32768 0\r", b"m 0 -99999\r", b"m 65546 0\r", b"m 0000000000000010 1\r"])
def test_a_speed_that_would_wrap_around_on_the_board_stops_the_wheels(line: bytes) -> None:
    assert motions(line) == [(0.0, 0.0)]
    assert answers(line) == [OK]


def test_a_reset_of_the_encoders_stops_the_wheels_as_the_board_stops_them() -> None:
    board = Arduino()
    for value in b"m 30 30\rr\r":
        board.take(value)
    assert board.wheels == (0, 0)
    assert motions(b"m 30 30\rr\r") == [(30, 30), (0, 0)]
    assert answers(b"r\r") == [OK]
    language = language_of("arduino", {})
    assert language
    [row] = [row for row in language.wrote(b"r\r", 0) if isinstance(row, DriverMotion)]
    assert not row.refused


@pytest.mark.parametrize("line", [b"o 100 100\r", b"q 1 2\r", b"\x80 1 2\r"])
def test_raw_pwm_and_unknown_commands_stop_the_wheels_and_are_named(line: bytes) -> None:
    language = language_of("arduino", {})
    assert language
    rows = language.wrote(line, 0)
    assert [type(row) for row in rows] == [DriverRefusal, DriverMotion, DriverAnswer]
    assert motions(line) == [(0.0, 0.0)]


def test_counts_begin_at_zero_for_each_driver_and_go_on_as_the_board_counts() -> None:
    language = language_of("arduino", {})
    assert language
    assert language.heard(b"5000 -300\r\n", 0) == []
    said = []
    for at, report in enumerate((b"5010 -310\r\nOK\r\n", b"5030 -330\r\n", b"57600\r\n"), 1):
        language.heard(report, at * 100_000_000)
        said += [row.data for row in language.wrote(b"e\r", at) if isinstance(row, DriverAnswer)]
    assert said == [b"10 -10\r\n", b"30 -30\r\n", b"30 -30\r\n"]
    language.wrote(b"r\r", 4)
    language.heard(b"5037 -330\r\n", 400_000_000)
    assert [row.data for row in language.wrote(b"e\r", 5) if isinstance(row, DriverAnswer)] == [b"7 0\r\n"]


def test_counts_go_on_when_the_service_is_started_again() -> None:
    """The driver has kept the port open, so its odometry must not jump; the board may count from zero again."""
    before = Talk(ArduinoDriver(), 2, 300_000_000, 300_000_000)
    before.heard(b"5000 -300\r\n5010 -310\r\n", 0)
    assert before.wrote(b"e\r", 1, 1) == [b"10 -10\r\n"]
    talk = Talk(ArduinoDriver(), 2, 300_000_000, 300_000_000)
    talk.resume(before)
    assert talk.wrote(b"e\r", 2, 2) == [b"10 -10\r\n"]
    talk.heard(b"0 0\r\n", 3)
    assert talk.wrote(b"e\r", 4, 4) == [b"10 -10\r\n"]
    talk.heard(b"3 -2\r\n", 5)
    assert talk.wrote(b"e\r", 6, 6) == [b"13 -12\r\n"]
    assert before.wrote(b"e\r", 7, 7) == [b"10 -10\r\n"], "the earlier conversation keeps its own"


def frames(language: DriverLanguage, line: bytes, now_ms: int = 0) -> list[bytes]:
    return [row.data for row in language.wrote(line, now_ms * 1_000_000) if isinstance(row, DriverFrame)]


def test_each_question_for_counts_has_the_board_asked_for_the_next_ones() -> None:
    language = language_of("arduino", {})
    assert language
    assert frames(language, b"e\r", 1000) == [b"e\r"]
    assert frames(language, b"e\r", 1033) == [], "the board has not answered yet"
    language.heard(b"10 10\r\n", 1_040_000_000)
    assert frames(language, b"e\r", 1066) == [b"e\r"]
    assert frames(language, b"e\r", 1165) == []
    assert frames(language, b"e\r", 1166) == [b"e\r"], "a question or its answer was lost"


@pytest.mark.parametrize("every_ms", [20, 33, 50, 100, 1000])
def test_counts_are_equally_old_each_time(every_ms: int) -> None:
    """Wheels that turn by a count each millisecond; the board answers after 2 ms, and failstop itself asks it ten times
    a second. An answer to failstop itself that comes within these 2 ms is taken for the driver's."""
    language = language_of("arduino", {})
    assert language
    counts, reports = [], set(range(40, 10_000, 100))
    for now_ms in range(10_000):
        if now_ms in reports:
            language.heard(b"%d 0\r\n" % now_ms, now_ms * 1_000_000)
        if now_ms % every_ms == 0:
            rows = language.wrote(b"e\r", now_ms * 1_000_000)
            counts += [int(row.data.split()[0]) for row in rows if isinstance(row, DriverAnswer)]
            reports |= {now_ms + 2 for row in rows if isinstance(row, DriverFrame)}
    assert {after - before for before, after in pairwise(counts[3:])} <= set(range(every_ms - 2, every_ms + 3))
    assert counts[-1] > 10_000 - 2 * every_ms - 100


def test_a_driver_sets_the_pins_that_the_settings_name_and_no_other() -> None:
    language = language_of("arduino", {"guard.pins": "11 16"})
    assert language
    assert frames(language, b"w 11 1\rx 16  200\rc 11 1\r") == [b"w 11 1\r", b"x 16 200\r", b"c 11 1\r"]
    for line in (b"w 13 1\r", b"w 8 1\r", b"x 11 256\r", b"c 11 2\r", b"w 11 -1\r"):
        rows = language.wrote(line, 0)
        assert [type(row) for row in rows] == [DriverRefusal, DriverAnswer], line
    assert BOARD.check_aux(b"w 11 1\r") == ""
    for line in (
        b"w 5 1\r",
        b"x 13 1\r",
        b"w 4 1\r",
        b"x 7 1\r",
        b"c 8 1\r",
        b"w 11 1",
        b"w 11 1\rm +9, +9\r",
        b"m +9, +9\r",
        b"e\r",
    ):
        assert BOARD.check_aux(line), line


@pytest.mark.parametrize("pins", ["13", "eleven", "11 5", "-11", "4", "7", "8"])
def test_a_setting_for_pins_that_may_drive_a_motor_is_refused(pins: str) -> None:
    with pytest.raises(ValueError, match=r"^guard\.pins: .*, must be among 11, 14, 15"):
        language_of("arduino", {"guard.pins": pins})


@pytest.mark.parametrize(
    ("before", "after", "moved"),
    [
        pytest.param(b"2147483640 0\r\n", b"-2147483646 0\r\n", b"10 0\r\n", id="the counters wrap"),
        pytest.param(b"90000 90000\r\n", b"3 2\r\n", b"0 0\r\n", id="the board has restarted"),
        pytest.param(b"100 0\r\n", b"800000000 0\r\n", b"0 0\r\n", id="nonsense"),
    ],
)
def test_a_robot_does_not_jump_when_the_counters_do(before: bytes, after: bytes, moved: bytes) -> None:
    language = language_of("arduino", {})
    assert language
    language.heard(before, 0)
    language.heard(after, 100_000_000)
    assert [row.data for row in language.wrote(b"e\r", 0) if isinstance(row, DriverAnswer)] == [moved]


def mutated(random_: random.Random) -> bytes:
    """Lines of drivers with bytes lost, doubled, changed, and put in."""
    lines = (b"m 10 -20\r", b"m +7, +8\r", b"e\r", b"\r", b"u 30:20:0:100\r", b"o 90 90\r", b"m 999 999\r", b"m 0 0\r")
    text = bytearray(b"".join(random_.choice(lines) for _ in range(random_.randrange(1, 6))))
    for _ in range(random_.randrange(6)):
        at = random_.randrange(len(text) + 1)
        kind = random_.randrange(4)
        if kind == 0:
            text[at:at] = bytes((random_.choice(b"m eou 0123456789-+,\r\n\0\x80"),))
        elif kind == 1:
            del text[at : at + 1]
        elif kind == 2 and at < len(text):
            text[at] = random_.randrange(256)
        else:
            text[at:at] = bytes(random_.choice(b"m eo 0123456789-+,\r\n") for _ in range(random_.randrange(20)))
    return bytes(text)


@pytest.mark.claim("GUARD-1")
def test_nothing_moves_that_the_board_itself_would_not_move() -> None:
    """Each motion is one that the board's receiver finds in the same bytes; what the board takes and the guard refuses
    is a stop."""
    random_ = random.Random(59)
    moved = 0
    for _ in range(amount(20_000, 1_000_000)):
        chunk = mutated(random_)
        found, own = motions(chunk), commanded(chunk)
        left = iter(own)
        for speeds in found:
            if any(speeds):
                moved += 1
                assert speeds in left, chunk
    assert moved > 10_000
