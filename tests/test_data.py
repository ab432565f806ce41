"""Data takes each of its fields once, and nothing else."""

from __future__ import annotations

from typing import Any

import pytest

from failstop.data import Data


class Point(Data):
    x: float
    y: float
    name: str = "origin"


@pytest.mark.parametrize(
    ("values", "named", "found"),
    [
        ((1, 2), {}, (1, 2, "origin")),
        ((1, 2, "a"), {}, (1, 2, "a")),
        ((1,), {"y": 2}, (1, 2, "origin")),
        ((), {"name": "a", "y": 2, "x": 1}, (1, 2, "a")),
    ],
)
def test_fields_are_given_by_place_or_name(values: Any, named: Any, found: Any) -> None:
    point = Point(*values, **named)
    assert (point.x, point.y, point.name) == found


@pytest.mark.parametrize(
    ("values", "named", "wrong"),
    [
        ((), {}, "Point lacks x, y"),
        ((1,), {}, "Point lacks y"),
        ((), {"y": 1}, "Point lacks x"),
        ((1, 2, "a", 3), {}, "Point has 3 fields, and 4 were given"),
        ((1, 2, "a", 3), {"name": "b"}, "Point has two values for name"),
        ((1, 2), {"z": 3}, "Point has no field z"),
        ((1, 2), {"x": 3}, "Point has two values for x"),
        ((1,), {"y": 2, "x": 3}, "Point has two values for x"),
    ],
)
def test_anything_else_is_an_error(values: Any, named: Any, wrong: str) -> None:
    with pytest.raises(TypeError, match=f"^{wrong}$"):
        Point(*values, **named)
