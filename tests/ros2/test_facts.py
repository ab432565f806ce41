"""Facts of a real ROS, recorded in facts.json: the stand-in has them too, and so has a real one today."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.ros2.scene import Ros

HERE = Path(__file__).resolve().parent
RECORDED: dict[str, Any] = json.loads((HERE / "facts.json").read_text())


@pytest.fixture(scope="module")
def seen(ros: Ros) -> dict[str, Any]:
    done = ros.run(sys.executable, str(HERE / "facts_seen.py"), timeout_s=120.0)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.mark.parametrize("about", [about for about in RECORDED if about != "messages"])
def test_it_is_as_recorded(seen: dict[str, Any], about: str) -> None:
    assert seen[about] == RECORDED[about]


def test_nothing_is_seen_that_is_not_recorded(seen: dict[str, Any]) -> None:
    assert list(seen) == list(RECORDED)
    assert list(seen["messages"]) == list(RECORDED["messages"])


@pytest.mark.parametrize("name", RECORDED["messages"])
def test_the_fields_of_a_message_and_their_defaults(seen: dict[str, Any], name: str) -> None:
    here, there = seen["messages"][name], RECORDED["messages"][name]
    assert typed(here) == typed(within(here, there))


def within(here: Any, there: Any) -> Any:
    if isinstance(here, dict):
        return {field: within(value, there[field]) for field, value in here.items()}
    return there


def typed(value: Any) -> Any:
    """A value with its type, as 0 is equal to 0.0, and a NaN not to itself."""
    if isinstance(value, dict):
        return {field: typed(each) for field, each in value.items()}
    return (type(value), repr(value))
