"""Who may command, on every path: the graph and the time are the test's."""

from __future__ import annotations

import itertools
import random

import pytest

from failstop.ros2.commanders import AGAIN_NS, FRESH_NS, NAMELESS_NS, STOP_AGAIN_NS, Commanders, HeldUp, Publisher
from failstop.ros2.contract import COMMAND_TYPES, STAMPED, TWIST

BOTH = COMMAND_TYPES["auto"]
NAV = Publisher("/nav", TWIST)
JOY = Publisher("/joy", TWIST)
S = 1_000_000_000


def seen(commanders: Commanders, now_ns: int, *publishers: Publisher) -> Commanders:
    """The graph is asked, as the shell does it."""
    if commanders.wants_look(len(publishers), now_ns):
        commanders.look(publishers, now_ns)
    commanders.counted(len(publishers), now_ns)
    return commanders


def test_nobody_and_one() -> None:
    commanders = Commanders(BOTH)
    assert not commanders.holds(S), "never asked"
    assert seen(commanders, S).holds(S)
    assert seen(commanders, S, NAV).passes(S)
    assert commanders.cause(S) == ""
    assert commanders.names() == "/nav"


def test_the_interlock_holds_only_while_the_count_is_fresh() -> None:
    commanders = seen(Commanders(BOTH), S, NAV)
    assert commanders.holds(S + FRESH_NS)
    assert not commanders.holds(S + FRESH_NS + 1)


@pytest.mark.parametrize("second", [JOY, NAV, Publisher("/joy", STAMPED), Publisher("/joy", "x/msg/Y", False)])
def test_two_of_any_type_and_quality(second: Publisher) -> None:
    commanders = seen(Commanders(BOTH), S, NAV, second)
    assert not commanders.passes(S)
    assert not commanders.holds(S)
    assert commanders.cause(S).startswith("multiple cmd_vel publishers: /nav")
    assert "a dead process, which DDS counts for up to 20 s" in commanders.cause(S)


def test_what_comes_just_after_the_second_one_has_left_may_be_its_own() -> None:
    """A reset and an enable may be quicker than its last commands are through the queue."""
    commanders = seen(Commanders(BOTH), S, NAV, JOY)
    seen(commanders, S + FRESH_NS, NAV)
    assert not commanders.passes(S + FRESH_NS)
    assert not commanders.holds(S + FRESH_NS)
    assert commanders.passes(S + FRESH_NS + 1)
    assert commanders.cause(S + FRESH_NS) == "", "no reason for a stop"


def test_names_of_many_and_of_one_that_is_there_twice() -> None:
    assert seen(Commanders(BOTH), S, NAV, JOY).names() == "/nav, /joy"
    assert seen(Commanders(BOTH), S, NAV, NAV).names() == "/nav (2 times)"
    assert seen(Commanders(BOTH), S, NAV, Publisher("", TWIST)).names() == "/nav, a node without a name yet"
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
    commanders = seen(Commanders(BOTH, ["/nav", "teleop", ""]), S, NAV)
    assert commanders.passes(S)
    assert commanders.wants_look(1, S + 1), "another may have taken its place"
    assert seen(commanders, S + 1, Publisher("/left/teleop", TWIST)).passes(S + 1), (
        "a bare name is one in any namespace"
    )
    seen(commanders, S + 2, JOY)
    assert not commanders.passes(S + 2)
    assert not commanders.holds(S + 2)
    assert commanders.cause(S + 2) == "stranger on cmd_vel: /joy (allowed: /nav, teleop)"


def test_a_nameless_one_waits_for_its_name() -> None:
    commanders = Commanders(BOTH, ["/nav"])
    nameless = Publisher("", TWIST)
    seen(commanders, S, nameless)
    assert not commanders.passes(S)
    assert commanders.cause(S) == ""
    seen(commanders, S + NAMELESS_NS - 1, nameless)
    assert commanders.cause(S + NAMELESS_NS - 1) == ""
    seen(commanders, S + NAMELESS_NS, nameless)
    assert commanders.cause(S + NAMELESS_NS).startswith("stranger on cmd_vel: a node without a name yet")
    seen(commanders, S + NAMELESS_NS + 1, NAV)
    assert commanders.passes(S + NAMELESS_NS + 1)
    assert commanders.cause(S + NAMELESS_NS + 1) == ""


def test_what_waited_while_the_bridge_was_held_up_is_old() -> None:
    held_up = HeldUp()
    now_ns = S
    held_up.turn(now_ns)
    assert not held_up.old(now_ns), "the first turn is no wait"
    now_ns += FRESH_NS
    held_up.turn(now_ns)
    assert not held_up.old(now_ns)
    now_ns += FRESH_NS + 1
    held_up.turn(now_ns)
    assert held_up.old(now_ns)
    held_up.turn(now_ns + FRESH_NS - 1)
    assert held_up.old(now_ns + FRESH_NS - 1)
    assert not held_up.old(now_ns + FRESH_NS)


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


def test_whatever_comes_and_goes_no_command_passes_while_two_publish() -> None:
    rng = random.Random(20261122)
    for _ in range(200):
        commanders = Commanders(BOTH, ["/nav", "/joy"] if rng.random() < 0.5 else [])
        there: list[Publisher] = []
        several_ns = -S
        for now_ns in itertools.accumulate(rng.choice((1, 7_000_000, 20_000_000, 300_000_000)) for _ in range(50)):
            if there and rng.random() < 0.4:
                there.pop(rng.randrange(len(there)))
            else:
                there.append(rng.choice((NAV, JOY, Publisher("/x", TWIST), Publisher("", STAMPED, False))))
            seen(commanders, S + now_ns, *there)
            if len(there) > 1:
                several_ns = now_ns
                assert not commanders.passes(S + now_ns)
                assert commanders.cause(S + now_ns)
            elif there and there[0].node in ("/nav", "/joy"):
                assert commanders.passes(S + now_ns) is (now_ns - several_ns > FRESH_NS)
