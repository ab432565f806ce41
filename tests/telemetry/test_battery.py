"""The battery: a low one stops, steps of the voltage at rest are the charger, and the log has a line every 10 s."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.messages import records
from failstop.policy.settings import Settings
from failstop.procs.telemetry.battery import (
    HEADER,
    LOW_READINGS,
    MOST_READINGS,
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
    made = Charger(Settings(changed), state)
    made.follow(False, -100 * S)
    return made


def readings(tested: Charger, *values: int, start_ns: int = 0, every_ns: int = S) -> int:
    """Feed one reading a second; returns when the next is due."""
    for i, value in enumerate(values):
        tested.take(value, start_ns + i * every_ns)
    return start_ns + len(values) * every_ns


def settled(state: int = UNDECIDED, **changed: object) -> Charger:
    """A charger's judge that has had 11.8 V for 8 s, with these settings; the next reading is due at 8 s."""
    made = charger(state, **changed)
    readings(made, *[11_800] * 8)
    return made


def averaged(tested: Charger, step_mv: int, *, seconds: int = 20) -> list[int]:
    """As the board sends it: a reading every 1.05 s, and the step shows fully after about 3 s. Returns the states."""
    states = []
    for i in range(-8, round(seconds / 1.05)):
        shown = max(0.0, min(1.0, i / 3))
        tested.take(11_800 + round(step_mv * shown), 100 * S + i * READING_NS)
        states.append(tested.state)
    return states


@pytest.mark.parametrize(
    ("step_mv", "state"), [(190, PLUGGED_IN), (-190, UNPLUGGED), (189, UNDECIDED), (-189, UNDECIDED), (0, UNDECIDED)]
)
def test_a_step_of_190_mv_is_the_charger_and_less_is_none(step_mv: int, state: int) -> None:
    """Motor load makes +-170 mV."""
    tested = settled()
    assert tested.state == UNDECIDED
    assert tested.take(11_800 + step_mv, 8 * S) is (state != UNDECIDED)
    assert tested.state == state


@pytest.mark.parametrize(("step_mv", "state"), [(249, PLUGGED_IN), (-226, UNPLUGGED)])
def test_what_was_measured_is_seen_once_through_the_boards_averaging(step_mv: int, state: int) -> None:
    states = averaged(charger(), step_mv)
    assert states[:9] == [UNDECIDED] * 9
    assert states[-1] == state
    assert set(states) == {UNDECIDED, state}


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


def test_a_step_while_enabled_is_none() -> None:
    tested = settled()
    tested.follow(True, 8 * S)
    assert not tested.take(12_100, 8 * S)
    assert tested.state == UNDECIDED


def test_only_more_than_3_s_after_disabling() -> None:
    tested = settled()
    tested.follow(True, 5 * S)
    tested.follow(False, 6 * S)
    tested.follow(False, 8 * S)
    assert not tested.take(12_100, 9 * S), "exactly 3 s is not more"
    assert tested.take(12_100, 9 * S + 1)


def test_the_last_state_is_kept() -> None:
    tested = settled(PLUGGED_IN)
    assert tested.state == PLUGGED_IN
    assert not tested.take(12_100, 8 * S), "it is plugged already"
    assert tested.take(11_500, 9 * S)
    assert tested.state == UNPLUGGED


def test_a_step_is_told_once() -> None:
    tested = settled()
    assert [tested.take(12_100, (8 + i) * S) for i in range(20)] == [True] + [False] * 19


def test_the_setting_is_the_step() -> None:
    tested = settled(**{"battery.step_mv": 500})
    assert not tested.take(12_299, 8 * S)
    assert tested.take(12_300, 8 * S + 1)


