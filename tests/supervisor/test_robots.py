"""Robots of the RRC family by name, and settings that a robot of fewer wheels does not have."""

from __future__ import annotations

import pytest

from failstop.policy.layouts import BOARDS, LAYOUTS, WHEEL_NAMES, speeds_of
from failstop.policy.robots import LAYOUT_OF, ROBOTS, UNDRIVEN, USUAL_ROBOT
from failstop.policy.setting import SettingError
from failstop.policy.settings import Settings, mounted_wheels


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_robot_is_one_line(robot: str) -> None:
    """Facts that nobody knows of it are asked for by name; those that its owner sets stay."""
    for layout, figures in ROBOTS[robot].items():
        given: dict[str, object] = {"board.robot": robot}
        given |= {} if robot in LAYOUT_OF else {"wheels.layout": layout}
        unknown = [key for key, value in figures.items() if value is None]
        if unknown:
            with pytest.raises(SettingError, match=f"^{', '.join(unknown)}: no source has this of board.robot"):
                Settings(given)
        made = Settings({**given, **{key: Settings({"wheels.layout": layout}).values[key] for key in unknown}})
        known = {key: value for key, value in figures.items() if value is not None}
        assert {key: made.values[key] for key in known} == known
        assert Settings.from_lines(made.lines()).flat() == made.flat()
        for key in known:
            if isinstance(value := made.values[key], float):
                assert Settings({**given, **dict.fromkeys(unknown, 1), key: value * 0.9})[key] == value * 0.9


def test_the_first_is_what_the_settings_were_without_a_name() -> None:
    for layout in LAYOUTS:
        named, plain = (
            Settings({"board.robot": USUAL_ROBOT, "wheels.layout": layout}),
            Settings({"wheels.layout": layout}),
        )
        assert named.flat() == plain.flat()


@pytest.mark.parametrize("robot", UNDRIVEN)
def test_a_robot_that_can_not_be_driven_is_refused_with_the_reason(robot: str) -> None:
    with pytest.raises(SettingError, match=f'^board.robot = "{robot}": {UNDRIVEN[robot][:20]}'):
        Settings({"board.robot": robot})


REFUSALS: dict[str, tuple[dict[str, object], str]] = {
    "no source": (
        {"board.robot": "jetrover", "wheels.layout": "differential"},
        "wheels.diameter_m, wheels.track_m: no source has this of board.robot",
    ),
    "a robot of another board": (
        {"board.kind": "ugv", "board.robot": "jetrover"},
        "board.robot: it is only for robots with",
    ),
    "a third wheel of two": (
        {"board.kind": "ugv", "wheels.sign_3": 1},
        "wheels.sign_3: this robot has 2 wheels (1 left, 2 right), so remove it",
    ),
    "a fourth of three": ({"wheels.layout": "omni3", "wheels.id_4": 3}, "(1 left, 2 rear, 3 right), so remove it"),
    "more wheels than speeds": (
        {"board.kind": "ugv", "wheels.layout": "omni3"},
        'such a base has 3 wheels, but board.kind ugv drives 2; use "differential"',
    ),
    "an id that the board has not": ({"board.kind": "ugv", "wheels.id_2": 3}, "on board.kind ugv, ids go from 0 to 1"),
    "one id twice": ({"wheels.id_2": 0}, "wheels.id_1 is 0 too, but they must differ"),
    "a lever of a base without": (
        {"wheels.lever_m": 0.1},
        'wheels.lever_m: a base with wheels.layout "mecanum" has none',
    ),
    "steering without a servo": (
        {"board.kind": "ugv", "wheels.layout": "ackermann"},
        "board.kind ugv can't move a servo that steers",
    ),
    "steering by a joint of the arm": (
        {"wheels.layout": "ackermann", "steering.kind": "bus", "steering.servo": 9, "steering.centre": 500}
        | {"steering.per_rad": 200.0, "joints.base.servo": 9},
        "steering.servo is 9 too",
    ),
    "a fifth PWM servo": ({"wheels.layout": "ackermann", "steering.servo": 5}, "the id of a pwm servo is 1 to 4"),
    "steering past the servo's end": (
        {"wheels.layout": "ackermann", "steering.most_deg": 60.0, "steering.per_rad": 1000.0},
        "a pwm servo goes only from 500 to 2500",
    ),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_what_a_robot_does_not_have_is_refused_by_name(case: str) -> None:
    given, told = REFUSALS[case]
    with pytest.raises(SettingError) as refused:
        Settings(given)
    assert told in str(refused.value)


@pytest.mark.parametrize("kind", [*BOARDS, "/a/folder"])
def test_a_robot_is_told_of_no_wheel_that_it_has_not(kind: str) -> None:
    settings = Settings({"board.kind": kind})
    count = len(mounted_wheels(settings.values))
    assert count == (speeds_of(kind) or 2)
    numbered = {int(key[-1]) for key in settings.flat() if key.startswith(("wheels.sign_", "wheels.id_"))}
    assert numbered == set(range(1, count + 1))
    assert len(WHEEL_NAMES[count]) == count
