"""Commanders, on every path: the graph and the time are the test's."""

from __future__ import annotations

import dataclasses
import itertools
import random
from collections.abc import Callable
from types import SimpleNamespace

import pytest

from failstop.api.state import State
from failstop.policy import causes
from failstop.ros2 import graph
from failstop.ros2.commanders import (
    AGAIN_NS,
    FRESH_NS,
    GONE_NS,
    NAMELESS_NS,
    STOP_AGAIN_NS,
    WINDOW_NS,
    Asking,
    Commanders,
    Lag,
    Owed,
    Publisher,
    rivals,
    waited_ns,
)
from failstop.ros2.contract import COMMAND_TYPES, STAMPED, TWIST
from tests.support import states

BOTH = COMMAND_TYPES["auto"]
NAV = Publisher("/nav", TWIST)
JOY = Publisher("/joy", TWIST)
S = 1_000_000_000
MS = 1_000_000


def seen(commanders: Commanders, now_ns: int, *publishers: Publisher) -> Commanders:
    if commanders.wants_look(len(publishers), now_ns):
        commanders.look(publishers, now_ns)
    commanders.counted(len(publishers), now_ns)
    return commanders


def settled(commanders: Commanders, *publishers: Publisher) -> Commanders:
    """The graph has been asked often enough, and for long enough, until S."""
    for ago_ns in range(GONE_NS, -1, -FRESH_NS):
        seen(commanders, S - ago_ns, *publishers)
    return commanders


def test_the_interlock_holds_only_while_the_count_is_fresh() -> None:
    commanders = seen(Commanders(BOTH), S, NAV)
    assert commanders.holds(S + FRESH_NS)
    assert not commanders.holds(S + FRESH_NS + 1)


@pytest.mark.parametrize("second", [JOY, NAV, Publisher("/joy", STAMPED), Publisher("/joy", "x/msg/Y", False)])
def test_two_of_any_type_and_quality(second: Publisher) -> None:
    commanders = seen(Commanders(BOTH), S, NAV, second)
    assert not commanders.passes(S + 1)
    assert not commanders.holds(S)
    assert commanders.cause(S).startswith("multiple cmd_vel publishers: /nav")
    assert "a dead process, which DDS counts for up to 20 s" in commanders.cause(S)


def test_what_was_received_while_there_were_two_may_be_of_the_one_that_has_left() -> None:
    """A reset and an enable may be quicker than its last commands are through the queue."""
    commanders = seen(Commanders(BOTH), S, NAV, JOY)
    seen(commanders, S + 10, NAV)
    assert commanders.cause(S + 10) == "", "no reason for a stop"
    assert commanders.holds(S + 10)
    assert not commanders.passes(S + 10 + GONE_NS)
    assert commanders.passes(S + 11 + GONE_NS)


def test_how_long_a_message_waited() -> None:
    assert waited_ns(S, S + 7) == 7
    assert waited_ns(0, S) == FRESH_NS, "DDS does not say"
    assert waited_ns(S + 1, S) == FRESH_NS, "the clock was set back"


def test_names_of_many_and_of_one_that_is_there_twice() -> None:
    assert seen(Commanders(BOTH), S, NAV, JOY).names() == "/nav, /joy"
    assert seen(Commanders(BOTH), S, NAV, NAV).names() == "/nav (2 times)"
    assert seen(Commanders(BOTH), S, NAV, Publisher("", TWIST)).names() == "/nav, a node whose name is not known yet"
    many = [Publisher(f"/a_node_with_a_long_name_{number}", TWIST) for number in range(40)]
    text = seen(Commanders(BOTH), S, *many).names()
    assert len(text) < 170
    assert text.endswith(" and more")


def test_a_stop_is_asked_for_at_once_and_again_while_it_is_not_latched() -> None:
    commanders = seen(Commanders(BOTH), S, NAV, JOY)
    cause = commanders.cause(S)
    assert commanders.due(cause, False, S)
    assert not commanders.due(cause, False, S + STOP_AGAIN_NS - 1)
    assert commanders.due(cause, False, S + STOP_AGAIN_NS)
    assert not commanders.due(cause, True, S + 10 * STOP_AGAIN_NS), "it is latched"
    assert not commanders.due("", False, S + 11 * STOP_AGAIN_NS)
    assert commanders.due(cause, True, S + 11 * STOP_AGAIN_NS), "a new occasion"


