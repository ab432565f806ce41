"""The arm's shape: where its links are, and what they would hit."""

from __future__ import annotations

from itertools import pairwise
from math import cos, dist, inf, pi, sin

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from failstop.policy.capsules import CHASSIS, FLOOR, STEP_RAD, Model, Point, apart_m, on_the_way, would_hit
from failstop.policy.settings import Settings

CHAIN = (("base", "yaw", 0.05), ("shoulder", "pitch", 0.15), ("elbow", "pitch", 0.15), ("hand", "pitch", 0.1))
JOINTS = [name for name, _, _ in CHAIN]
SHAPE: dict[str, object] = {
    f"joints.{name}.{key}": value
    for number, (name, turns, length_m) in enumerate(CHAIN, 1)
    for key, value in (("servo", number), ("turns", turns), ("length_m", length_m), ("radius_m", 0.01 * number))
}
ANGLES = st.fixed_dictionaries({name: st.floats(-pi, pi) for name in JOINTS})
POINTS = st.tuples(*[st.floats(-1, 1)] * 3)


def model(mount_z_m: float = 0.2, **chassis: float) -> Model:
    changed = {f"arm.chassis_{key}": value for key, value in chassis.items()}
    return Model(Settings({**SHAPE, "arm.mount_x_m": 0.03, "arm.mount_z_m": mount_z_m, **changed}))


MODEL = model()


def between(begin: Point, end: Point, share: float) -> Point:
    x, y, z = (a + share * (b - a) for a, b in zip(begin, end, strict=True))
    return x, y, z


def least(far: list[Point], near: list[Point], steps: int = 60) -> float:
    """The distance of two segments by search: it has one valley along each, so thirds without it can go."""
    if not far:
        return dist(*near)
    low, high = 0.0, 1.0
    begin, end, *rest = far
    for _ in range(steps):
        at = low + (high - low) / 3, high - (high - low) / 3
        one, two = (least(rest, [*near, between(begin, end, share)], steps) for share in at)
        low, high = (low, at[1]) if one < two else (at[0], high)
    return least(rest, [*near, between(begin, end, low)], steps)


def tip(**angles: float) -> Point:
    return MODEL.capsules(angles)[-1][2]


def test_straight_up_and_folded_forward_and_to_the_left() -> None:
    assert tip() == pytest.approx((0.03, 0.0, 0.65))
    assert tip(shoulder=pi / 2) == pytest.approx((0.43, 0.0, 0.25))
    assert tip(base=pi / 2, shoulder=pi / 2) == pytest.approx((0.03, 0.4, 0.25))
    assert tip(shoulder=pi / 2, elbow=pi / 2) == pytest.approx((0.18, 0.0, 0.0))
    assert tip(base=pi, shoulder=pi / 6) == pytest.approx((0.03 - 0.2, 0.0, 0.25 + 0.4 * cos(pi / 6)))


@given(angles=ANGLES, turned=st.floats(-pi, pi))
def test_links_are_a_chain_that_the_base_turns_as_a_whole(angles: dict[str, float], turned: float) -> None:
    links = MODEL.capsules(angles)
    assert [(name, radius_m) for name, _, _, radius_m in links] == [
        (name, pytest.approx(0.01 * number)) for number, name in enumerate(JOINTS, 1)
    ]
    assert [dist(begin, end) for _, begin, end, _ in links] == pytest.approx([length_m for *_, length_m in CHAIN])
    assert links[0][1] == (0.03, 0.0, 0.2)
    assert all(one[2] == other[1] for one, other in pairwise(links))
    turned_links = MODEL.capsules({**angles, "base": angles["base"] + turned})
    for (_, _, (x, y, z), _), (_, _, (to_x, to_y, to_z), _) in zip(links, turned_links, strict=True):
        there = complex(x - 0.03, y) * complex(cos(turned), sin(turned))
        assert (to_x - 0.03, to_y, to_z) == pytest.approx((there.real, there.imag, z), abs=1e-9)


