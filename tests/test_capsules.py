"""The arm's shape: where its links are, and what they would hit."""

from __future__ import annotations

from math import pi, sqrt

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.policy.capsules import CHASSIS, FLOOR, Model, _apart_squared, on_the_way
from failstop.policy.settings import Settings

CHAIN = (("base", "yaw", 0.05), ("shoulder", "pitch", 0.15), ("elbow", "pitch", 0.15), ("hand", "pitch", 0.1))
SHAPE: dict[str, object] = {
    f"joints.{name}.{key}": value
    for number, (name, turns, length_m) in enumerate(CHAIN, 1)
    for key, value in (("servo", number), ("turns", turns), ("length_m", length_m), ("radius_m", 0.02))
}
MODEL = Model(Settings({**SHAPE, "arm.mount_z_m": 0.2}))


def tip(**angles: float) -> tuple[float, float, float]:
    return MODEL.capsules(angles)[-1][2]


def hit(angles: dict[str, float]) -> tuple[str, str] | None:
    """The pair that touches in these angles."""
    gap_m, name, other = MODEL.nearest(angles)
    return (name, other) if gap_m < 0.0 else None


def test_straight_up_and_folded_forward_and_to_the_left() -> None:
    assert tip() == pytest.approx((0.0, 0.0, 0.65))
    assert tip(shoulder=pi / 2) == pytest.approx((0.4, 0.0, 0.25))
    assert tip(base=pi / 2, shoulder=pi / 2) == pytest.approx((0.0, 0.4, 0.25))
    assert tip(shoulder=pi / 2, elbow=pi / 2) == pytest.approx((0.15, 0.0, 0.0))


def test_what_it_hits_in_one_place() -> None:
    assert hit({}) is None
    assert hit({"base": pi / 2, "shoulder": pi / 2, "elbow": pi / 2}) == ("hand", FLOOR)
    assert hit({"shoulder": 2.6, "elbow": -2.6}) == ("elbow", CHASSIS)
    assert hit({"shoulder": 0.3, "elbow": pi - 0.05, "hand": 0.4}) is not None


def test_the_way_is_looked_at_and_not_only_its_end() -> None:
    there = {"shoulder": -1.9, "elbow": 0.0, "hand": 0.0}
    assert hit({"shoulder": 1.2}) is None
    begun = {"base": 0.0, "shoulder": 1.2, "elbow": 0.0, "hand": 0.0}
    assert on_the_way(MODEL, begun, [(2.0, {"shoulder": 0.0})]) is None
    found = on_the_way(MODEL, {**begun, "shoulder": 0.0}, [(2.0, {"shoulder": 3.0}), (4.0, there)])
    assert found is not None
    assert 1.0 < found[0] < 2.0
    assert found[2] == CHASSIS or found[2] == FLOOR


@given(points=st.lists(st.tuples(*[st.floats(-1, 1)] * 3), min_size=4, max_size=4))
def test_no_two_points_of_two_segments_are_nearer_than_the_distance(points: list[tuple[float, float, float]]) -> None:
    p1, q1, p2, q2 = points
    apart = sqrt(_apart_squared(p1, q1, p2, q2))
    for s in (0.0, 0.25, 0.5, 0.75, 1.0):
        for t in (0.0, 0.25, 0.5, 0.75, 1.0):
            one = [a + s * (b - a) for a, b in zip(p1, q1, strict=True)]
            two = [a + t * (b - a) for a, b in zip(p2, q2, strict=True)]
            assert sqrt(sum((a - b) ** 2 for a, b in zip(one, two, strict=True))) >= apart - 1e-6
