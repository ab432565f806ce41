"""What a driver of a hoverboard may write, held against the board's own receiver, and the feedback that it hears."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

import pytest

from failstop.board.driver import DriverMotion, DriverRefusal, language_of
from failstop_lab.boards.hoverboard import Hoverboard
from tests.support.amounts import amount

if TYPE_CHECKING:
    from failstop.board.driver import DriverLanguage

MS = 1_000_000
BYTE_NS = 86_806
FORWARD = bytes.fromhex("cdab00006400a9ab")
TURN = bytes.fromhex("cdab64000000a9ab")
REST = bytes.fromhex("cdab00000000cdab")


def made() -> DriverLanguage:
    language = language_of("hoverboard", {})
    assert language
    return language


def motions(*chunks: bytes, every_ns: int = MS) -> list[tuple[float, ...]]:
    language = made()
    rows = [row for at, chunk in enumerate(chunks) for row in language.wrote(chunk, at * every_ns)]
    return [tuple(row.speeds) for row in rows if isinstance(row, DriverMotion)]


def commanded(*writes: bytes, gap_ns: int = MS) -> list[tuple[float, ...]]:
    """The speeds that the board has after each command that it finds, with silence on the line between the writes."""
    board, at_ns = Hoverboard(), 0
    for write in writes:
        for value in write:
            at_ns += BYTE_NS
            board.byte(at_ns, value)
        at_ns += gap_ns
        board.until(at_ns)
    return [speeds for _, speeds in board.commands]


def frame(steer: int, speed: int) -> bytes:
    words = (0xABCD, steer & 0xFFFF, speed & 0xFFFF)
    return b"".join(word.to_bytes(2, "little") for word in (*words, words[0] ^ words[1] ^ words[2]))


def test_the_wheels_turn_as_the_board_mixes_them() -> None:
    assert motions(FORWARD, TURN, REST) == [(100, 100), (50, -50), (0, 0)]
    assert motions(FORWARD, TURN, REST) == commanded(FORWARD, TURN, REST)


@pytest.mark.parametrize(
    ("steer", "speed"), [(1, 0), (-1, 3), (-37, -14), (1000, 1000), (-1000, 1000), (3000, -20), (0, 32767), (-2000, 5)]
)
def test_a_frame_is_clamped_and_rounded_as_the_board_does(steer: int, speed: int) -> None:
    assert motions(frame(steer, speed)) == commanded(frame(steer, speed))
    assert len(motions(frame(steer, speed))) == 1


def test_frames_may_come_split_and_glued_at_any_alignment() -> None:
    text = FORWARD + TURN + REST + FORWARD
    for cut in range(len(text)):
        assert motions(text[:cut], text[cut:]) == [(100, 100), (50, -50), (0, 0), (100, 100)]
    assert motions(*(bytes((value,)) for value in text)) == [(100, 100), (50, -50), (0, 0), (100, 100)]
    assert motions(b"\xcd" + FORWARD)[-1:] == [(100, 100)]


@pytest.mark.parametrize("garbage", [b"$GET SPD\r\n", b"m 10 10\r", FORWARD[:-1] + b"\0", b"\xab\xcd" * 4, bytes(8)])
def test_what_is_no_frame_stops_the_wheels_and_is_named_once(garbage: bytes) -> None:
    assert commanded(garbage) == []
    assert set(motions(garbage)) == {(0.0, 0.0)}
    refusals = {row.what for row in made().wrote(garbage, 0) if isinstance(row, DriverRefusal)}
    assert refusals == {"bytes that are not a frame"}
    assert motions(garbage, FORWARD)[-1] == (100, 100)


def test_the_rest_of_a_frame_that_comes_too_late_is_none() -> None:
    assert commanded(FORWARD[:5], FORWARD[5:], gap_ns=100 * MS) == []
    assert not any(map(any, motions(FORWARD[:5], FORWARD[5:], every_ns=100 * MS)))
    assert motions(FORWARD[:5], FORWARD, every_ns=100 * MS)[-1] == (100, 100)


def test_a_driver_that_dies_amid_a_frame_has_not_let_go() -> None:
    language = made()
    language.wrote(FORWARD + FORWARD[:5], 0)
    assert language.wrote(b"", 1000 * MS) == []


@pytest.mark.claim("GUARD-1")
def test_frames_that_were_cut_make_no_speed_that_nobody_wrote() -> None:
    """Such as full speed backward, of half a stop and a stop."""
    frames = [REST, FORWARD, TURN, frame(-100, 40), frame(33, -77), frame(1000, 1000), frame(7, 7)]
    for first in frames:
        for cut in range(1, 8):
            for second in frames:
                own = commanded(first) + commanded(second) + [(0.0, 0.0)]
                for text in ((first[:cut] + second + second,), (first[:cut], second)):
                    found = motions(*text)
                    assert all(speeds in own for speeds in found), (first.hex(), cut, second.hex())
    assert commanded(REST[:4] + REST[:4]) == [(-1000, -1000)], "the board itself would"
    assert motions(REST[:4] + REST)[-1] == (0, 0)


def mutated(random_: random.Random) -> bytes:
    frames = [
        frame(random_.randrange(-1100, 1100), random_.randrange(-1100, 1100)) for _ in range(random_.randrange(1, 5))
    ]
    text = bytearray(b"".join((*frames, random_.choice((b"", REST, FORWARD)))))
    for _ in range(random_.randrange(5)):
        at = random_.randrange(len(text) + 1)
        kind = random_.randrange(4)
        if kind == 0:
            del text[at : at + random_.randrange(1, 9)]
        elif kind == 1 and at < len(text):
            text[at] = random_.choice((0, 0xCD, 0xAB, random_.randrange(256)))
        elif kind == 2:
            text[at:at] = text[at : at + 8]
        else:
            text[at:at] = bytes(random_.choice(b"\xcd\xab\0\x64") for _ in range(random_.randrange(9)))
    return bytes(text)


@pytest.mark.claim("GUARD-1")
def test_nothing_moves_that_the_board_itself_would_not_move() -> None:
    """Each motion is one that the board finds in the same bytes, with silence on the line around eight of them."""
    random_ = random.Random(59)
    moved = 0
    for _ in range(amount(3_000, 1_000_000)):
        chunk = mutated(random_)
        left = iter([speeds for at in range(len(chunk) - 7) for speeds in commanded(chunk[at : at + 8])])
        for speeds in motions(chunk):
            if any(speeds):
                moved += 1
                assert speeds in left, chunk.hex()
    assert moved > 3_000


def feedback(length: int, number: int) -> bytes:
    words = [0xABCD, 100, 50, *(number + at for at in range(length // 2 - 4))]
    check = 0
    for word in words:
        check ^= word
    return b"".join((word & 0xFFFF).to_bytes(2, "little") for word in (*words, check))


@pytest.mark.parametrize("length", [18, 22, 26])
@pytest.mark.parametrize("step", [1, 7, 18, 64])
def test_feedback_of_every_length_is_passed_on_as_it_came(length: int, step: int) -> None:
    frames = [feedback(length, number) for number in range(40)]
    text = b"boot" + frames[0][5:] + b"".join(frames[1:])
    language = made()
    heard = [part for at in range(0, len(text), step) for part in language.heard(text[at : at + step], at)]
    assert heard == frames[1:]


def test_feedback_that_was_garbled_is_not_passed_on() -> None:
    frames = [feedback(18, number) for number in range(20)]
    bad = frames[9][:7] + b"\xff" + frames[9][8:]
    text = b"".join((*frames[:9], bad, frames[10][3:], *frames[11:]))
    language = made()
    heard = [part for at in range(0, len(text), 9) for part in language.heard(text[at : at + 9], at)]
    assert heard == [*frames[:9], *frames[11:]]
