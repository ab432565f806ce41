"""The spinner: what it takes by itself, and what it leaves to rclpy's executor, on rclpy of each kind."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.ros2.scene import RCLPY, Ros

PROGRAM = """
import json
import sys
import time

import rclpy
from rclpy.qos import QoSProfile
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

from failstop.ros2.spinner import Spinner

rclpy.init()
node = rclpy.create_node("spun")
later = CHANGE
heard = []


def answer(_request, response):
    response.success, response.message = True, "answered"
    return response


def spin_until(wanted):
    until_s = time.monotonic() + 20
    while not wanted() and time.monotonic() < until_s:
        spinner.turn(0.05)


node.create_subscription(String, "words", lambda message: heard.append(message.data), QoSProfile(depth=10))
words = node.create_publisher(String, "words", 10)
received = []
spinner = Spinner(node, lambda *about: received.append(about))
spin_until(lambda: words.get_subscription_count())
exec(later)
for text in ("one", "two", "three"):
    words.publish(String(data=text))
sent_ns = time.time_ns()
spin_until(lambda: len(heard) == 3)
waited_s = [abs(sent_ns - at_ns) / 1e9 for about in received if any(about) for at_ns in about]

# What is made later is heard too.
late = node.create_subscription(Bool, "late", lambda message: heard.append(message.data), QoSProfile(depth=10))
publisher = node.create_publisher(Bool, "late", 10)
spin_until(lambda: publisher.get_subscription_count())
publisher.publish(Bool(data=True))
spin_until(lambda: len(heard) == 4)
node.destroy_subscription(late)
spinner.turn(0.0)

client = node.create_client(Trigger, "ask")
node.create_service(Trigger, "ask", answer)
client.wait_for_service(timeout_sec=20.0)
asked = client.call_async(Trigger.Request())
spin_until(asked.done)

turns, until_s = 0, time.monotonic() + 0.5
while time.monotonic() < until_s:
    spinner.turn(0.05)
    turns += 1
print(json.dumps([heard, asked.done() and asked.result().message, spinner.plain, turns, waited_s]))
"""
HEARD = ["one", "two", "three", True]
EXECUTOR = "import rclpy.executors as module; E = module.SingleThreadedExecutor; "
NODE = "import rclpy.handles as module; "
SET = "from rclpy.impl.implementation_singleton import rclpy_implementation as module; "
"""How a change of the stand-in begins."""
CHANGES = {
    "the tasks are elsewhere": EXECUTOR + "del E._pending_tasks",
    "the tasks are of another form": EXECUTOR + "E._pending_tasks = property(lambda self: [1])",
    "no such module": "import sys; sys.modules['rclpy.impl.implementation_singleton'] = None",
    "no WaitSet": SET + "del module.WaitSet",
    "a WaitSet of other sizes": SET + "module.WaitSet.__init__ = lambda self, sizes: None",
    "no clear_entities()": SET + "del module.WaitSet.clear_entities",
    "no wait()": SET + "del module.WaitSet.wait",
    "wait() in seconds, by name": SET + "module.WaitSet.wait = lambda self, *, timeout_s: None",
    "no get_ready_entities()": SET + "del module.WaitSet.get_ready_entities",
    "no add_service()": SET + "del module.WaitSet.add_service",
    "no pointer": NODE + "del module.Handle.pointer",
    "a handle without with": NODE + "del module.Handle.__enter__",
    "no take_message()": NODE + "del module.SubscriptionHandle.take_message",
    "no guards": "del node.guards",
    "no waitables": "del node.waitables",
    "no context.handle": "del node.context.handle",
    "no get_num_entities()": NODE + "del module.Events.get_num_entities",
}
TAKEN = "take = module.SubscriptionHandle.take_message; module.SubscriptionHandle.take_message = "
NEW_FORMS = {
    "a message without times": NODE + TAKEN + "lambda *of: (take(*of) or [None])[0]",
    "times as an object": NODE + TAKEN + "lambda *of: (found := take(*of)) and (found[0], object())",
    "times of other names": NODE + TAKEN + "lambda *of: (found := take(*of)) and (found[0], {})",
    "three results": NODE + TAKEN + "lambda *of: (found := take(*of)) and (found[0], 0, found[1])",
}


def run(ros: Ros, change: str = "''") -> tuple[Any, ...]:
    done = ros.run(sys.executable, "-c", PROGRAM.replace("CHANGE", change))
    assert not done.returncode, done.stderr
    return (*json.loads(done.stdout), done.stderr)


def test_it_hears_answers_and_waits(ros: Ros) -> None:
    heard, answered, plain, turns, waited_s, said = run(ros)
    assert heard == HEARD
    assert answered == "answered"
    assert not plain, said
    assert turns < 30  # it waits when there is nothing
    assert len(waited_s) == 6, "when each was sent and received"
    assert all(wait_s < 20 for wait_s in waited_s)


@pytest.fixture(params=["before", "since"])
def stand_in(request: pytest.FixtureRequest, tmp_path: Path) -> Ros:
    """rclpy before its change #1469, and since."""
    ros = Ros("stand-in", tmp_path)
    ros.environment[RCLPY] = request.param
    return ros


