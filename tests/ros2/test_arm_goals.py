"""Goals of the topic arm/goal, on a node and a service of the test's own: what a hold that fails leads to."""

from __future__ import annotations

import threading
from collections.abc import Callable
from time import monotonic_ns
from types import SimpleNamespace
from typing import Any

import pytest

from failstop.api.errors import FailstopError, NoAnswer
from failstop.policy import causes
from failstop.ros2 import arm
from failstop.ros2.arm import ArmFace
from failstop.ros2.awake import Awake
from failstop.ros2.commanders import Reason
from failstop.ros2.shared import Shared
from failstop.ros2.stamps import Stamps
from tests.support.waiting import until


class Link:
    """A connection to a service that answers no hold, and moves the arm until the test ends the move."""

    name = "none"

    def __init__(self) -> None:
        self.stops: list[str] = []
        self.moved = threading.Event()

    def call(self, act: Callable[[Any], Any], *, at_once: bool = False) -> Any:
        if at_once:
            raise NoAnswer("no answer from the gate")
        self.moved.wait()
        raise FailstopError("held")

    def stop(self, reason: str) -> None:
        self.stops.append(reason)

    def close(self) -> None:
        self.moved.set()


class Node:
    """The parts of a node that the arm needs, with one publisher of goals."""

    def __init__(self) -> None:
        self.publishers = 1
        self.lines: list[str] = []

    def get_logger(self) -> Any:
        return SimpleNamespace(info=self.lines.append, warning=self.lines.append, error=self.lines.append)

    def create_publisher(self, *_: Any) -> Any:
        return SimpleNamespace(publish=lambda message: None)

    def create_subscription(self, kind: Any, topic: str, *_: Any) -> Any:
        return SimpleNamespace(topic_name=f"/{topic}")

    def create_service(self, *_: Any, **__: Any) -> None:
        pass

    def count_publishers(self, _topic: str) -> int:
        return self.publishers

    def get_publishers_info_by_topic(self, _topic: str) -> list[Any]:
        return []


@pytest.fixture
def face(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setattr(arm, "type_of", lambda name: SimpleNamespace)
    monkeypatch.setattr(arm, "RobotLink", lambda name: Link())
    link: Any = Link()
    made = ArmFace(Node(), lambda qos: qos, lambda: None, link, Shared(), Stamps(lambda: 0), lambda: 0, Awake())
    yield made
    made.close()


def goal(*positions: float) -> Any:
    points = [
        SimpleNamespace(positions=[each], time_from_start=SimpleNamespace(sec=1, nanosec=0)) for each in positions
    ]
    stamp = SimpleNamespace(sec=0, nanosec=0)
    return SimpleNamespace(joint_names=["base"], points=points, header=SimpleNamespace(stamp=stamp))


def test_a_goal_without_points_that_holds_nothing_latches_a_stop(face: Any) -> None:
    face._goal(goal())

    def stopped() -> bool:
        face.poll(monotonic_ns())
        return bool(face._link.stops)

    until(stopped, "the stop")
    [cause] = face._link.stops
    assert isinstance(cause, Reason)
    assert cause.row is causes.ROS_ARM_NOT_HELD


def test_a_goal_is_watched_until_it_ends_though_it_was_told_to_hold(face: Any) -> None:
    face._goal(goal(0.1))
    face._goal(goal())
    face.poll(monotonic_ns())
    face._node.publishers = 0
    face.poll(monotonic_ns())
    assert "arm/goal: its publisher has gone, so the arm is held" in face._node.lines
