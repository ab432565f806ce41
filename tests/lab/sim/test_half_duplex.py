"""A line that both sides write on: what was read together need not have been written together."""

from __future__ import annotations

import pytest

from failstop.board.feetech import codec
from failstop_lab.boards.feetech import Bus
from failstop_lab.boards.live import LiveModel

MS = 1_000_000
QUESTION = codec.packet(6, codec.READ, bytes((56, 8)))
MOTION = codec.motion((5, -5, 0), codec.LIMIT)


def said(*reads: tuple[int, bytes]) -> tuple[Bus, bytes]:
    """The bus after these reads, and its answers; the last question comes 100 ms later, and is of all wheels."""
    model = LiveModel("feetech", 0)
    found: list[bytes] = []
    for at_ns, data in (*reads, (100 * MS, codec.QUESTIONS[0])):
        found += model.advance(at_ns)
        model.receive(data, at_ns)
    found += model.advance(200 * MS)
    assert isinstance(model.receiver, Bus)
    return model.receiver, b"".join(found)


@pytest.mark.parametrize("behind", [MOTION, codec.QUESTIONS[1], QUESTION + MOTION], ids=["motion", "question", "both"])
def test_what_is_read_together_with_a_question_waits_for_its_answer(behind: bytes) -> None:
    bus, answers = said((MS, QUESTION + behind))
    assert bus.collisions == 0
    assert bus.wheels == ((5.0, -5.0, 0.0) if MOTION in behind else (0.0, 0.0, 0.0))
    assert answers.count(b"\xff\xff\x06") == 1 + (QUESTION in behind)
    for wheel in codec.WHEELS:
        assert answers.count(bytes((255, 255, wheel))) == 1 + (behind == codec.QUESTIONS[1])


def test_what_is_read_while_an_answer_is_on_the_line_meets_it() -> None:
    bus, _ = said((MS, QUESTION), (MS + 200_000, MOTION))
    assert bus.collisions > 0
