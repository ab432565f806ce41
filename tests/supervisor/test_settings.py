"""Settings: every value that is not allowed is refused by a message that names the key, the value and what is."""

from __future__ import annotations

from itertools import product
from math import inf, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.board.codec import RPS_CEILING
from failstop.procs.gate.kinematics import Mecanum
from failstop.supervisor.settings import BY_KEY, DECLARED, Setting, SettingError, Settings

NUMBERS = [setting for setting in DECLARED if not isinstance(setting.default, str)]
WHOLE = [setting for setting in DECLARED if isinstance(setting.default, int)]
TEXTS = [setting for setting in DECLARED if isinstance(setting.default, str)]
ROUNDING_OF_LIMITS = 1.001


def refusal(**changed: object) -> str:
    with pytest.raises(SettingError) as raised:
        Settings({key.replace("__", "."): value for key, value in changed.items()})
    return str(raised.value)


# Declarations.


def test_each_setting_is_declared_once() -> None:
    assert len(BY_KEY) == len(DECLARED)


@pytest.mark.parametrize("setting", DECLARED, ids=lambda setting: setting.key)
def test_each_declaration_is_whole(setting: Setting) -> None:
    assert setting.doc
    assert setting.check(setting.default) == setting.default
    section, _, name = setting.key.partition(".")
    assert section.isidentifier()
    assert name.isidentifier()
    unit = {"_s": "s", "_m": "m", "_mps": "m/s", "_radps": "rad/s", "_mps2": "m/s2", "_radps2": "rad/s2"}
    ending = "_" + name.rpartition("_")[2]
    assert setting.unit == unit.get(ending, ""), "the unit is in the name"


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("gate.period_s", 0.02),
        ("gate.command_timeout_s", 0.3),
        ("gate.refresh_s", 0.2),
        ("gate.lease_s", 0.06),
        ("limits.vx_mps", 0.2),
        ("limits.vy_mps", 0.2),
        ("limits.wz_radps", 1.0),
        ("limits.acceleration_mps2", 0.5),
        ("limits.acceleration_radps2", 2.0),
        ("wheels.diameter_m", 0.08),
        ("wheels.wheelbase_m", 0.17706),
        ("wheels.track_m", 0.17165),
        ("restart.deaths", 5),
        ("restart.window_s", 60.0),
        ("key.stop", 1),
    ],
)
def test_the_approved_defaults(key: str, value: float) -> None:
    assert Settings()[key] == value


# What is refused.


def test_an_unknown_key() -> None:
    assert refusal(gate__perod_s=0.02) == "gate.perod_s: no such setting; `failstop config` lists them all"


@pytest.mark.parametrize("value", ["0.02", None, [0.02], {}, True, False, b"1"])
@pytest.mark.parametrize("setting", NUMBERS, ids=lambda setting: setting.key)
def test_a_number_of_another_type(setting: Setting, value: object) -> None:
    with pytest.raises(SettingError) as raised:
        Settings({setting.key: value})
    assert str(raised.value) == f"{setting.key} = {value!r}: a number is expected, {setting.range()}"


@pytest.mark.parametrize("value", [1, 1.5, None, True, [], "", "two\nlines", "a\0b", "tab\t", "\u2028"])
@pytest.mark.parametrize("setting", TEXTS, ids=lambda setting: setting.key)
def test_a_text_of_another_type_or_empty_or_not_of_one_line(setting: Setting, value: object) -> None:
    with pytest.raises(SettingError) as raised:
        Settings({setting.key: value})
    assert str(raised.value) == f"{setting.key} = {value!r}: a text is expected"


@pytest.mark.parametrize("value", [nan, inf, -inf, 1e308, -1e308, -1, 10**400])
@pytest.mark.parametrize("setting", NUMBERS, ids=lambda setting: setting.key)
def test_a_number_out_of_range(setting: Setting, value: float) -> None:
    with pytest.raises(SettingError) as raised:
        Settings({setting.key: value})
    assert str(raised.value) == f"{setting.key} = {value!r}: allowed is {setting.range()}"


@pytest.mark.parametrize("setting", NUMBERS, ids=lambda setting: setting.key)
def test_the_range_ends_exactly_there(setting: Setting) -> None:
    assert setting.low is not None
    assert setting.high is not None
    assert setting.check(setting.low) == setting.low
    assert setting.check(setting.high) == setting.high
    step = 1 if isinstance(setting.default, int) else 1e-9
    for beyond in (setting.low - step, setting.high + step):
        with pytest.raises(SettingError, match="allowed is"):
            setting.check(beyond)


def test_the_message_for_a_value_out_of_range() -> None:
    assert refusal(gate__lease_s=9.0) == "gate.lease_s = 9.0: allowed is 0.02 to 1 s"
    assert refusal(restart__deaths=0) == "restart.deaths = 0: allowed is 1 to 100000"


