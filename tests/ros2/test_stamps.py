"""Senders of goals and commands: whether they live, and stamps that disagree with the clock. Times are the test's."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from failstop.ros2.alive import DISCOVERY_NS, LEAST_NS, Alive, Unwatched
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


@pytest.mark.parametrize(
    ("age_s", "refusal", "told"),
    [
        (NOW_S - 12.0, "its stamp is 19676 days old (most: 0.3 s)", "that are 19676 days old, and refused"),
        (-NOW_S + 12.0, "", "that are 19676 days in the future"),
    ],
)
def test_a_stamp_of_another_kind_of_clock_is_told_as_that(
    stamps: Stamps, age_s: float, refusal: str, told: str
) -> None:
    asks = "is use_sim_time the same in both nodes?"
    assert stamps.late("cmd_vel", "/nav", stamp(age_s), 0.3, S) == (f"{refusal}; {asks}" if refusal else "")
    assert stamps.wrong(S) == [f"/nav publishes cmd_vel with stamps {told}: {asks}"]


def test_a_stamp_from_the_future_is_told_and_not_refused(stamps: Stamps) -> None:
    assert stamps.late("cmd_vel", "/nav", stamp(-7.0), 0.3, S) == ""
    told = "/nav publishes cmd_vel with stamps that are 7.0 s in the future: do the clocks agree?"
    assert stamps.wrong(S) == [told]


def test_the_words_stay_while_the_age_is_about_the_same(stamps: Stamps) -> None:
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
    assert stamps.late("cmd_vel", "/nav", stamp(0.0), 0.3, S) == f"nobody knows how old its stamp is: {NO_CLOCK}"
    assert stamps.wrong(S) == [NO_CLOCK]


UNACKNOWLEDGED = "a node that receives the goal has acknowledged nothing for {:g} s"
SILENT_NS = S + S // 2
"""When one whose last acknowledgement was at S is gone, by a timeout of 0.5 s."""


@pytest.mark.parametrize(
    ("timeout_s", "looks"),
    [
        (0.5, [(1, True, ms * 1_000_000, "") for ms in range(0, 60_000, 20)]),
        (0.5, [(1, True, S, ""), (1, False, SILENT_NS - 1, ""), (1, False, SILENT_NS, UNACKNOWLEDGED.format(0.5))]),
        (0.5, [(1, True, S, ""), (2, False, SILENT_NS - 1, ""), (2, False, SILENT_NS, UNACKNOWLEDGED.format(0.5))]),
        # No shorter than three messages.
        (0.1, [(1, True, S, ""), (1, False, S + LEAST_NS - 1, ""), (1, False, S + LEAST_NS, "a node")]),
        (0.5, [(1, True, S, ""), (0, True, S + 1, "nobody receives the goal any more")]),
        # Who is never met has the time of discovery; best effort acknowledges nothing.
        (0.5, [(0, True, DISCOVERY_NS - 1, ""), (0, True, DISCOVERY_NS, "nobody receives the goal reliably")]),
        (0.5, [(1, False, DISCOVERY_NS - 1, ""), (1, False, DISCOVERY_NS, "a node")]),
    ],
)
def test_a_client_is_gone_by_what_dds_says(timeout_s: float, looks: list[tuple[int, bool, int, str]]) -> None:
    client = Alive(0, timeout_s)
    for heard, acknowledges, now_ns, told in looks:
        found = client.look(heard, acknowledges, now_ns)
        assert (found.startswith(told), bool(found)) == (True, bool(told)), (found, now_ns)


@pytest.mark.parametrize(
    "looks",
    [
        [(1, 0, ""), (1, 3 * S, ""), (1, 3 * S + 1, "it takes longer than 3 s (arm.unwatched_s)")],
        [(1, 0, ""), (0, 1, "its publisher has gone")],
        [(0, DISCOVERY_NS - 1, ""), (1, DISCOVERY_NS, "")],  # the graph may know the publisher later than its message
        [(0, DISCOVERY_NS, "its publisher has gone")],
    ],
)
def test_a_sender_of_the_topic_is_gone_with_its_publisher(looks: list[tuple[int, int, str]]) -> None:
    sender = Unwatched(0, 3.0)
    assert [sender.look(count, now_ns) for count, now_ns, _ in looks] == [told for *_, told in looks]
