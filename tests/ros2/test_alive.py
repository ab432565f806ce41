"""Senders of an arm's goal, alive or not as seen: the time and what DDS says are the test's."""

from __future__ import annotations

import pytest

from failstop.ros2.alive import DISCOVERY_NS, LEAST_NS, Alive, Unwatched

S = 1_000_000_000
UNACKNOWLEDGED = "a node that hears of the goal has acknowledged nothing for {:g} s"
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
        (0.5, [(1, True, S, ""), (0, True, S + 1, "nobody hears of the goal any more")]),
        # Who is never met has the time of discovery; best effort acknowledges nothing.
        (0.5, [(0, True, DISCOVERY_NS - 1, ""), (0, True, DISCOVERY_NS, "nobody hears of the goal reliably")]),
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
