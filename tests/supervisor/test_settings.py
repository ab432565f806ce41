"""Settings: every value that is not it must be refused by a message that names the key, the value and what is."""

from __future__ import annotations

from itertools import product
from math import inf, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.board.rrc.codec import RPS_CEILING
from failstop.policy import kinematics
from failstop.policy.layouts import LAYOUTS
from failstop.policy.robots import UNDRIVEN
from failstop.policy.setting import Setting, SettingError, shortened, shown
from failstop.policy.settings import BY_KEY, DECLARED, FAMILIES, Settings, declaration
from failstop.supervisor.children import LONGEST_WAIT_NS
from failstop.supervisor.main import TICK_NS

CHOICES = [setting for setting in DECLARED if setting.allowed]
NUMBERS = [setting for setting in DECLARED if not isinstance(setting.default, str) and not setting.allowed]
WHOLE = [setting for setting in NUMBERS if isinstance(setting.default, int)]
TEXTS = [setting for setting in DECLARED if isinstance(setting.default, str) and not setting.allowed]
NAMED_TIMEOUTS = ((FAMILIES["sources"], 1), (FAMILIES["interlocks"], 0))
ROUNDING_OF_LIMITS = 1.001
SLOW = {"gate.period_s": 0.05}


def refusal(changed: dict[str, object]) -> str:
    with pytest.raises(SettingError) as raised:
        Settings(dict(changed))
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
    unit |= {"_deg": "degrees", "_c": "degrees Celsius", "_g": "g", "_dps": "deg/s", "_mv": "mV", "_mb": "MB"}
    ending = name[name.rfind("_") :] if "_" in name else ""
    assert setting.unit == unit.get(ending, ""), "the unit is in the name"


APPROVED = """
gate: period_s 0.02, command_timeout_s 0.3, refresh_s 0.2, lease_s 0.06
limits: vx_mps 0.2, vy_mps 0.2, wz_radps 1.0, acceleration_mps2 0.5, acceleration_radps2 2.0
wheels: diameter_m 0.08, wheelbase_m 0.17706, track_m 0.17165, layout mecanum
restart: deaths 5, window_s 60.0
key: stop 1
scan: timeout_s 0.5, gate on
imu: calibration_s 3.0, calibration_std_dps 0.3, tracking_rest_s 1.0, tracking_band_dps 0.5, tracking_tau_s 20.0
imu: tracking on, offset_x_g 0.0, offset_y_g 0.0, offset_z_g 0.0, scale_x 1.0, scale_y 1.0, scale_z 1.0
odometry: forward_scale 1.0, sideways_scale 0.765
battery: step_mv 190, log_s 10.0, log on, directory
pad: dead_zone 0.1, frozen_s 15.0, mode_lockout_s 0.6, reset_hold_s 2.0
buzzer: tones off
"""


def test_the_defaults_are_those_that_were_approved() -> None:
    lines = [line.split(": ") for line in APPROVED.strip().splitlines()]
    approved = [f"{section}.{setting}" for section, settings in lines for setting in settings.split(", ")]
    assert [f"{key} {Settings().values[key]}".strip() for key in (each.split()[0] for each in approved)] == approved


def test_a_lease_outlasts_two_turns_of_the_supervisor() -> None:
    assert BY_KEY["gate.lease_s"].low == 2 * TICK_NS / 1e9


def test_the_first_wait_before_a_restart_is_no_longer_than_the_longest() -> None:
    assert BY_KEY["restart.backoff_s"].high == LONGEST_WAIT_NS / 1e9


# What is refused.


@pytest.mark.parametrize("setting", NUMBERS, ids=lambda setting: setting.key)
def test_a_number_is_of_the_right_type_and_in_a_range_with_both_its_ends(setting: Setting) -> None:
    others: tuple[object, ...] = ("0.02", None, [0.02], {}, True, False, b"1")
    for value in others:
        assert refusal({setting.key: value}) == f"{setting.key} = {value!r}: it must be a number, {setting.range()}"
    assert setting.low is not None
    assert setting.high is not None
    assert setting.check(setting.low) == setting.low
    assert setting.check(setting.high) == setting.high
    step = 1 if isinstance(setting.default, int) else 1e-9
    for beyond in (nan, inf, -inf, 1e308, -1e308, -2, 10**400, setting.low - step, setting.high + step):
        assert refusal({setting.key: beyond}) == f"{setting.key} = {shown(beyond)}: it must be {setting.range()}"


