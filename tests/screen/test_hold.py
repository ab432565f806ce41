"""Hold-to-run by a fake clock: what a terminal sends, and what the wheels are told for it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.cli.screen.hold import AXES, COMMAND_S, ENDS_S, FIRST_REPEAT_S, MOST_AT_ONCE, STILL, Hold
from failstop.cli.screen.keys import FOCUS_OUT, PRESS, RELEASE, REPEAT, Key

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
            self._take(self.hold.due(self.now_s))
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
