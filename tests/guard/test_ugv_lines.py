"""What a driver of Waveshare's UGV may write, held against the board's own receiver."""

from __future__ import annotations

import json
import random
from typing import TYPE_CHECKING

import pytest

from failstop.board.driver import DriverAnswer, DriverFrame, DriverMotion, DriverRefusal, language_of
from failstop.board.kinds import board_of
from failstop_lab.boards.ugv import Ugv
from tests.support.amounts import amount

if TYPE_CHECKING:
    from failstop.board.driver import DriverLanguage

MS = 1_000_000
BOARD = board_of("ugv", 0.08, 0.0)
REPORT = b'{"T":1001,"L":0.1,"R":0.1,"ax":0,"ay":0,"az":8192,"gx":0,"gy":0,"gz":0,"odl":1,"odr":1,"v":1180}\r\n'


def made() -> DriverLanguage:
    language = language_of("ugv", {"wheels.track_m": 0.172})
    assert language
    return language


def motions(chunk: bytes) -> list[tuple[float, ...]]:
    return [tuple(row.speeds) for row in made().wrote(chunk, 0) if isinstance(row, DriverMotion)]


def refusals(chunk: bytes) -> list[str]:
    return [row.what for row in made().wrote(chunk, 0) if isinstance(row, DriverRefusal)]


def commanded(chunk: bytes) -> list[tuple[float, ...]]:
    """The speeds that the board has after each command that it finds in these bytes. T:138, which scales later speeds,
    is refused by name, so it never reaches the board."""
    board = Ugv()
    for line in chunk.split(b"\n")[:-1]:
        board.take(line + b"\n")
        board._rates = [1.0, 1.0]
    return [speeds for _, speeds in board.commands]


@pytest.mark.parametrize(
    "line",
    [
        b'{"T":1,"L":0.2,"R":-0.2}\n',
        b'{"T": 1, "L": 0.2, "R": 0.3}\r\n',
        b'{"T": "13", "X": 0.1, "Z": 0.0}\n',  # the vendor's ROS 2 node
        b'{"T":13,"X":0.25,"Z":0.3}\n',
        b"{'T':1,'L':.5,'R':5e-1}\n",
        b"{T:1,L:+1,R:1.}\n",
        b'{"T":1.9,"L":1,"R":1}\n',
        b'{"T":13,"X":"0.2","Z":"0.1"}\n',
        b'{"T":1,"L":0.1,"R":0.1} and more\n',
        b'{"T":1,"L":0.1,"R":0.1}\0{"T":1,"L":2,"R":2}\n',
        b'{"T":1,"L":9,"R":9,"L":0.1,"R":0.1}\n',
        b'{"T":0}\n',
        b"{}\n",
        b"null\n",
        b'{"L":1,"R":1}\n',
        b"[1,2]\n",
        b'{"T":13}\n',
        b'{"T":true,"L":0.1,"R":0.1}\n',
    ],
)
def test_each_spelling_that_the_board_takes_is_taken(line: bytes) -> None:
    assert len(motions(line)) == 1
    assert motions(line) == [pytest.approx(speeds) for speeds in commanded(line)]


@pytest.mark.parametrize(
    "line",
    [
        *(
            b'{"T":1,"L":"0.2","R":0.2}\n',
            b'{"T":1,"L":0.2}\n',
            b'{"T":1,"L":2.1,"R":0}\n',
            b'{"T":13,"X":2.1,"Z":0}\n',
        ),
        *(b'{"T":1,"L":1e400,"R":0}\n', b'{"T":1,"L":%s1,"R":0}\n' % (b"9" * 60)),
    ],
)
def test_what_the_board_ignores_moves_nothing(line: bytes) -> None:
    assert motions(line) == []
    assert not any(any(speeds) for speeds in commanded(line))
    assert len(refusals(line)) == 1


@pytest.mark.parametrize(
    "line", [b'{"T":1,"L":0.2,"R":0.2\n', b"m 10 10\n", b'{"T":1,,}\n', b"x" * 5000 + b"\n", b"12x\n"]
)
def test_a_line_that_is_no_json_stops_the_wheels(line: bytes) -> None:
    assert motions(line) == [(0.0, 0.0)]
    assert not any(any(speeds) for speeds in commanded(line))


def test_raw_pwm_stops_the_wheels() -> None:
    line = b'{"T":11,"L":164,"R":164}\n'
    assert motions(line) == [(0.0, 0.0)]
    assert refusals(line) == ["raw PWM (T:11)"]