def test_who_publishes_is_looked_up_when_the_number_changes_and_now_and_then() -> None:
    commanders = seen(Commanders(BOTH), S, NAV)
    assert not commanders.wants_look(1, S + AGAIN_NS - 1)
    assert commanders.wants_look(1, S + AGAIN_NS)
    assert commanders.wants_look(2, S + 1)
    assert commanders.wants_look(0, S + 1)
    seen(commanders, S + 1, NAV, Publisher("", TWIST))
    assert commanders.wants_look(2, S + 2), "a name is missing"


def test_strangers() -> None:
    commanders = settled(Commanders(BOTH, ["/nav", "teleop", ""]), NAV)
    assert commanders.passes(S + 1)
    assert commanders.wants_look(1, S + 1), "another may have taken its place"
    bare = Publisher("/left/teleop", TWIST)
    assert seen(commanders, S + 1, bare).passes(S + 1), "a bare name is one in any namespace"
    seen(commanders, S + 2, JOY)
    assert not commanders.passes(S + 3)
    assert not commanders.holds(S + 2)
    assert commanders.cause(S + 2) == "stranger on cmd_vel: /joy (allowed: /nav, teleop)"


def test_a_nameless_one_waits_for_its_name() -> None:
    commanders = Commanders(BOTH, ["/nav"])
    nameless = Publisher("", TWIST)
    seen(commanders, S, nameless)
    assert not commanders.passes(S + 1)
    assert commanders.cause(S) == ""
    seen(commanders, S + NAMELESS_NS - 1, nameless)
    assert commanders.cause(S + NAMELESS_NS - 1) == ""
    seen(commanders, S + NAMELESS_NS, nameless)
    assert commanders.cause(S + NAMELESS_NS).startswith("stranger on cmd_vel: a node whose name is not known yet")
    seen(commanders, S + NAMELESS_NS + 1, NAV)
    assert not commanders.passes(S + NAMELESS_NS + 1 + GONE_NS)
    assert commanders.passes(S + NAMELESS_NS + 2 + GONE_NS)
    assert commanders.cause(S + NAMELESS_NS + 1) == ""


@pytest.mark.parametrize(
    ("accepted", "offered", "now", "wanted"),
    [
        ("auto", [], TWIST, TWIST),
        ("auto", [], STAMPED, STAMPED),
        ("auto", [STAMPED], TWIST, STAMPED),
        ("auto", [TWIST], STAMPED, TWIST),
        ("auto", [TWIST, STAMPED], STAMPED, STAMPED),
        ("auto", ["std_msgs/msg/Bool"], STAMPED, STAMPED),
        ("twist", [STAMPED], TWIST, TWIST),
        ("stamped", [TWIST], STAMPED, STAMPED),
    ],
)
def test_the_type_that_is_subscribed_to(accepted: str, offered: list[str], now: str, wanted: str) -> None:
    publishers = [Publisher(f"/n{number}", kind) for number, kind in enumerate(offered)]
    assert seen(Commanders(COMMAND_TYPES[accepted]), S, *publishers).wanted_type(now) == wanted


def test_what_is_wrong() -> None:
    wrong = seen(Commanders(COMMAND_TYPES["twist"]), S, Publisher("/a", STAMPED), Publisher("/b", TWIST, False)).wrong()
    assert wrong == [
        "/a publishes TwistStamped on cmd_vel, which is Twist",
        "/b publishes cmd_vel as best effort, which is not heard: make it reliable",
    ]
    assert seen(Commanders(BOTH), S, NAV).wrong() == []


def test_whatever_comes_and_goes_a_command_passes_that_came_while_one_published() -> None:
    rng = random.Random(20261122)
    passed = 0
    for _ in range(100):
        allowed = ["/nav", "/joy"] if rng.random() < 0.5 else []
        commanders = Commanders(BOTH, allowed)
        there: list[Publisher] = []
        looks: list[tuple[int, bool]] = []
        for now_ns in itertools.accumulate((rng.choice((1, 11, 20, 20, 101)) * MS for _ in range(200)), initial=S):
            if there and rng.random() < 0.2:
                there.pop(rng.randrange(len(there)))
            elif rng.random() < 0.05:
                there.append(rng.choice((NAV, JOY, Publisher("/x", TWIST), Publisher("", STAMPED, False))))
            seen(commanders, now_ns, *there)
            good = len(there) < 2 and (not allowed or all(one.node in allowed for one in there))
            looks.append((now_ns, good))
            assert bool(commanders.cause(now_ns)) >= (len(there) > 1)
            received_ns = now_ns - rng.choice((0, 1, 50, 400)) * MS
            wanted = _came_alone(looks, received_ns)
            assert commanders.passes(received_ns) is wanted
            passed += wanted
    assert 1000 < passed < 19000