def test_the_states_have_names() -> None:
    assert [records.PLUGGED[state] for state in (UNDECIDED, PLUGGED_IN, UNPLUGGED)] == [
        "unknown",
        "plugged",
        "unplugged",
    ]


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
    """The base is the median of the newest readings alone, however few of all they are."""
    tested = charger()
    readings(tested, *[11_000] * 5_000, *[11_800] * (MOST_READINGS // 2 + 1), every_ns=1_000)
    assert not tested.take(11_989, 5 * S)
    assert tested.take(11_990, 5 * S)


def test_a_battery_that_stays_low_stops_once_until_it_was_charged() -> None:
    tested = LowBattery(Settings({"battery.stop_mv": 10_500}))
    readings = (
        [10_400] * (LOW_READINGS - 1) + [10_500] + [10_499] * (2 * LOW_READINGS) + [11_000] + [9_000] * LOW_READINGS
    )
    stops = [at for at, millivolts in enumerate(readings) if tested.take(millivolts)]
    assert stops == [2 * LOW_READINGS - 1, len(readings) - 1]


def test_who_finds_the_robot_stopped_reads_the_volts_that_stopped_it() -> None:
    tested = LowBattery(Settings({"battery.stop_mv": 10_500}))
    assert [str(tested.take(10_490)) for _ in range(LOW_READINGS)][-1] == "the battery is at 10.49 V"


def test_without_its_setting_no_battery_stops() -> None:
    tested = LowBattery(Settings())
    assert [tested.take(0) for _ in range(2 * LOW_READINGS)] == [None] * (2 * LOW_READINGS)


def log(**changed: object) -> BatteryLog:
    settings = Settings({f"battery.{key}": value for key, value in changed.items()})
    return BatteryLog(settings)


def test_a_line_is_unix_time_mv_wheels_enabled() -> None:
    assert log().take(11_832, True, 0, NOON) == ("battery-2026-03-16.csv", "1773662400.0,11832,1\n")
    assert log().take(11_832, False, 0, NOON + 0.25) == ("battery-2026-03-16.csv", "1773662400.2,11832,0\n")
    assert HEADER == "unix_s,battery_mv,enabled\n"


def test_a_line_every_10_s() -> None:
    tested = log()
    taken = [bool(tested.take(11_800, False, i * READING_NS, NOON)) for i in range(600)]
    assert sum(taken) == 63, "in 629 s, the first at once"
    at_s = [i * 1.05 for i, line in enumerate(taken) if line]
    for n, t_s in enumerate(at_s):
        assert 10 * n <= t_s < 10 * n + 1.05


def test_not_sooner() -> None:
    tested = log()
    assert tested.take(11_800, False, 5 * S, NOON)
    assert not tested.take(11_800, False, 15 * S - 1, NOON)
    assert tested.take(11_800, False, 15 * S, NOON)


def test_after_a_silence_lines_are_not_made_up_for() -> None:
    tested = log()
    tested.take(11_800, False, 0, NOON)
    assert tested.take(11_800, False, 95 * S, NOON)
    assert not tested.take(11_800, False, 104 * S, NOON)
    assert tested.take(11_800, False, 105 * S, NOON)


def test_a_reading_at_the_very_time_of_the_next_line_writes_one_line() -> None:
    """Else every such meeting puts a second line into the file, a reading later."""
    tested = log()
    tested.take(11_800, False, 0, NOON)
    assert tested.take(11_800, False, 20 * S, NOON)
    assert not tested.take(11_800, False, 30 * S - 1, NOON)
    assert tested.take(11_800, False, 30 * S, NOON)


def test_one_file_a_day() -> None:
    tested = log()
    names = [(tested.take(1, False, i * 10 * S, NOON + i * 10) or ("", ""))[0] for i in range(8_640)]
    assert sorted(set(names)) == ["battery-2026-03-16.csv", "battery-2026-03-17.csv"]
    assert names.index("battery-2026-03-17.csv") == 12 * 360


def test_the_settings_change_the_period_and_switch_it_off() -> None:
    tested = log(log_s=60.0)
    tested.take(1, False, 0, NOON)
    assert not tested.take(1, False, 59 * S, NOON)
    assert tested.take(1, False, 60 * S, NOON)
    assert log(log="off").take(1, False, 0, NOON) is None