def test_lines_may_come_split_and_glued() -> None:
    text = b'{"T":1,"L":0.1,"R":0.1}\n\n{"T": "13", "X": 0.2, "Z": 0.0}\r\n{"T":0}\n'
    for cut in range(len(text)):
        language = made()
        rows = language.wrote(text[:cut], 0) + language.wrote(text[cut:], 0)
        assert [tuple(row.speeds) for row in rows if isinstance(row, DriverMotion)] == [(0.1, 0.1), (0.2, 0.2), (0, 0)]


def test_the_vendor_s_web_app_starts() -> None:
    """Its first lines; none moves a wheel, and it may write all of them."""
    lines = [b'{"T":132,"IO4":0,"IO5":0}', b'{"T":3,"lineNum":0,"Text":"a"}', b'{"T":133,"X":0,"Y":0,"SPD":0,"ACC":0}']
    lines += [
        b'{"T":142,"cmd":50}',
        b'{"T":131,"cmd":1}',
        b'{"T":143,"cmd":0}',
        b'{"T":4,"cmd":2}',
        b'{"T":300,"mode":0}',
    ]
    lines += [b'{"T":303,"mac":"FF:FF:FF:FF:FF:FF"}', b'{"T":900,"main":2,"module":0}']
    text = b"".join(line + b"\n" for line in lines)
    assert motions(text) == []
    assert refusals(text) == ["the type of its module (T:4)", "T:303", "the type of the robot (T:900)"]
    assert [row.data for row in made().wrote(text, 0) if isinstance(row, DriverFrame)] == [
        b'{"T":1.32e2,"IO4":0,"IO5":0}\n',
        b'{"T":3,"lineNum":0,"Text":"a"}\n',
        b'{"T":1.33e2,"X":0,"Y":0,"SPD":0,"ACC":0}\n',
        b'{"T":3e2,"mode":0}\n',
    ]
    assert BOARD.check_aux(b'{"T":3e2,"mode":0}\n') == ""
    assert BOARD.check_aux(b'{"T":3e2,"mode":1}\n')
    assert refusals(b'{"T":300,"mode":1}\n') == ["obeying ESP-NOW radio (T:300)"]


PASSED = (
    b'{"T":132,"IO4":255,"IO5":255}\n',
    b'{"T":133,"X":1,"Y":1,"SPD":0,"ACC":0}\n',
    b'{"T":134,"X":1.5,"Y":-1,"SX":300,"SY":300}\n',
    b'{"T":137,"s":1,"y":0}\n',
    b'{"T":-3}\n',
    b'{"T":3,"lineNum":2,"Text":"V:12.1"}\n',
)


def test_a_command_for_which_the_board_waits_for_the_gimbal_is_refused() -> None:
    """It would hear no stop meanwhile."""
    lines = b'{"T":135}\n{"T":"141","X":0,"Y":0,"SPD":300}\n{"T":1.41e2,"X":0,"Y":0,"SPD":300}\n'
    assert refusals(lines) == ["stopping the gimbal (T:135)", "the gimbal (T:141)", "the gimbal (T:141)"]
    assert not any(isinstance(row, DriverFrame) for row in made().wrote(lines, 0))
    assert BOARD.check_aux(b'{"T":1.35e2}\n')
    assert BOARD.check_aux(b'{"T":1.41e2,"X":0,"Y":0,"SPD":300}\n')


@pytest.mark.claim("GUARD-1")
@pytest.mark.parametrize("line", PASSED)
def test_a_light_or_gimbal_moves_no_wheel_even_with_a_byte_lost_or_cut_off_before_a_stop(line: bytes) -> None:
    [row] = made().wrote(line, 0)
    assert isinstance(row, DriverFrame)
    assert BOARD.check_aux(row.data) == ""
    assert BOARD.check_motion(row.data, 1.0)
    assert {key: value for key, value in json.loads(row.data).items() if key != "T"} == {
        key: value for key, value in json.loads(line).items() if key != "T"
    }
    assert json.loads(row.data)["T"] == json.loads(line)["T"]
    for at in range(len(row.data)):
        for broken in (row.data[:at] + row.data[at + 1 :] + BOARD.burst, row.data[:at] + BOARD.burst):
            assert not any(any(speeds) for speeds in commanded(broken)), broken