def test_it_knows_where_rclpy_of_each_kind_keeps_its_tasks(stand_in: Ros) -> None:
    heard, answered, plain, _, waited_s, said = run(stand_in)
    assert (heard, answered, plain, len(waited_s)) == (HEARD, "answered", False, 6), said


def fell_back(ros: Ros, change: str) -> None:
    heard, answered, plain, turns, _, said = run(ros, change)
    assert heard == HEARD
    assert answered == "answered"
    assert turns < 30
    assert plain
    assert said.count("its own executor calls everything") == 1, "once"


@pytest.mark.parametrize("change", CHANGES.values(), ids=list(CHANGES))
def test_each_name_that_rclpy_may_change_has_a_fallback(tmp_path: Path, change: str) -> None:
    fell_back(Ros("stand-in", tmp_path), f"exec({change!r}) or ''")


@pytest.mark.parametrize("change", CHANGES.values(), ids=list(CHANGES))
def test_a_name_that_fails_later_has_the_same_fallback(tmp_path: Path, change: str) -> None:
    """The first call of a name may come with the first message, or with the next subscription."""
    fell_back(Ros("stand-in", tmp_path), repr(change))


@pytest.mark.parametrize("change", NEW_FORMS.values(), ids=list(NEW_FORMS))
def test_a_message_that_is_taken_in_an_unknown_form_is_still_heard(tmp_path: Path, change: str) -> None:
    """It may be a stop, and it is out of its queue."""
    fell_back(Ros("stand-in", tmp_path), f"exec({change!r}) or ''")


def test_a_wake_that_cannot_be_replaced_has_a_fallback(tmp_path: Path) -> None:
    change = EXECUTOR + "E.wake = property(lambda self: lambda: None)"
    fell_back(Ros("stand-in", tmp_path), f"exec({change!r}) or ''")


def test_an_entity_that_nobody_tells_of_is_found_within_a_second(tmp_path: Path) -> None:
    heard, answered, plain, *_, said = run(
        Ros("stand-in", tmp_path), repr("type(node)._wake_executor = lambda self: None")
    )
    assert (heard, answered, plain) == (HEARD, "answered", False), said


def test_an_error_of_a_callback_is_no_change_of_rclpy(tmp_path: Path) -> None:
    raising = "property(lambda self: lambda message: {}['no'], lambda self, to: None)"
    change = f"import rclpy.node; rclpy.node.Subscription.callback = {raising}"
    done = Ros("stand-in", tmp_path).run(sys.executable, "-c", PROGRAM.replace("CHANGE", f"exec({change!r}) or ''"))
    assert done.returncode
    assert "KeyError: 'no'" in done.stderr
    assert "its own executor" not in done.stderr