@pytest.mark.parametrize("setting", TEXTS, ids=lambda setting: setting.key)
def test_a_text_is_one_line_of_text_and_empty_only_where_its_default_is(setting: Setting) -> None:
    text = f"it must be a text of {int(bool(setting.default))} to 255 characters of one line"
    others: tuple[object, ...] = (1, 1.5, None, True, [], "two\nlines", "a\0b", "tab\t", "\u2028")
    for value in (*others, *[""] * bool(setting.default)):
        assert refusal({setting.key: value}) == f"{setting.key} = {value!r}: {text}"
    assert setting.default or setting.check("") == ""


def test_a_text_has_an_end() -> None:
    assert Settings({"device.path": "/" * 255}).text("device.path") == "/" * 255
    assert refusal({"device.path": "/" * 256}).endswith("it must be a text of 1 to 255 characters of one line")


STEERED: dict[str, object] = {"wheels.layout": "ackermann"}
WITH: dict[object, dict[str, object]] = {
    "jetacker": {"wheels.diameter_m": 0.1, "wheels.wheelbase_m": 0.2, "wheels.track_m": 0.2},
    "steering.sign": STEERED,
    "steering.kind": STEERED,
    "bus": {**STEERED, "steering.centre": 500},
}
"""Settings that go with a word, or with another setting."""


@pytest.mark.parametrize("setting", CHOICES, ids=lambda setting: setting.key)
def test_a_choice_is_one_of_its_words_which_a_refusal_names(setting: Setting) -> None:
    for word in set(setting.allowed) - set(UNDRIVEN):
        given = {**WITH.get(word, WITH.get(setting.key, {})), setting.key: word}
        assert Settings.from_lines(Settings(given).lines()).values[setting.key] == word
    others: tuple[object, ...] = (0, 2, 1.5, 1.0, True, False, None, "", "ON", "On ", "maybe", [], {})
    for value in others:
        if type(value) is int and value in setting.allowed:
            continue
        assert refusal({setting.key: value}) == f"{setting.key} = {shown(value)}: it must be {setting.range()}"


def test_the_message_for_a_choice() -> None:
    assert refusal({"scan.gate": "yes"}) == 'scan.gate = \'yes\': it must be "on" or "off"'
    layouts = '"mecanum" or "differential" or "omni3" or "ackermann"'
    assert refusal({"wheels.layout": "omni"}) == f"wheels.layout = 'omni': it must be {layouts}"
    assert refusal({"wheels.sign_3": 0}) == "wheels.sign_3 = 0: it must be 1 or -1"


def test_switches() -> None:
    assert Settings().on("scan.gate")
    assert not Settings({"scan.gate": "off"}).on("scan.gate")
    assert not Settings().on("buzzer.tones")


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ("no", "'no'"),
        ("\x1b[2J\n", "'\\x1b[2J\\n'"),
        (10**400, f"1{'0' * 156}..."),
        (1 << 20000, "int that is too large to show"),
        ("x" * 5000, f"'{'x' * 156}..."),
    ],
    ids=["word", "escape", "long number", "endless number", "long text"],
)
def test_a_value_is_shown_in_one_line_of_bounded_length(value: object, text: str) -> None:
    assert shown(value) == text


@pytest.mark.parametrize(
    ("text", "told"),
    [("a\nb", "a?b"), ("x" * 160, "x" * 160), ("x" * 161, f"{'x' * 157}...")],
    ids=["two lines", "longest", "too long"],
)
def test_a_part_of_a_line_is_one_line_of_bounded_length(text: str, told: str) -> None:
    assert shortened(text) == told


def test_no_declaration_is_found_below_a_named_table_s_own() -> None:
    assert declaration("sources.a.priority").key == "priority"
    with pytest.raises(SettingError, match=r"^sources\.a\.b\.priority is not a setting"):
        declaration("sources.a.b.priority")


