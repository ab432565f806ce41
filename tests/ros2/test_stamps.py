"""Stamps that disagree with the clock here: refused, and told. The clocks are the test's."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from failstop.ros2.stamps import NO_CLOCK, TOLD_NS, Stamps

S = 1_000_000_000
NOW_S = 1_700_000_000


def stamp(age_s: float) -> SimpleNamespace:
    ns = NOW_S * S - round(age_s * S)
    return SimpleNamespace(sec=ns // S, nanosec=ns % S)


@pytest.fixture
def stamps() -> Stamps:
    return Stamps(lambda: NOW_S * S)


@pytest.mark.parametrize("age_s", [0.0, 0.3, -0.3])
def test_a_stamp_of_about_now_is_nothing_to_tell_of(stamps: Stamps, age_s: float) -> None:
    assert stamps.late("cmd_vel", "/nav", stamp(age_s), 0.3, S) == ""
    assert stamps.wrong(S) == []


def test_no_stamp_counts_as_now(stamps: Stamps) -> None:
    assert stamps.late("cmd_vel", "/nav", SimpleNamespace(sec=0, nanosec=0), 0.3, S) == ""
    assert Stamps(lambda: 0).late("cmd_vel", "/nav", SimpleNamespace(sec=0, nanosec=0), 0.3, S) == ""


def test_an_old_stamp_is_refused_and_told_with_its_publisher_and_age(stamps: Stamps) -> None:
    refusal = stamps.late("cmd_vel", "/nav", stamp(5.0), 0.3, S)
    assert refusal == "its stamp is 5.000 s old (most: 0.3 s); do the clocks agree?"
    told = "/nav publishes cmd_vel with stamps that are 5.0 s old, and refused: do the clocks agree?"
    assert stamps.wrong(S + TOLD_NS) == [told]
    assert stamps.wrong(S + TOLD_NS + 1) == []


def test_a_stamp_from_the_future_is_told_and_not_refused(stamps: Stamps) -> None:
    assert stamps.late("cmd_vel", "/nav", stamp(-7.0), 0.3, S) == ""
    told = "/nav publishes cmd_vel with stamps that are 7.0 s in the future: do the clocks agree?"
    assert stamps.wrong(S) == [told]


def test_the_words_stay_while_the_age_is_about_the_same(stamps: Stamps) -> None:
    """Each change of them is an event for people."""
    found = set()
    for tick, age_s in enumerate((5.0, 5.04, 4.96, 5.9, 5.1)):
        stamps.late("cmd_vel", "/nav", stamp(age_s), 0.3, S + tick)
        found.update(stamps.wrong(S + tick))
    assert len(found) == 1
    stamps.late("cmd_vel", "/joy", stamp(5.0), 0.3, 2 * S)
    assert stamps.wrong(2 * S)[0].startswith("/joy publishes")
    stamps.late("cmd_vel", "/nav", stamp(60.0), 0.3, 2 * S)
    assert "60.0 s old" in stamps.wrong(2 * S)[0]
    stamps.late("arm/goal", "/moveit", stamp(1.0), 0.5, 2 * S)
    assert len(stamps.wrong(2 * S)) == 2, "a row for each topic"


def test_where_ros_has_no_time_no_stamp_is_believed() -> None:
    stamps = Stamps(lambda: 0)
    assert stamps.late("cmd_vel", "/nav", stamp(0.0), 0.3, S) == f"how old its stamp is nobody knows: {NO_CLOCK}"
    assert stamps.wrong(S) == [NO_CLOCK]
