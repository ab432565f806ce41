"""The bytes of keys, in both of a terminal's languages, whole and in pieces; hold-to-run by a fake clock: what the
wheels are told for them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.cli.screen.keys import (
    AXES,
    COMMAND_S,
    ENDS_S,
    EVENTS,
    FIRST_REPEAT_S,
    FOCUS_OUT,
    MOST_AT_ONCE,
    PRESS,
    RELEASE,
    REPEAT,
    STILL,
    Decoder,
    Hold,
    Key,
)

PLAIN: tuple[tuple[bytes, list[Key]], ...] = (
    (b"w", [("w", PRESS)]),
    (b"W", [("w", PRESS)]),
    (b" ", [("space", PRESS)]),
    (b"\x1b[A\x1b[B\x1b[C\x1b[D", [("up", PRESS), ("down", PRESS), ("right", PRESS), ("left", PRESS)]),
    (b"\x1bOA", [("up", PRESS)]),
    (b"\x1b[1;2C", [("right", PRESS)]),
    (b"\r", [("enter", PRESS)]),
    (b"\x04", [("ctrl+d", PRESS)]),
    ("é".encode(), [("é", PRESS)]),
    (b"\xe2 ", [("space", PRESS)]),
    (b"\xe2\x1b[A", [("up", PRESS)]),
    (b"\x1b[O", [(FOCUS_OUT, PRESS)]),
    (b"\x1b[I", []),
    (b"\x1bw", [("esc", PRESS), ("w", PRESS)]),
    (b"\x1b[3~\x1b[15~", []),
    (b"\x1b[?62;c", []),
)
KITTY: tuple[tuple[bytes, list[Key]], ...] = (
    (b"\x1b[119u", [("w", PRESS)]),
    (b"\x1b[119;1:1u\x1b[119;1:2u\x1b[119;1:3u", [("w", PRESS), ("w", REPEAT), ("w", RELEASE)]),
    (b"\x1b[119:87;2u", [("w", PRESS)]),
    (b"\x1b[61:43;2:1u", [("+", PRESS)]),
    (b"\x1b[1;1:3A", [("up", RELEASE)]),
    (b"\x1b[99;5u\x1b[122;5:1u", [("ctrl+c", PRESS), ("ctrl+z", PRESS)]),
    (b"\x1b[32;1:1u", [("space", PRESS)]),
    (b"\x1b[57441;2:1u", [("\ue061", PRESS)]),
    (b"\x1b[?15u", [(EVENTS, PRESS)]),
    (b"\x1b[?1u", []),
    (b"\x1b[?0u", []),
)


@pytest.mark.parametrize(("data", "found"), PLAIN + KITTY)
def test_keys(data: bytes, found: list[Key]) -> None:
    assert Decoder().feed(data) == found


@pytest.mark.parametrize(("data", "found"), PLAIN + KITTY)
def test_keys_that_come_byte_by_byte(data: bytes, found: list[Key]) -> None:
    decoder = Decoder()
    assert [key for at in range(len(data)) for key in decoder.feed(data[at : at + 1])] == found


def test_half_an_arrow_is_no_letter() -> None:
    decoder = Decoder()
    assert decoder.feed(b"\x1b") == []
    assert decoder.feed(b"[") == []
    assert decoder.feed(b"A") == [("up", PRESS)]


def test_what_is_pasted_is_no_key() -> None:
    assert Decoder().feed(b"\x1b[200~www \x1b[A\x1b[201~e") == [("e", PRESS)]


@given(st.binary(max_size=300))
def test_any_bytes_are_survived_and_the_keys_after_them_are_heard(data: bytes) -> None:
    decoder = Decoder()
    decoder.feed(data)
    decoder.feed(b"~" * 70 + b"\x1b[201~")
    assert decoder.feed(b" ") == [("space", PRESS)]


@given(st.integers(), st.integers(0, 9))
def test_numbers_out_of_range_are_no_keys_that_move(code: int, kind: int) -> None:
    found = Decoder().feed(f"\x1b[{abs(code)};1:{kind}u".encode())
    assert all(name not in AXES or abs(code) < 128 for name, _ in found)


FORWARD = (1.0, 0.0, 0.0)
LEFT = (0.0, 0.0, 1.0)


class Bench:
    """A Hold, a clock in steps of 10 ms, and a gate that forgets a command after its timeout."""

    def __init__(self, *, releases: bool) -> None:
        self.hold = Hold()
        self.hold.releases = releases
        self.now_s = 100.0
        self._command: tuple[float, float, float] = STILL
        self._command_s = 0.0

    def key(self, name: str, kind: int = PRESS) -> None:
        self._take(self.hold.events([(name, kind)], self.now_s))

    def _take(self, sent: tuple[float, float, float] | None) -> None:
        if sent is not None:
            self._command, self._command_s = sent, self.now_s

    def wheels(self) -> tuple[float, float, float]:
        return self._command if self.now_s - self._command_s <= COMMAND_S else STILL

    def pass_time(self, seconds: float) -> float:
        """Let time pass; returns how much of it the wheels turned."""
        turned = 0
        for _ in range(round(seconds / 0.01)):
            self.now_s += 0.01
            self._take(self.hold.events([], self.now_s))
            turned += self.wheels() != STILL
        return turned * 0.01


def test_a_tap_drives_one_command_timeout() -> None:
    bench = Bench(releases=False)
    bench.key("w")
    assert bench.wheels() == FORWARD
    assert bench.pass_time(3.0) == pytest.approx(COMMAND_S, abs=0.02)


@pytest.mark.parametrize("delay_s", [0.25, 0.5, 0.66])
def test_a_held_key_drives_again_with_the_first_repeat_and_stops_with_the_last(delay_s: float) -> None:
    bench = Bench(releases=False)
    bench.key("w")
    assert bench.pass_time(delay_s) == pytest.approx(min(delay_s, COMMAND_S), abs=0.02)
    for _ in range(30):
        bench.key("w")
        assert bench.pass_time(0.03) == pytest.approx(0.03)
    assert bench.pass_time(2.0) <= COMMAND_S, "released"


@pytest.mark.parametrize("delay_s", [0.25, 0.5, 0.66])
def test_with_releases_a_held_key_drives_without_a_gap_and_stops_at_once(delay_s: float) -> None:
    bench = Bench(releases=True)
    bench.key("w")
    assert bench.pass_time(delay_s) == pytest.approx(delay_s)
    for _ in range(20):
        bench.key("w", REPEAT)
        assert bench.pass_time(0.03) == pytest.approx(0.03)
    bench.key("w", RELEASE)
    assert bench.wheels() == STILL
    assert bench.pass_time(1.0) == 0


def test_a_release_that_got_lost_ends_where_repeats_should_have_begun() -> None:
    bench = Bench(releases=True)
    bench.key("w")
    assert bench.pass_time(5.0) <= FIRST_REPEAT_S + ENDS_S


def test_repeats_that_end_without_a_release_stop_too() -> None:
    """A connection that died while a key was held."""
    bench = Bench(releases=True)
    bench.key("w")
    bench.pass_time(0.5)
    bench.key("w", REPEAT)
    assert bench.pass_time(5.0) <= ENDS_S


def test_two_keys_at_once_where_releases_are_told() -> None:
    bench = Bench(releases=True)
    bench.key("w")
    bench.key("a")
    assert bench.wheels() == (1.0, 0.0, 1.0)
    bench.key("w", RELEASE)
    assert bench.wheels() == LEFT
    bench.key("a", RELEASE)
    assert bench.wheels() == STILL


def test_opposite_keys_are_zero_and_twins_are_not_twice() -> None:
    bench = Bench(releases=True)
    bench.key("w")
    bench.key("up")
    assert bench.wheels() == FORWARD
    bench.key("s")
    bench.key("down")
    assert bench.wheels() == STILL


def test_where_keys_only_repeat_the_last_one_counts() -> None:
    bench = Bench(releases=False)
    bench.key("w")
    bench.key("a")
    assert bench.wheels() == LEFT


def test_the_window_lost_the_focus() -> None:
    bench = Bench(releases=True)
    bench.key("w")
    bench.key(FOCUS_OUT)
    assert bench.wheels() == STILL
    bench.key("w", REPEAT)
    assert bench.wheels() == STILL, "it counts again when it is pressed again"


def test_keys_that_were_held_up_on_the_way_drive_nothing() -> None:
    bench = Bench(releases=False)
    assert bench.hold.events([("w", PRESS)] * (MOST_AT_ONCE + 1), bench.now_s) is None
    bench.key("w")
    assert bench.hold.events([("w", PRESS)] * (MOST_AT_ONCE + 1), bench.now_s) == STILL
    assert not bench.hold.active


keys = st.tuples(st.sampled_from([*AXES, FOCUS_OUT]), st.sampled_from([PRESS, REPEAT, RELEASE]))


@given(st.booleans(), st.lists(st.tuples(keys, st.floats(0.0, 1.0))))
def test_whatever_was_typed_the_wheels_stop_soon_after_the_last_of_it(
    releases: bool, typed: list[tuple[Key, float]]
) -> None:
    bench = Bench(releases=releases)
    for (name, kind), wait_s in typed:
        bench.key(name, kind)
        bench.pass_time(wait_s)
    bench.pass_time((FIRST_REPEAT_S if releases else 0.0) + ENDS_S + 0.02)
    assert bench.wheels() == STILL
    assert bench.pass_time(2.0) == 0
