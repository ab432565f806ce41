"""The battery: a low one stops, steps of the voltage at rest are the charger, and the log has a line every 10 s."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.policy.settings import Settings
from failstop.procs.telemetry.battery import (
    HEADER,
    KEPT_APART_NS,
    LOW_READINGS,
    PLUGGED_IN,
    UNDECIDED,
    UNPLUGGED,
    BatteryLog,
    Charger,
    LowBattery,
)

MS = 1_000_000
S = 1_000 * MS
READING_NS = 1_050 * MS
NOON = 1_773_662_400.0
"""2026-03-16 12:00:00 UTC."""


def charger(state: int = UNDECIDED, **changed: object) -> Charger:
    """Disabled since long, with these settings."""
    made = Charger(Settings(changed))
    made.state = state
    made.follow(False, -100 * S)
    return made


def readings(tested: Charger, *values: int, start_ns: int = 0, every_ns: int = S) -> int:
    """Feed one reading a second; returns when the next is due."""
    for i, value in enumerate(values):
        tested.add(value, start_ns + i * every_ns)
    return start_ns + len(values) * every_ns


def settled(state: int = UNDECIDED, **changed: object) -> Charger:
    """A charger's judge that has had 11.8 V for 8 s, with these settings; the next reading is due at 8 s."""
    made = charger(state, **changed)
    readings(made, *[11_800] * 8)
    return made


@pytest.mark.parametrize(("changed", "least_mv"), [({}, 190), ({"battery.step_mv": 500}, 500)])
@pytest.mark.parametrize(("sign", "state"), [(1, PLUGGED_IN), (-1, UNPLUGGED)])
def test_a_step_of_190_mv_or_a_setting_s_is_the_charger(
    changed: dict[str, Any], least_mv: int, sign: int, state: int
) -> None:
    """Motor load makes +-170 mV."""
    for step_mv, found in ((least_mv - 1, UNDECIDED), (least_mv, state)):
        tested = settled(**changed)
        assert tested.state == UNDECIDED
        assert tested.add(11_800 + sign * step_mv, 8 * S) is (found != UNDECIDED)
        assert tested.state == found
    tested, states = charger(), []
    for i in range(-8, 19):  # the board averages: a step of 226 mV and more shows fully after about 3 s
        tested.add(11_800 + round(sign * 249 * max(0.0, min(1.0, i / 3))), 100 * S + i * READING_NS)
        states.append(tested.state)
    assert (states[:9], states[-1], set(states)) == ([UNDECIDED] * 9, state, {UNDECIDED, state})


@pytest.mark.parametrize("before", [(11_800, 11_800, 9_000, *[11_800] * 4), (11_700, 11_900)], ids=["odd", "even"])
def test_the_base_is_the_median(before: tuple[int, ...]) -> None:
    """Of an even number it is the middle of the middle two."""
    tested = charger()
    next_ns = readings(tested, *before) + 3 * S
    assert not tested.add(11_989, next_ns)
    assert tested.add(11_990, next_ns + 1)


@pytest.mark.parametrize(("age_ns", "counts"), [(2 * S, False), (2 * S + 1, True), (8 * S, True), (8 * S + 1, False)])
def test_readings_older_than_2_s_and_of_the_last_8_s_are_the_base(age_ns: int, counts: bool) -> None:
    tested = charger()
    tested.add(11_000, 0)
    assert tested.add(12_000, age_ns) is counts


def test_a_step_counts_not_while_enabled_and_more_than_3_s_after_disabling() -> None:
    tested = settled()
    tested.follow(True, 5 * S)
    assert not tested.add(12_100, 8 * S)
    tested.follow(False, 6 * S)
    tested.follow(False, 8 * S)
    assert not tested.add(12_100, 9 * S), "exactly 3 s is not more"
    assert tested.add(12_100, 9 * S + 1)
    tested = settled(PLUGGED_IN)
    assert not tested.add(12_100, 8 * S), "it is plugged already"
    assert tested.add(11_500, 9 * S)
    assert tested.state == UNPLUGGED