def _came_alone(looks: list[tuple[int, bool]], received_ns: int) -> bool:
    """True where all looks were good for long enough before that time and ever since, and no hold-up ended just
    before."""
    if not looks[-1][1]:
        return False
    bad = [at for at, (_, good) in enumerate(looks) if not good]
    first = bad[-1] + 1 if bad else 0
    ready_ns = looks[first][0] + GONE_NS
    for (a_ns, _), (b_ns, _) in itertools.pairwise(looks[first:]):
        if b_ns - a_ns > FRESH_NS:
            ready_ns = max(ready_ns, b_ns + FRESH_NS)
    return received_ns > ready_ns


# What DDS sends again.


@pytest.mark.parametrize("ahead_ns", [0, 3600 * S, -3600 * S])
def test_a_message_that_was_sent_again_is_late_whatever_its_publisher_s_clock_says(ahead_ns: int) -> None:
    lag = Lag()
    for at_ns in range(100 * S, 104 * S, 50 * MS):
        assert lag.late_ns((JOY,), at_ns + ahead_ns, at_ns + 2 * MS) == 0
    assert lag.late_ns((JOY,), 104 * S + ahead_ns, 107 * S) == 3 * S - 2 * MS
    assert lag.late_ns((JOY,), 107 * S + ahead_ns, 107 * S + 5 * MS) == 3 * MS


def test_the_first_of_a_publisher_and_one_of_unknown_time_are_not_late() -> None:
    lag = Lag()
    assert lag.late_ns((JOY,), 100 * S, 100 * S) == 0
    assert lag.late_ns((JOY,), 0, 101 * S) == 0
    assert lag.late_ns((NAV,), 90 * S, 102 * S) == 0


@pytest.mark.parametrize("quiet_s", [6, 20, 3600])
def test_what_is_sent_again_is_late_however_long_its_publisher_was_quiet(quiet_s: int) -> None:
    lag = Lag()
    for at_ns in range(100 * S, 108 * S, 50 * MS):
        assert lag.late_ns((JOY,), at_ns, at_ns + 2 * MS) == 0
    pressed_ns = (108 + quiet_s) * S
    for n in range(10):
        assert lag.late_ns((JOY,), pressed_ns + n * 50 * MS, pressed_ns + 8 * S + n * MS) > 7 * S
    assert lag.late_ns((JOY,), pressed_ns + 9 * S, pressed_ns + 9 * S + 2 * MS) == 0, "what is pressed now"


@pytest.mark.parametrize("quiet_s", [-3, -2, 0, 3, 20])
def test_a_link_that_is_lost_again_and_again_makes_no_delay_the_usual_one(quiet_s: int) -> None:
    """Nothing but what was sent again arrives between the losses, which begin every 6 s and `quiet_s`."""
    lag = Lag()
    assert lag.late_ns((JOY,), 100 * S, 100 * S + 2 * MS) == 0
    pressed_ns = 101 * S
    for _ in range(5):
        for n in range(10):
            assert lag.late_ns((JOY,), pressed_ns + n * 50 * MS, pressed_ns + 6 * S + n * MS) > 5 * S
        pressed_ns += (6 + quiet_s) * S


