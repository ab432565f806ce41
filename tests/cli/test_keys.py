"""The bytes of keys, whole and in pieces; hold-to-run by a fake clock; proofs that a terminal is still there."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.cli.commands.attend import PLACES, Questions
from failstop.cli.screen.keys import AXES, COMMAND_S, CTRL_D, ENDS_S, MOST_AT_ONCE, NO_VELOCITY, Hold, KeyDecoder

KEYS: tuple[tuple[bytes, list[str]], ...] = (
    (b"w", ["w"]),
    (b"W", ["w"]),
    (b" ", [" "]),
    (b"\x1b[A\x1b[B\x1b[C\x1b[D", ["up", "down", "right", "left"]),
    (b"\x1bOA", ["up"]),
    (b"\x1b[1;2C", ["right"]),
    (b"\r", ["\r"]),
    (b"\x04", [CTRL_D]),
    ("é".encode(), ["é"]),
    (b"\xe2 ", [" "]),
    (b"\xe2\x1b[A", ["up"]),
    (b"\x1bw", ["\x1b", "w"]),
    (b"\x1b[I\x1b[O", []),
    (b"\x1b[3~\x1b[15~", []),
    (b"\x1b[?62;c", []),
    (b"\x1b[119u", []),
    (b"\x1b[<64;87;69M\x1b[<65;87;69M", []),
    (b"\x1b[<0;87;69M\x1b[<0;87;69mw", ["w"]),
    (b"\x1b[M`We\x1b[MaWee", ["e"]),
    (b"\x1b[M#\xffww", ["w"]),
    (b"\x1b[M w", [" ", "w"]),
)


@pytest.mark.parametrize(("data", "found"), KEYS)
def test_keys(data: bytes, found: list[str]) -> None:
    assert KeyDecoder().feed(data) == found


@pytest.mark.parametrize(("data", "found"), KEYS)
def test_keys_that_come_byte_by_byte(data: bytes, found: list[str]) -> None:
    decoder = KeyDecoder()
    assert [key for at in range(len(data)) for key in decoder.feed(data[at : at + 1])] == found


def test_half_an_arrow_is_no_letter() -> None:
    decoder = KeyDecoder()
    assert decoder.feed(b"\x1b") == []
    assert decoder.feed(b"[") == []
    assert decoder.feed(b"A") == ["up"]


def test_what_is_pasted_is_no_key() -> None:
    assert KeyDecoder().feed(b"\x1b[200~www \x1b[A\x1b[201~e") == ["e"]


@given(st.binary(max_size=300))
def test_any_bytes_are_survived_and_the_keys_after_them_are_heard(data: bytes) -> None:
    decoder = KeyDecoder()
    decoder.feed(data)
    decoder.feed(b"~" * 70 + b"\x1b[201~")
    assert decoder.feed(b" ") == [" "]


FORWARD = (1.0, 0.0, 0.0)
LEFT = (0.0, 0.0, 1.0)


class Bench:
    """A Hold, a clock in steps of 10 ms, and a gate that forgets a command after its timeout."""

    def __init__(self) -> None:
        self.hold = Hold()
        self.now_s = 100.0
        self._command: tuple[float, float, float] = NO_VELOCITY
        self._command_s = 0.0

    def key(self, name: str) -> None:
        self._take(self.hold.pressed([name], self.now_s))

    def _take(self, sent: tuple[float, float, float] | None) -> None:
        if sent is not None:
            self._command, self._command_s = sent, self.now_s

    def wheels(self) -> tuple[float, float, float]:
        return self._command if self.now_s - self._command_s <= COMMAND_S else NO_VELOCITY

    def pass_time(self, seconds: float) -> float:
        """Let time pass; returns how much of it the wheels turned."""
        turned = 0
        for _ in range(round(seconds / 0.01)):
            self.now_s += 0.01
            self._take(self.hold.pressed([], self.now_s))
            turned += self.wheels() != NO_VELOCITY
        return turned * 0.01


def test_a_tap_drives_one_command_timeout() -> None:
    bench = Bench()
    bench.key("w")
    assert bench.wheels() == FORWARD
    assert bench.pass_time(3.0) == pytest.approx(COMMAND_S, abs=0.02)


@pytest.mark.parametrize("delay_s", [0.25, 0.5, 0.66])
def test_a_held_key_drives_again_with_the_first_repeat_and_stops_with_the_last(delay_s: float) -> None:
    bench = Bench()
    bench.key("w")
    assert bench.pass_time(delay_s) == pytest.approx(min(delay_s, COMMAND_S), abs=0.02)
    for _ in range(30):
        bench.key("w")
        assert bench.pass_time(0.03) == pytest.approx(0.03)
    assert bench.pass_time(2.0) <= COMMAND_S, "released"


@pytest.mark.parametrize(("delay_s", "jerks"), [(0.25, False), (0.33, True), (0.5, True), (0.66, True)])
def test_a_keyboard_that_repeats_later_than_a_command_counts_is_noticed(delay_s: float, jerks: bool) -> None:
    bench = Bench()
    bench.key("w")
    bench.pass_time(delay_s)
    bench.key("w")
    assert not bench.hold.jerks, "it may be a second tap"
    bench.pass_time(0.03)
    bench.key("w")
    assert bench.hold.jerks is jerks


@pytest.mark.parametrize(
    "typed", [[("w", 0.5)] * 9, [("w", 0.5), ("a", 0.03), ("a", 0.03)], [("w", 0.9), ("w", 0.03)] * 3]
)
def test_taps_are_no_late_repeats(typed: list[tuple[str, float]]) -> None:
    bench = Bench()
    for key, pause_s in typed:
        bench.key(key)
        bench.pass_time(pause_s)
    assert not bench.hold.jerks


def test_of_several_keys_the_last_one_counts() -> None:
    bench = Bench()
    bench.key("w")
    bench.key("a")
    assert bench.wheels() == LEFT


def test_keys_that_were_held_up_on_the_way_drive_nothing() -> None:
    bench = Bench()
    assert bench.hold.pressed(["w"] * (MOST_AT_ONCE + 1), bench.now_s) is None
    bench.key("w")
    assert bench.hold.pressed(["w"] * (MOST_AT_ONCE + 1), bench.now_s) == NO_VELOCITY
    assert not bench.hold.active


@given(st.lists(st.tuples(st.sampled_from([*AXES, "x"]), st.floats(0.0, 1.0))))
def test_whatever_was_typed_the_wheels_stop_soon_after_the_last_of_it(typed: list[tuple[str, float]]) -> None:
    bench = Bench()
    for name, wait_s in typed:
        bench.key(name)
        bench.pass_time(wait_s)
    bench.pass_time(ENDS_S + 0.02)
    assert bench.wheels() == NO_VELOCITY
    assert bench.pass_time(2.0) == 0


MS = 1_000_000


def answer(question: str, columns: int = 80) -> bytes:
    """As a terminal of this width: the cursor stops at its last column."""
    found = re.fullmatch(r"\x1b\[(\d+);(\d+)H\x1b\[6n", question)
    assert found
    return f"\x1b[{found[1]};{min(int(found[2]), columns)}R".encode()


def test_an_answer_proves_when_it_was_asked() -> None:
    questions = Questions()
    first = questions.ask(100 * MS, 24, 80)
    questions.ask(200 * MS, 24, 80)
    assert questions.proven_ns == 0
    assert questions.typed(answer(first)) == b""
    assert questions.proven_ns == 100 * MS


def test_a_backlog_proves_the_past_alone() -> None:
    questions = Questions()
    asked = [questions.ask(number * 100 * MS, 24, 80) for number in range(1, 51)]
    for number, question in enumerate(asked, 1):
        questions.typed(answer(question))
        assert questions.proven_ns == number * 100 * MS


@given(st.lists(st.integers(2, 70), min_size=1, max_size=4))
def test_a_terminal_of_any_width_proves_every_question_also_after_a_resize(widths: list[int]) -> None:
    questions = Questions()
    for number in range(1, 2 * PLACES + 1):
        columns = widths[number % len(widths)]
        questions.typed(answer(questions.ask(number * MS, 24, columns), columns))
        assert questions.proven_ns == number * MS


def test_an_answer_that_was_lost_holds_up_no_other() -> None:
    questions = Questions()
    asked = [questions.ask(number * MS, 24, 80) for number in range(1, 4)]
    questions.typed(answer(asked[2]))
    assert questions.proven_ns == 3 * MS
    questions.typed(answer(asked[0]))
    assert questions.proven_ns == 3 * MS


@pytest.mark.parametrize("data", [b"\x1b[1;1R", b"\x1b[0n", b"\x1b[99999;2R", b"R", b"\x1b[;R"])
def test_what_answers_nothing_proves_nothing(data: bytes) -> None:
    questions = Questions()
    questions.ask(MS, 24, 80)
    questions.typed(data)
    assert questions.proven_ns == 0


@given(st.lists(st.sampled_from([b"q", b" ", b"x", b"\x1b[A"]), max_size=5), st.integers(0, 40))
def test_keys_and_answers_in_whatever_pieces(keys: list[bytes], cut: int) -> None:
    questions = Questions()
    question = questions.ask(MS, 24, 80)
    data = b"".join(keys) + answer(question) + b"".join(keys)
    typed = questions.typed(data[:cut]) + questions.typed(data[cut:]) + questions.typed(b"")
    assert typed.replace(b"\x1b[A", b"").count(b"q") == 2 * keys.count(b"q")
    assert typed == b"".join(keys) * 2
    assert questions.proven_ns == MS


@given(st.integers(1, PLACES - 1), st.integers(0, 200))
def test_the_right_question_whatever_was_asked_before(open_ones: int, before: int) -> None:
    questions = Questions()
    for number in range(1, before + 1):
        questions.typed(answer(questions.ask(number, 24, 80)))
    asked = [questions.ask(1000 + number, 24, 80) for number in range(open_ones)]
    for number, question in enumerate(asked):
        questions.typed(answer(question))
        assert questions.proven_ns == 1000 + number