@pytest.mark.parametrize("setting", WHOLE, ids=lambda setting: setting.key)
def test_a_whole_number(setting: Setting) -> None:
    assert setting.check(5.0) == 5
    assert type(setting.check(5.0)) is int
    with pytest.raises(SettingError) as raised:
        setting.check(5.5)
    assert str(raised.value) == f"{setting.key} = 5.5: a whole number is expected, {setting.range()}"


def test_a_whole_number_will_do_where_any_number_is_expected() -> None:
    settings = Settings({"limits.vx_mps": 1})
    assert settings["limits.vx_mps"] == 1.0
    assert type(settings["limits.vx_mps"]) is float


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (
            {"gate.lease_s": 0.4},
            "gate.command_timeout_s = 0.3 s must be longer than gate.lease_s = 0.4 s",
        ),
        (
            {"gate.lease_s": 0.3},
            "gate.command_timeout_s = 0.3 s must be longer than gate.lease_s = 0.3 s",
        ),
        (
            {"gate.period_s": 0.05, "gate.lease_s": 0.05},
            "gate.lease_s = 0.05 s must be longer than gate.period_s = 0.05 s",
        ),
        (
            {"gate.period_s": 0.05, "gate.lease_s": 0.02, "gate.command_timeout_s": 0.05},
            "gate.lease_s = 0.02 s must be longer than gate.period_s = 0.05 s",
        ),
    ],
)
def test_values_that_contradict_each_other(changed: dict[str, object], message: str) -> None:
    with pytest.raises(SettingError) as raised:
        Settings(changed)
    assert str(raised.value) == message


# Reading values.


def test_times_as_nanoseconds() -> None:
    assert Settings().ns("gate.period_s") == 20_000_000
    assert Settings({"gate.command_timeout_s": 0.123456789}).ns("gate.command_timeout_s") == 123_456_789


def test_texts() -> None:
    assert Settings({"device.path": "/dev/board"}).text("device.path") == "/dev/board"
    with pytest.raises(TypeError, match=r"device\.path is a text"):
        Settings()["device.path"]


def test_settings_do_not_change_the_declarations() -> None:
    Settings({"limits.vx_mps": 1.0}).values["limits.vy_mps"] = 2.0
    assert Settings()["limits.vx_mps"] == 0.2
    assert Settings()["limits.vy_mps"] == 0.2


# Lines.


def test_lines_and_back() -> None:
    changed = {"device.path": "/dev/a=b ü", "gate.period_s": 0.0123456789012345, "restart.deaths": 7}
    settings = Settings(dict(changed))
    assert Settings.from_lines(settings.lines()).values == settings.values


@given(
    st.fixed_dictionaries(
        {},
        optional={
            setting.key: st.integers(int(setting.low or 0), int(setting.high or 0))
            if isinstance(setting.default, int)
            else st.floats(setting.low, setting.high)
            for setting in NUMBERS
            if not setting.key.startswith("gate.")
        },
    )
)
def test_any_values_survive_the_lines(changed: dict[str, object]) -> None:
    settings = Settings(dict(changed))
    again = Settings.from_lines(settings.lines())
    assert again.values == settings.values
    assert [type(value) for value in again.values.values()] == [type(setting.default) for setting in DECLARED]


def test_no_lines_are_the_defaults() -> None:
    assert Settings.from_lines("").values == Settings().values


# The fastest wheel.


@given(*(st.floats(BY_KEY[key].low, BY_KEY[key].high) for key in ("limits.vx_mps", "limits.vy_mps")))
def test_the_fastest_wheel_is_that_of_the_worst_corner(vx: float, vy: float) -> None:
    settings = Settings({"limits.vx_mps": vx, "limits.vy_mps": vy, "limits.wz_radps": 2.5})
    robot = Mecanum(settings["wheels.diameter_m"], settings["wheels.wheelbase_m"], settings["wheels.track_m"])
    corners = product((-vx, vx), (-vy, vy), (-2.5, 2.5))
    worst = max(abs(rps) for corner in corners for rps in robot.wheels_rps(*corner))
    assert settings.max_wheel_rps() == pytest.approx(worst, rel=1e-12)


def test_no_allowed_values_make_a_wheel_that_no_frame_can_carry() -> None:
    """The codec refuses limits beyond the ceiling; a gate that met one would die at its first step."""
    worst = {setting.key: setting.high for setting in NUMBERS if setting.key.startswith(("limits.", "wheels."))}
    worst["wheels.diameter_m"] = BY_KEY["wheels.diameter_m"].low
    assert Settings(dict(worst)).max_wheel_rps() * ROUNDING_OF_LIMITS < RPS_CEILING
