"""Facts of the real LeRobot, recorded in facts.json: the stand-in has them too, and so has the real one today. The
plugin has LeKiwi's."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest
from lerobot_robot_failstop import Failstop, FailstopConfig
from lerobot_robot_failstop.config_failstop import JOINTS
from lerobot_robot_failstop.keys import KEYS, level_after, velocity
from lerobot_robot_failstop.units import Reach, Unit, number, position

from .scene import HERE, KIWI, LeRobot

UNITS = {"range_m100_100": Unit.SHARE, "range_0_100": Unit.GRIP, "degrees": Unit.DEGREES}
TURN = 4096
"""Positions of a turn of LeKiwi's servos."""


def test_lerobot_is_as_recorded(every_lerobot: LeRobot) -> None:
    seen: dict[str, Any] = json.loads(every_lerobot.run(str(HERE / "facts_seen.py")))
    assert seen == {about: every_lerobot.facts[about] for about in seen}
    assert {"robots", "devices"} <= set(seen)


def test_a_joint_s_number_is_in_the_unit_of_that_lerobot_s_lekiwi(every_lerobot: LeRobot) -> None:
    """A dataset does not say which unit it has, so a wrong default would move the arm to other places."""
    program = "from lerobot_robot_failstop import FailstopConfig; print(FailstopConfig(id='units').use_degrees)"
    degrees = every_lerobot.facts["kiwi"]["norm modes"]["arm_shoulder_pan"] == "degrees"
    assert every_lerobot.run("-c", program).split() == [str(degrees)]


def test_the_plugin_has_lekiwi_s_names() -> None:
    robot = Failstop(FailstopConfig(id="names"))
    for found, about in ((robot.observation_features, "observations"), (robot.action_features, "actions")):
        assert {name: kind.__name__ for name, kind in found.items()} == KIWI[about]
        assert list(found) == list(KIWI[about])
    assert robot.name == KIWI["name"]
    assert str(robot.calibration_dir).endswith(KIWI["calibration folder"])
    assert [f"arm_{name}" for name in JOINTS] == [name for name in KIWI["servos"] if name.startswith("arm_")]


@pytest.mark.parametrize(("low", "high", "mode", "unit", "shown", "sent"), KIWI["numbers"])
def test_the_plugin_has_lekiwi_s_numbers(
    low: int, high: int, mode: int, unit: str, shown: list[float], sent: list[int]
) -> None:
    def of(rule: Callable[..., float], value: float) -> float:
        return rule(value, Reach(low, high, bool(mode)), UNITS[unit], TURN)

    assert [of(number, at) for at in KIWI["positions"]] == pytest.approx(shown)
    # LeRobot cuts a position to a whole one.
    assert [of(position, value) for value in KIWI["values"]] == pytest.approx(sent, abs=1.0)


def test_the_plugin_has_lekiwi_s_keys() -> None:
    level = 0
    assert KIWI["keys"] == KEYS
    for pressed, wanted in KIWI["keyboard"]:
        level = level_after(level, pressed, KEYS)
        assert velocity(level, pressed, KEYS) == wanted