def test_joints_without_a_length_are_no_links_and_a_roll_turns_none() -> None:
    changed = {"joints.shoulder.length_m": 0.0, "joints.base.turns": "roll", "joints.hand.turns": "none"}
    links = Model(Settings({**SHAPE, **changed})).capsules({"base": 1.0, "elbow": pi / 2, "hand": 1.0})
    assert [name for name, *_ in links] == ["base", "elbow", "hand"]
    assert links[-1][2] == pytest.approx((0.25, 0.0, 0.15))


@given(points=st.tuples(*[POINTS] * 4))
@example(points=((0, 0, 0), (1, 0, 0), (0.2, 0.5, 0), (0.4, 0.5, 0)))  # parallel, one beside the other
@example(points=((0, 0, 0), (1, 0, 0), (-0.2, 0.5, 0), (-0.4, 0.5, 0)))  # parallel, past the begin
@example(points=((0, 0, 0), (1, 0, 0), (1.4, 0, 0), (1.2, 0, 0)))  # in one line, past the end
@example(points=((0, 0, 0), (1, 0, 0), (0, 0.1, 0), (1, 0.1, 1e-7)))  # almost parallel
@example(points=((0.3, 0, 1), (0.3, 0, 1), (0, 0, 0), (1, 0, 0)))  # a point and a segment
@example(points=((0, 0, 0), (1, 0, 0), (0.3, 0, 1), (0.3, 0, 1)))
@example(points=((0, 0, 0), (0, 0, 0), (0, 3, 4), (0, 3, 4)))  # two points
@example(points=((0, 0, 0), (1, 1, 0), (0, 1, 0.1), (1, 0, 0.1)))  # across each other
def test_distance_of_two_segments_is_what_a_search_finds(points: tuple[Point, Point, Point, Point]) -> None:
    p1, q1, p2, q2 = points
    apart = apart_m(p1, q1, p2, q2)
    assert apart == pytest.approx(least(list(points), [], steps=20), abs=1e-3)
    assert apart == pytest.approx(apart_m(p2, q2, p1, q1), abs=1e-6)
    assert apart == pytest.approx(apart_m(q1, p1, p2, q2), abs=1e-6)


@given(
    angles=ANGLES,
    length_m=st.floats(0.0, 1.0),
    radius_m=st.floats(0.0, 0.2),
    z_m=st.floats(0.0, 0.3),
    mount_z_m=st.floats(0.0, 0.6),
)
@example(angles={}, length_m=0.6, radius_m=0.01, z_m=0.3, mount_z_m=0.3)
@example(angles={"shoulder": 2.6, "elbow": -2.6}, length_m=0.3, radius_m=0.08, z_m=0.08, mount_z_m=0.2)
def test_nearest_pair_is_the_nearest_of_all_that_are_not_mounted_on_each_other(
    angles: dict[str, float], length_m: float, radius_m: float, z_m: float, mount_z_m: float
) -> None:
    made = model(mount_z_m, length_m=length_m, radius_m=radius_m, z_m=z_m)
    links = made.capsules(angles)
    ball = max(length_m, 2 * radius_m) / 2 - radius_m
    gaps = {(name, FLOOR): min(begin[2], end[2]) - thick for name, begin, end, thick in links[1:]} | {
        (one[0], other[0]): apart_m(one[1], one[2], other[1], other[2]) - one[3] - other[3]
        for at, one in enumerate(links)
        for other in [*links[at + 2 :], (CHASSIS, (-ball, 0.0, z_m), (ball, 0.0, z_m), radius_m)][: None if at else -1]
    }
    gap_m, *pair = made.nearest(angles)
    assert gap_m == pytest.approx(min(gaps.values()))
    assert gap_m == pytest.approx(gaps[pair[0], pair[1]])


def test_arm_of_one_link_hits_nothing() -> None:
    table = {key: value for key, value in SHAPE.items() if key.startswith("joints.base.")}
    assert Model(Settings(table)).nearest({"base": 1.0})[0] == inf


def test_folded_hand_hits_the_upper_arm() -> None:
    gap_m, name, other = MODEL.nearest({"shoulder": 0.3, "elbow": pi - 0.05, "hand": 0.4})
    assert gap_m < 0.0
    assert (name, other) == ("shoulder", "hand")
    assert would_hit(name, other) == "the arm would hit something on its way: shoulder and hand"
    assert "hit something after 1 s on" in would_hit(name, other, "after 1 s ")