@pytest.mark.parametrize("step_ns", [-3600 * S, 3600 * S])
@pytest.mark.parametrize("publisher_s", [False, True])
def test_a_clock_that_steps_is_followed(step_ns: int, publisher_s: bool) -> None:
    lag = Lag()
    refused = []
    for n in range(400):
        stepped_ns = step_ns if n >= 100 else 0
        sent_ns = 100_000 * S + n * 50 * MS + stepped_ns * publisher_s
        received_ns = 100_000 * S + n * 50 * MS + stepped_ns * (not publisher_s)
        if lag.late_ns((JOY,), sent_ns, received_ns) > 300 * MS:
            refused.append(n)
    assert not refused or (refused[0] == 100 and refused[-1] - 100 <= 2 * WINDOW_NS // (50 * MS))


def test_clocks_that_drift_apart_refuse_nothing() -> None:
    lag = Lag()
    for n in range(200_000):
        sent_ns = 100_000 * S + n * 50 * MS
        assert lag.late_ns((JOY,), sent_ns, sent_ns + n * 5000) < MS  # 100 ppm, for three hours


def test_a_stop_is_asked_for_once_more_when_the_names_are_known() -> None:
    asking = Asking()
    nameless = rivals(causes.ROS_ARM_PUBLISHERS, [NAV, Publisher("", TWIST)])
    known = rivals(causes.ROS_ARM_PUBLISHERS, [NAV, JOY])
    assert asking.due(nameless, False, S)
    assert not asking.due(nameless, True, S + STOP_AGAIN_NS)
    assert asking.due(known, True, S + STOP_AGAIN_NS + 1)
    assert not asking.due(known, True, 2 * S)
    assert not asking.due(nameless, True, 2 * S), "a third is not named anew"
    assert not asking.due("", False, 3 * S)
    assert asking.due(nameless, False, 3 * S + 1)
    latched, later = (causes.ROS_ARM_PUBLISHERS(each.given, "ros2", 77) for each in (nameless, known))
    assert causes.completed(latched, later)
    assert not causes.completed(later, latched)
    assert not causes.completed(later, later), "once"
    assert not causes.completed(latched, causes.ROS_ARM_PUBLISHERS(known.given, "ros2", 78)), "another program's"
    assert not causes.completed(latched, causes.ROS_PUBLISHERS(known.given, "ros2", 77)), "of another topic"
    assert not causes.completed(latched, causes.PIPED(known))
    assert not causes.completed(causes.PIPED(nameless), later)


def test_a_stop_is_owed_until_a_run_has_heard_it() -> None:
    def state(run: str, epoch: int, state: State) -> State:
        return dataclasses.replace(state, epoch=epoch, run=run)

    free, latched = states.state(), states.latched(causes.KEY(1))
    again_ns = S + STOP_AGAIN_NS
    owed = Owed()
    assert not owed.due(state("a", 3, free), S), "nothing was requested"
    # One that is latched already, or whose supervisor has died, is no proof.
    for before in (free, latched):
        owed.asked(state("a", 3, before), S, sent=True)
        assert not owed.due(state("a", 3, before), again_ns - 1)
        assert not owed.due(None, again_ns), "no service runs"
        assert owed.due(state("a", 3, latched), again_ns)
        assert owed.due(state("b", 1, free), again_ns), "a new run begins without it"
        assert not owed.due(state("a", 4, free), again_ns), "heard, and reset meanwhile"
        assert not owed.due(state("b", 1, free), 2 * again_ns)
    owed.asked(None, S, sent=True)
    assert owed.due(state("a", 0, free), again_ns)
    assert not owed.due(state("a", 1, latched), again_ns)
    owed.asked(state("a", 3, free), S, sent=False)
    assert owed.due(state("a", 4, latched), again_ns), "that was another stop"


class CountingHandle:
    """rclpy's internal object behind a node, of some release."""

    def __init__(self, count: Callable[[str], object]) -> None:
        self.get_count_publishers = count


@pytest.mark.parametrize(
    ("handle", "internal"),
    [
        (CountingHandle(lambda topic: 2), True),
        (CountingHandle(lambda topic: None), False),
        (CountingHandle(lambda: 2), False),  # type: ignore[arg-type, misc]
        (object(), False),
        (None, False),
    ],
    ids=["as known", "another result", "other arguments", "no such call", "no handle"],
)
def test_the_publishers_are_counted_by_what_this_rclpy_has(handle: object, internal: bool) -> None:
    node = SimpleNamespace(handle=handle, count_publishers=lambda topic: 7)
    assert graph._counter(node, "/cmd_vel")("/cmd_vel") == (2 if internal else 7)


def test_a_node_without_a_handle_counts_too() -> None:
    assert graph._counter(SimpleNamespace(count_publishers=lambda topic: 7), "/cmd_vel")("/cmd_vel") == 7
