"""Proofs that a terminal is still at the other end, and since when."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.cli.commands.attend import PLACES, Questions

MS = 1_000_000


def answer(question: str) -> bytes:
    found = re.fullmatch(r"\x1b\[(\d+);(\d+)H\x1b\[6n", question)
    assert found
    return f"\x1b[{found[1]};{found[2]}R".encode()


def test_an_answer_proves_when_it_was_asked() -> None:
    questions = Questions()
    first = questions.ask(100 * MS, 24)
    questions.ask(200 * MS, 24)
    assert questions.proven_ns == 0
    assert questions.typed(answer(first)) == b""
    assert questions.proven_ns == 100 * MS


def test_a_backlog_proves_the_past_alone() -> None:
    questions = Questions()
    asked = [questions.ask(number * 100 * MS, 24) for number in range(1, 51)]
    for number, question in enumerate(asked, 1):
        questions.typed(answer(question))
        assert questions.proven_ns == number * 100 * MS


def test_an_answer_that_was_lost_holds_up_no_other() -> None:
    questions = Questions()
    asked = [questions.ask(number * MS, 24) for number in range(1, 4)]
    questions.typed(answer(asked[2]))
    assert questions.proven_ns == 3 * MS
    questions.typed(answer(asked[0]))
    assert questions.proven_ns == 3 * MS


@pytest.mark.parametrize("data", [b"\x1b[1;1R", b"\x1b[0n", b"\x1b[99999;2R", b"R", b"\x1b[;R"])
def test_what_answers_nothing_proves_nothing(data: bytes) -> None:
    questions = Questions()
    questions.ask(MS, 24)
    questions.typed(data)
    assert questions.proven_ns == 0


@given(st.lists(st.sampled_from([b"q", b" ", b"x", b"\x1b[A"]), max_size=5), st.integers(0, 40))
def test_keys_and_answers_in_whatever_pieces(keys: list[bytes], cut: int) -> None:
    questions = Questions()
    question = questions.ask(MS, 24)
    data = b"".join(keys) + answer(question) + b"".join(keys)
    typed = questions.typed(data[:cut]) + questions.typed(data[cut:]) + questions.typed(b"")
    assert typed.replace(b"\x1b[A", b"").count(b"q") == 2 * keys.count(b"q")
    assert typed == b"".join(keys) * 2
    assert questions.proven_ns == MS


@given(st.integers(1, PLACES - 1), st.integers(0, 200))
def test_the_right_question_whatever_was_asked_before(open_ones: int, before: int) -> None:
    questions = Questions()
    for number in range(1, before + 1):
        questions.typed(answer(questions.ask(number, 24)))
    asked = [questions.ask(1000 + number, 24) for number in range(open_ones)]
    for number, question in enumerate(asked):
        questions.typed(answer(question))
        assert questions.proven_ns == 1000 + number