class Wall(Model):
    """An arm of one joint a, in front of a wall at an angle of it; where it was looked at."""

    def __init__(self, at: float) -> None:
        self.at = at
        self.seen: list[float] = []

    def nearest(self, angles: dict[str, float]) -> tuple[float, str, str]:
        self.seen.append(angles.get("a", 0.0))
        return self.at - self.seen[-1], "a", "the wall"


WAY = st.lists(st.floats(-2, 2), min_size=1, max_size=4)


@given(start=st.floats(-2, 2), ends=WAY)
@example(start=0.0, ends=[3 * STEP_RAD])
@example(start=0.3, ends=[0.3])
def test_way_is_looked_at_from_its_start_to_each_end_without_a_wider_step(start: float, ends: list[float]) -> None:
    wall = Wall(inf)
    assert on_the_way(wall, {"a": start}, [(float(number), {"a": end}) for number, end in enumerate(ends, 1)]) is None
    assert wall.seen[0] == start
    at = 0
    for begin, end in pairwise([start, *ends]):
        steps = next(step for step, seen in enumerate(wall.seen[at + 1 :], 1) if seen == pytest.approx(end, abs=1e-9))
        assert steps == 1 or (steps - 1) * STEP_RAD < abs(end - begin) + 1e-9
        assert abs(end - begin) <= steps * STEP_RAD + 1e-9
        even = [begin + (end - begin) * step / steps for step in range(steps + 1)]
        assert wall.seen[at : at + steps + 1] == pytest.approx(even, abs=1e-6)
        at += steps
    assert len(wall.seen) == at + 1


@given(ends=WAY)
def test_hit_is_told_with_its_time_at_the_first_look_beyond_the_wall(ends: list[float]) -> None:
    wall = Wall(0.5)
    rows = [(2.0 * number, {"a": end}) for number, end in enumerate(ends, 1)]
    found = on_the_way(wall, {}, rows)
    assert (found is not None) == any(end > 0.5 for end in ends)
    if found:
        t_s, *pair = found
        assert pair == ["a", "the wall"]
        row = next(at for at, end in enumerate(ends) if end > 0.5)
        begin = ends[row - 1] if row else 0.0
        assert wall.seen[-1] == pytest.approx(begin + (ends[row] - begin) * (t_s / 2.0 - row))
        assert 0.5 < wall.seen[-1] <= 0.5 + STEP_RAD + 1e-9


def test_what_touches_may_part_and_may_come_no_nearer() -> None:
    assert on_the_way(Wall(-1.0), {"a": 0.5}, [(1.0, {"a": 0.0}), (2.0, {"a": -2.0})]) is None
    assert on_the_way(Wall(-1.0), {"a": 0.5}, [(1.0, {"a": 0.5})]) is None
    assert on_the_way(Wall(-1.0), {"a": 0.5}, [(1.0, {"a": 0.51})]) == (1.0, "a", "the wall")
    assert on_the_way(Wall(-1.0), {"a": 0.5}, [(1.0, {"a": 0.0}), (2.0, {"a": 0.01})]) == (2.0, "a", "the wall")
    assert on_the_way(Wall(0.0), {}, [(1.0, {"a": 0.0})]) is None


def test_joints_that_a_row_does_not_name_stay_where_they_are() -> None:
    begun = {"base": 0.0, "shoulder": 1.2, "elbow": 0.0, "hand": 0.0}
    assert on_the_way(MODEL, begun, [(2.0, {"shoulder": 0.0})]) is None
    folded = [(2.0, {"elbow": 2.9}), (4.0, {"hand": 2.0})]
    assert on_the_way(MODEL, {"shoulder": -1.5}, folded[:1]) == on_the_way(MODEL, {"shoulder": -1.5}, folded)
    found = on_the_way(MODEL, {}, [(2.0, {"shoulder": 1.9}), (3.0, {"elbow": 1.9})])
    assert found is not None
    assert 2.0 < found[0] < 3.0