@pytest.mark.parametrize(
    "line",
    [
        b'{"T":132,"IO4":1,"L":1,"R":1}\n',
        b'{"T":3,"Text":"a quote \\" in it"}\n',
        b'{"T":3,"Text":"%s"}\n' % (b"x" * 33),
        b'{"T":132,"IO4":[1]}\n',
        b'{"T":132,"IO4":["a"]}\n',
        b'{"T":132,"IO4":{"a":1}}\n',
        b'{"T":3,"lineNum":{"a":1}}\n',
        b'{"T":132,"IO4":true}\n',
    ],
)
def test_a_light_with_something_else_in_it_is_refused_by_name(line: bytes) -> None:
    assert [type(row) for row in made().wrote(line, 0)] == [DriverRefusal]


@pytest.mark.parametrize(
    "frame",
    [
        b'{"T":1.32e2,"T":1,"L":2,"R":2}\n',
        b'{"T":1,"L":1,"R":1}\n',
        b'{"T":132,"IO4":1}\n',
        b'{"T":1.32e2}\n{"T":1,"L":1,"R":1}\n',
        b'{"T":1.32e2}',
        b'{"T":1.36e2,"cmd":3000}\n',
    ],
)
def test_a_client_gets_nothing_else_onto_the_wire_as_a_light(frame: bytes) -> None:
    assert BOARD.check_aux(frame)


def test_reports_are_passed_on_whole_and_answers_to_failstop_s_questions_are_not() -> None:
    language = made()
    text = (
        b'rst:0xf (BROWNOUT_RST)\r\n{"T":139,"L":1,"R":1}\r\n'
        + REPORT
        + b'{"a":1}\r\n'
        + REPORT
        + b'{"T":1002,"r":0}\r\n'
    )
    heard = [part for at in range(0, len(text), 7) for part in language.heard(text[at : at + 7], at * MS)]
    assert heard == [REPORT, REPORT]
    answers = [
        row.data for row in language.wrote(b'{"T":126}\n{"T":139}\n{"T":130}\n', 0) if isinstance(row, DriverAnswer)
    ]
    assert answers == [b'{"T":1002,"r":0}\r\n', b'{"T":139,"L":1,"R":1}\r\n', REPORT]


def test_a_driver_may_have_fewer_reports_or_none_and_failstop_still_has_all() -> None:
    language = made()
    language.wrote(b'{"T":142,"cmd":200}\n', 0)
    assert sum(len(language.heard(REPORT, at * 50 * MS)) for at in range(40)) == 10
    language.wrote(b'{"T":131,"cmd":0}\n', 0)
    assert sum(len(language.heard(REPORT, at * 50 * MS)) for at in range(40, 80)) == 0
    language.wrote(b'{"T":131,"cmd":1}\n{"T":142,"cmd":0}\n', 0)
    assert sum(len(language.heard(REPORT, at * 50 * MS)) for at in range(80, 120)) == 40


def mutated(random_: random.Random) -> bytes:
    lines = (
        *(
            b'{"T":1,"L":0.2,"R":-0.3}\n',
            b'{"T": "13", "X": 0.1, "Z": 0.4}\n',
            b'{"T":13,"X":1.5,"Z":5}\n',
            b'{"T":0}\n',
        ),
        *(
            b'{"T":11,"L":200,"R":200}\n',
            b"{'T':1,L:1.9e0,R:.5}\n",
            b'{"T":136,"cmd":3000}\n',
            b'{"T":1,"L":0,"R":0}\n',
        ),
    )
    text = bytearray(b"".join(random_.choice(lines) for _ in range(random_.randrange(1, 5))))
    for _ in range(random_.randrange(6)):
        at = random_.randrange(len(text) + 1)
        kind = random_.randrange(4)
        if kind == 0:
            text[at : at + 1] = b""
        elif kind == 1 and at < len(text):
            text[at] = random_.randrange(256)
        elif kind == 2:
            end = random_.randrange(len(text) + 1)
            text[at:at] = text[at:end][:20]
        else:
            text[at:at] = bytes((random_.choice(b"{}[]\"':,.+-eE0123456789TLRXZ \n\r\0\\"),))
    return bytes(text)


@pytest.mark.claim("GUARD-1")
def test_nothing_moves_that_the_board_itself_would_not_move() -> None:
    random_ = random.Random(59)
    moved = 0
    for _ in range(amount(15_000, 1_000_000)):
        chunk = mutated(random_)
        left = iter(commanded(chunk))
        for speeds in motions(chunk):
            if any(speeds):
                moved += 1
                assert any(speeds == pytest.approx(own) for own in left), chunk
    assert moved > 5_000