def test_the_message_for_a_value_out_of_range() -> None:
    assert refusal({"gate.lease_s": 9.0}) == "gate.lease_s = 9.0: it must be 0.04 to 1 s"
    assert refusal({"restart.deaths": 0}) == "restart.deaths = 0: it must be 1 to 100000"


@pytest.mark.parametrize(
    ("value", "advice"),
    [
        (11, ": did you mean 11000?"),
        (10.5, ": did you mean 10500?"),
        (12.6, ": did you mean 12600?"),
        (0, ""),
        (999, ""),
    ],
)
def test_volts_are_no_millivolts(value: float, advice: str) -> None:
    """A stop below 11 mV would never come."""
    assert refusal({"battery.stop_mv": value}) == (
        f"battery.stop_mv = {value}: it must be -1, or 1000 to 60000 mV{advice}"
    )
    assert Settings({"battery.stop_mv": -1})["battery.stop_mv"] == -1
    assert refusal({"arm.low_mv": 6}) == "arm.low_mv = 6: it must be 1000 to 30000 mV: did you mean 6000?"


@pytest.mark.parametrize("setting", WHOLE, ids=lambda setting: setting.key)
def test_a_whole_number(setting: Setting) -> None:
    whole = int(setting.low or 0) + 1
    assert setting.check(float(whole)) == whole
    assert type(setting.check(float(whole))) is int
    with pytest.raises(SettingError) as raised:
        setting.check(whole + 0.5)
    assert str(raised.value) == f"{setting.key} = {whole}.5: it must be a whole number, {setting.range()}"


def test_a_whole_number_will_do_where_any_number_is_expected() -> None:
    settings = Settings({"limits.vx_mps": 1})
    assert settings["limits.vx_mps"] == 1.0
    assert type(settings["limits.vx_mps"]) is float


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"gate.lease_s": 0.4}, "gate.command_timeout_s = 0.3 s must be longer than gate.lease_s = 0.4 s"),
        ({"gate.lease_s": 0.3}, "gate.command_timeout_s = 0.3 s must be longer than gate.lease_s = 0.3 s"),
        ({**SLOW, "gate.lease_s": 0.05}, "gate.lease_s = 0.05 s must be longer than gate.period_s = 0.05 s"),
        (
            {**SLOW, "gate.lease_s": 0.04, "gate.command_timeout_s": 0.05},
            "gate.lease_s = 0.04 s must be longer than gate.period_s = 0.05 s",
        ),
        (
            {"sources.cmd_vel.timeout_s": 0.06},
            "sources.cmd_vel.timeout_s = 0.06 s must be longer than gate.lease_s = 0.06 s",
        ),
        (
            {"sources.pad.priority": 3, "sources.pad.timeout_s": 0.05},
            "sources.pad.timeout_s = 0.05 s must be longer than gate.lease_s = 0.06 s",
        ),
        (
            {"gate.period_s": 0.04, "gate.refresh_s": 0.03},
            "gate.refresh_s = 0.03 s must not be shorter than gate.period_s = 0.04 s",
        ),
        (
            {"restart.window_s": 1.0, "restart.backoff_s": 1.0},
            "restart.window_s = 1 s must be longer than restart.backoff_s = 1 s",
        ),
        ({"wheels.id_3": 0}, "wheels.id_3 = 0: wheels.id_1 is 0 too, but they must differ"),
        (
            {"sources.teleop": {}},
            "sources.teleop.priority = 0: sources.cmd_vel.priority is 0 too, but they must differ",
        ),
    ],
)
def test_values_that_contradict_each_other(changed: dict[str, object], message: str) -> None:
    assert refusal(changed) == message


def test_what_is_sent_every_period_may_be() -> None:
    assert Settings({"gate.refresh_s": 0.03, "gate.period_s": 0.03})["gate.refresh_s"] == 0.03


def test_nothing_that_is_looked_at_every_period_times_out_sooner() -> None:
    longest = BY_KEY["gate.period_s"].high or 0.0
    timeouts = [BY_KEY["scan.timeout_s"], *(processes[key] for processes, key in NAMED_TIMEOUTS)]
    assert all(setting.key.endswith("timeout_s") and (setting.low or 0.0) >= longest for setting in timeouts)