@given(st.lists(st.tuples(st.integers(11_600, 11_789), st.integers(0, 3_000)), max_size=40), st.sampled_from([0, 1, 2]))
def test_a_voltage_that_stays_within_190_mv_never_changes_the_state(steps: list[tuple[int, int]], state: int) -> None:
    tested = charger(state)
    t_ns = 0
    for millivolts, ms in steps:
        t_ns += ms * MS
        assert not tested.add(millivolts, t_ns)
    assert tested.state == state


@pytest.mark.parametrize("every_ns", [10 * MS, 50 * MS, S])
def test_a_step_is_seen_however_often_the_board_reports(every_ns: int) -> None:
    tested = charger()
    next_ns = readings(tested, *[11_800] * (20 * S // every_ns), every_ns=every_ns)
    readings(tested, *[12_049] * (3 * S // every_ns), start_ns=next_ns, every_ns=every_ns)
    assert tested.state == PLUGGED_IN


def test_of_readings_that_come_together_one_is_kept() -> None:
    """A flood counts as one reading in the median, and the next one as another."""
    tested = charger()
    readings(tested, 11_000, *[11_800] * 5_000, every_ns=1)
    readings(tested, 11_001, start_ns=KEPT_APART_NS)
    assert not tested.add(11_190, 5 * S)
    assert tested.add(11_191, 5 * S)


@pytest.mark.parametrize(("stop_mv", "stops"), [(-1, False), (1000, True), (60_000, True)])
def test_a_low_battery_stops_with_any_setting_but_minus_1(stop_mv: int, stops: bool) -> None:
    assert LowBattery(Settings({"battery.stop_mv": stop_mv})).stops is stops


class Drained:
    """A battery that is judged with stops below 10.5 V."""

    def __init__(self) -> None:
        self.judge = LowBattery(Settings({"battery.stop_mv": 10_500}))
        self.now_ns = 0

    def stays(self, millivolts: int, for_ns: int, every_ns: int = S) -> list[tuple[int, str]]:
        """Stops while readings with this voltage come for so long, the last one at the end: when, since the first
        reading, and why."""
        begun_ns, stops = self.now_ns, []
        while self.now_ns <= begun_ns + for_ns:
            if cause := self.judge.add(millivolts, self.now_ns):
                stops.append((self.now_ns - begun_ns, str(cause)))
            self.now_ns += every_ns
        return stops


@pytest.mark.parametrize(
    ("every_ns", "after_ns"),
    [
        *((10 * MS, 5 * S), (50 * MS, 5 * S), (1_050 * MS, 5_250 * MS), (2 * S, 8 * S)),
        *((5 * S, 20 * S), (7 * S, 28 * S), (60 * S, 240 * S)),
    ],
)
def test_a_battery_that_stays_low_for_5_s_and_5_readings_stops(every_ns: int, after_ns: int) -> None:
    tested = Drained()
    assert tested.stays(10_400, after_ns - 1, every_ns) == [], "a sag, as motors that start make it"
    assert tested.stays(10_500, 0, every_ns) == [], "not low, so the time begins again"
    assert tested.stays(10_499, 60 * S + after_ns, every_ns) == [(after_ns, "the battery is at 10.50 V")]
    assert LOW_READINGS == 5
    silent = LowBattery(Settings())
    assert {silent.add(0, at * S) for at in range(20)} == {None}, "no setting asks for it"


def test_a_battery_stops_again_only_after_a_charge() -> None:
    tested = Drained()
    assert tested.stays(10_400, 5 * S) == [(5 * S, "the battery is at 10.40 V")]
    for _ in range(3):
        assert tested.stays(11_000, 600 * S) == [], "it recovers while the robot is parked"
        assert tested.stays(10_490, 600 * S) == [], "and drops on the way to the charger"
    for dip_mv in (11_549, 10_499):
        tested.stays(11_550, 59 * S)
        tested.stays(dip_mv, 0)
        tested.stays(11_550, 59 * S)
        assert tested.stays(10_400, 60 * S) == [], f"not high for a minute on end ({dip_mv})"
    tested.stays(11_550, 60 * S)
    assert tested.stays(11_000, 3_600 * S) == [], "used up"
    assert tested.stays(10_400, 60 * S) == [(5 * S, "the battery is at 10.40 V")]
    assert tested.stays(11_000, 3_600 * S) == []
    assert tested.stays(10_400, 60 * S) == []


def log(**changed: object) -> BatteryLog:
    return BatteryLog(Settings({f"battery.{key}": value for key, value in changed.items()}))


@pytest.mark.parametrize(
    ("every_ns", "away_ns", "again"),
    [(S, 5 * S - 1, False), (S, 5 * S, True), (10 * S, 30 * S - 1, False), (10 * S, 30 * S, True)],
)
def test_a_battery_that_was_away_may_have_been_swapped(every_ns: int, away_ns: int, again: bool) -> None:
    """A charged one may be less than 10 % above the setting."""
    tested = LowBattery(Settings({"battery.stop_mv": 12_800}))
    stops = [tested.add(12_700, number * every_ns) for number in range(7)]
    assert any(stops)
    back_ns = 6 * every_ns + away_ns
    assert [tested.add(13_300, back_ns + number * every_ns) for number in range(70)] == [None] * 70
    found = [tested.add(12_700, back_ns + (70 + number) * every_ns) for number in range(6)]
    assert any(found) is again


def test_reports_that_come_in_pairs_and_seldom_are_one_battery() -> None:
    tested = LowBattery(Settings({"battery.stop_mv": 10_500}))
    times_ns = [at * 10 * S + late * MS for at in range(5) for late in (0, 20)]
    assert any(tested.add(10_400, t_ns) for t_ns in times_ns)


def test_a_line_is_unix_time_mv_wheels_enabled_in_one_file_a_day() -> None:
    assert HEADER == "unix_s,battery_mv,enabled\n"
    for enabled, after_s, line, day in (
        (True, 0.0, "1773662400.0,11832,1\n", 16),
        (False, 0.25, "1773662400.2,11832,0\n", 16),
        *((False, after_s, f"{NOON + after_s:.1f},11832,0\n", day) for after_s, day in ((43_199.9, 16), (43_200, 17))),
        (False, 129_599.9, f"{NOON + 129_599.9:.1f},11832,0\n", 17),
    ):
        assert log().add(11_832, enabled, 0, NOON + after_s) == (f"battery-2026-03-{day}.csv", line)


@pytest.mark.parametrize(
    ("changed", "times_ns", "lines"),
    [
        ({}, (5 * S, 15 * S - 1, 15 * S), [True, False, True]),
        ({}, (0, 95 * S, 104 * S, 105 * S), [True, True, False, True]),
        ({}, (0, 20 * S, 30 * S - 1, 30 * S), [True, True, False, True]),
        ({"log_s": 60.0}, (0, 59 * S, 60 * S), [True, False, True]),
        ({"log": "off"}, (0,), [False]),
        ({}, tuple(i * READING_NS for i in range(600)), [i * 105 // 1000 > (i - 1) * 105 // 1000 for i in range(600)]),
    ],
    ids=[
        "not sooner",
        "none is made up for after a silence",
        "one at the very time of the next",
        "its period",
        "off",
        "every 10 s",
    ],
)
def test_a_line_is_due_a_period_on(changed: dict[str, object], times_ns: tuple[int, ...], lines: list[bool]) -> None:
    tested = log(**changed)
    assert [tested.add(11_800, False, t_ns, NOON) is not None for t_ns in times_ns] == lines
