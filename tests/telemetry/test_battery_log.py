"""The battery log: a line every 10 s, one file a day."""

from __future__ import annotations

from failstop.policy.settings import Settings
from failstop.procs.telemetry.battery_log import HEADER, BatteryLog

S = 1_000_000_000
READING_NS = 1_050_000_000
NOON = 1_773_662_400.0
"""2026-03-16 12:00:00 UTC."""


def log(**changed: object) -> BatteryLog:
    settings = Settings({f"battery.{key}": value for key, value in changed.items()})
    return BatteryLog(settings["battery.log_s"], on=settings.on("battery.log"))


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