# Reading values.


def test_times_as_nanoseconds() -> None:
    assert Settings().ns("gate.period_s") == 20_000_000
    assert Settings({"gate.command_timeout_s": 0.123456789}).ns("gate.command_timeout_s") == 123_456_789
    assert Settings({"restart.window_s": 3600}).ns("restart.window_s") == 3_600_000_000_000


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
            if setting.key in Settings().values and not setting.key.startswith(("gate.", "restart.", "wheels.id_"))
        },
    )
)
def test_any_values_survive_the_lines(changed: dict[str, object]) -> None:
    settings = Settings(dict(changed))
    again = Settings.from_lines(settings.lines())
    assert again.values == settings.values
    assert all(type(value) is type(BY_KEY[key].default) for key, value in again.values.items())


def test_no_lines_are_the_defaults() -> None:
    assert Settings.from_lines("").values == Settings().values


# Unknown keys.


@pytest.mark.parametrize(
    ("key", "advice"),
    [
        ("gate.perod_s", "did you mean gate.period_s?"),
        ("gaet.period_s", "did you mean gate.period_s?"),
        ("limits.vx", "did you mean limits.vx_mps?"),
        ("pad.deadzone", "did you mean pad.dead_zone?"),
        ("imu.bias", "did you mean imu.scale_z?"),
        ("source.priority", "did you mean sources.NAME.priority?"),
        ("source.teleop.priority", "did you mean sources.teleop.priority?"),
        ("interlock.arm.refusal", "did you mean interlocks.arm.refusal?"),
        ("qqq", "`failstop config` lists them all"),
        ("", "`failstop config` lists them all"),
    ],
)
def test_an_unknown_key_names_the_nearest_known_one(key: str, advice: str) -> None:
    assert refusal({key: 1}) == f"{key} is not a setting; {advice}"


def test_an_empty_table_of_settings_sets_nothing() -> None:
    assert Settings({"gate": {}, "sources": {}, "interlocks": {}}).flat() == Settings().flat()
    assert refusal({"gaet": {}}).startswith("gaet is not a setting")


# The fastest wheel.


@given(*(st.floats(BY_KEY[key].low, BY_KEY[key].high) for key in ("limits.vx_mps", "limits.vy_mps")))
@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_fastest_wheel_is_that_of_the_worst_corner(layout: str, vx: float, vy: float) -> None:
    settings = Settings({"wheels.layout": layout, "limits.vx_mps": vx, "limits.vy_mps": vy, "limits.wz_radps": 2.5})
    robot = kinematics.from_settings(settings)
    corners = product((-vx, vx), (-vy, vy), (-2.5, 2.5))
    worst = max(abs(rps) for corner in corners for rps in robot.wheels_rps(*corner)[: settings.speeds])
    assert kinematics.max_wheel_rps(settings) == pytest.approx(worst, rel=1e-12)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_no_allowed_values_make_a_wheel_that_no_frame_can_carry(layout: str) -> None:
    """The codec refuses limits beyond the ceiling; a gate that met one would die at its first step."""
    worst = {setting.key: setting.high for setting in NUMBERS if setting.key.startswith(("limits.", "wheels."))}
    there = Settings({"wheels.layout": layout}).values
    worst = {key: value for key, value in worst.items() if key in there and not key.startswith("wheels.id_")}
    worst["wheels.diameter_m"] = BY_KEY["wheels.diameter_m"].low
    assert kinematics.max_wheel_rps(Settings({**worst, "wheels.layout": layout})) * ROUNDING_OF_LIMITS < RPS_CEILING


def test_everything_that_is_wrong_is_told_at_once() -> None:
    given = {"gate.period": 1, "limits.vx_mps": "fast", "sources.nav.prio": 1, "gate.period_s": 0.02}
    told = refusal(given)
    assert told.startswith("gate.period is not a setting")
    for key in ("gate.period is", "limits.vx_mps = ", "sources.nav.prio is"):
        assert key in told
    assert refusal({f"x.y{at}": 1 for at in range(20)}).endswith("; and 12 more")
