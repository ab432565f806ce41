"""Charger detection: steps of the battery voltage, at rest only."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.policy.settings import Settings
from failstop.procs.telemetry.charger import PLUGGED, UNKNOWN, UNPLUGGED, Charger
from failstop.shm import records

MS = 1_000_000
S = 1_000 * MS
READING_NS = 1_050 * MS


def charger(state: int = UNKNOWN) -> Charger:
    """Disabled since long, with the setting's default."""
    made = Charger(Settings()["battery.step_mv"], state)
    made.follow(False, -100 * S)
    return made


def readings(tested: Charger, *values: int, start_ns: int = 0, every_ns: int = S) -> int:
    """Feed one reading a second; returns when the next is due."""
    for i, value in enumerate(values):
        tested.take(value, start_ns + i * every_ns)
    return start_ns + len(values) * every_ns


def averaged(tested: Charger, step_mv: int, *, seconds: int = 20) -> list[int]:
    """As the board sends it: a reading every 1.05 s, and the step shows fully after about 3 s. Returns the states."""
    states = []
    for i in range(-8, round(seconds / 1.05)):
        shown = max(0.0, min(1.0, i / 3))
        tested.take(11_800 + round(step_mv * shown), 100 * S + i * READING_NS)
        states.append(tested.state)
    return states


def test_unknown_until_a_step_is_seen() -> None:
    tested = charger()
    readings(tested, *[11_800] * 60)
    assert tested.state == UNKNOWN


def test_a_step_of_190_mv_up_is_plugged() -> None:
    tested = charger()
    next_ns = readings(tested, *[11_800] * 8)
    assert tested.take(11_990, next_ns)
    assert tested.state == PLUGGED


def test_a_step_of_190_mv_down_is_unplugged() -> None:
    tested = charger()
    next_ns = readings(tested, *[11_800] * 8)
    assert tested.take(11_610, next_ns)
    assert tested.state == UNPLUGGED


@pytest.mark.parametrize("step_mv", [189, -189, 170, -170])
def test_less_is_no_step(step_mv: int) -> None:
    """Motor load makes +-170 mV."""
    tested = charger()
    next_ns = readings(tested, *[11_800] * 8)
    assert not tested.take(11_800 + step_mv, next_ns)
    assert tested.state == UNKNOWN


@pytest.mark.parametrize(("step_mv", "state"), [(249, PLUGGED), (-226, UNPLUGGED)])
def test_what_was_measured_is_seen_once_through_the_boards_averaging(step_mv: int, state: int) -> None:
    states = averaged(charger(), step_mv)
    assert states[:9] == [UNKNOWN] * 9
    assert states[-1] == state
    assert set(states) == {UNKNOWN, state}


def test_the_base_is_the_median_and_not_the_mean() -> None:
    tested = charger()
    next_ns = readings(tested, 11_800, 11_800, 9_000, 11_800, 11_800, 11_800, 11_800)
    assert not tested.take(11_900, next_ns)
    assert tested.take(11_990, next_ns + 1)


def test_the_median_of_an_even_number_is_the_middle_of_the_middle_two() -> None:
    tested = charger()
    readings(tested, 11_700, 11_900)
    assert not tested.take(11_989, 5 * S)
    assert tested.take(11_990, 5 * S + 1)


def test_only_readings_older_than_2_s_are_the_base() -> None:
    tested = charger()
    tested.take(11_000, 0)
    assert not tested.take(12_000, 2 * S), "exactly 2 s is not older"
    fresh = charger()
    fresh.take(11_000, 0)
    assert fresh.take(12_000, 2 * S + 1)


def test_only_readings_of_the_last_8_s_are_the_base() -> None:
    tested = charger()
    tested.take(11_000, 0)
    assert not tested.take(12_000, 8 * S + 1)
    fresh = charger()
    fresh.take(11_000, 0)
    assert fresh.take(12_000, 8 * S)


def test_not_while_enabled() -> None:
    tested = charger()
    next_ns = readings(tested, *[11_800] * 8)
    tested.follow(True, next_ns)
    assert not tested.take(12_100, next_ns)
    assert tested.state == UNKNOWN


def test_only_more_than_3_s_after_disabling() -> None:
    tested = charger()
    readings(tested, *[11_800] * 8)
    tested.follow(True, 5 * S)
    tested.follow(False, 6 * S)
    tested.follow(False, 8 * S)
    assert not tested.take(12_100, 9 * S), "exactly 3 s is not more"
    assert tested.take(12_100, 9 * S + 1)


def test_the_last_state_is_kept() -> None:
    tested = charger(PLUGGED)
    readings(tested, *[11_800] * 8)
    assert tested.state == PLUGGED
    assert not tested.take(12_100, 8 * S), "it is plugged already"
    assert tested.take(11_500, 9 * S)
    assert tested.state == UNPLUGGED


def test_a_step_is_told_once() -> None:
    tested = charger()
    next_ns = readings(tested, *[11_800] * 8)
    assert [tested.take(12_100, next_ns + i * S) for i in range(20)] == [True] + [False] * 19


def test_the_setting_is_the_step() -> None:
    tested = Charger(Settings({"battery.step_mv": 500})["battery.step_mv"])
    tested.follow(False, -100 * S)
    next_ns = readings(tested, *[11_800] * 8)
    assert not tested.take(12_299, next_ns)
    assert tested.take(12_300, next_ns + 1)


def test_the_states_have_names() -> None:
    assert [records.PLUGGED[state] for state in (UNKNOWN, PLUGGED, UNPLUGGED)] == ["unknown", "plugged", "unplugged"]


@given(st.lists(st.tuples(st.integers(11_600, 11_789), st.integers(0, 3_000)), max_size=80), st.sampled_from([0, 1, 2]))
def test_a_voltage_that_stays_within_190_mv_never_changes_the_state(steps: list[tuple[int, int]], state: int) -> None:
    tested = charger(state)
    t_ns = 0
    for millivolts, ms in steps:
        t_ns += ms * MS
        assert not tested.take(millivolts, t_ns)
    assert tested.state == state


@given(st.lists(st.tuples(st.integers(0, 65_535), st.integers(0, 3_000)), max_size=80))
def test_never_while_enabled_whatever_the_voltage(steps: list[tuple[int, int]]) -> None:
    tested = charger()
    t_ns = 0
    tested.follow(True, 0)
    for millivolts, ms in steps:
        t_ns += ms * MS
        assert not tested.take(millivolts, t_ns)


def test_a_flood_of_readings_is_forgotten() -> None:
    tested = charger()
    readings(tested, *[11_800] * 5_000, every_ns=1_000)
    assert len(tested._readings) <= 65
