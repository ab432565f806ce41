"""The arm in ROS 2: goals, poses, hold and release. Each request is sent to the service in its own thread.

The arm takes seconds to answer. No callback may wait that long, because the executor has only one thread, which also
serves the bridge's interlock and its commands. So a job waits in another thread.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from time import monotonic_ns
from typing import Any

from failstop.api.errors import FailstopError, Refused
from failstop.api.robot import Robot
from failstop.policy import causes
from failstop.ros2 import report, words
from failstop.ros2.alive import Unwatched
from failstop.ros2.awake import Awake
from failstop.ros2.commanders import Asking, names, reason, rivals
from failstop.ros2.contract import ARM_ACTION, ARM_BUSY, ARM_GOAL, ARM_SERVICES
from failstop.ros2.fill import fill, type_of
from failstop.ros2.graph import latch, publishers
from failstop.ros2.job import Job
from failstop.ros2.link import RobotLink
from failstop.ros2.shared import Shared
from failstop.ros2.stamps import Stamps
from failstop.ros2.trajectory import TrajectoryFace, Way, way
from failstop.ros2.turn import Turn

BUSY_NS = 100_000_000
END_S = 1.0


class ArmFace:
    """The arm's topics, services and action."""

    def __init__(
        self,
        node: Any,
        qos: Any,
        group: Any,
        link: RobotLink,
        shared: Shared,
        stamps: Stamps,
        waited_ns: Callable[[], int],
        awake: Awake,
    ) -> None:
        """`link`: the executor's connection, for requests that take no time. `waited_ns`: returns how long the current
        message has waited for its callback."""
        self._node = node
        self._link = link
        self._shared = shared
        self._stamps = stamps
        self._asking = RobotLink(link.name)
        """The connection of the jobs. They share it, so that they move the arm as one client."""
        self._newest = 0
        """The number of the newest request. A job does nothing if a later request arrived before it began."""
        self._holds: list[Job] = []
        """Jobs that hold the arm. If one of them fails, a stop is latched."""
        self._goal_job: Job | None = None
        self._sender: Unwatched | None = None
        """Watches the sender of the topic's goal while the arm moves to that goal. Otherwise None."""
        self._way_job: Job | None = None
        """The job of the action's goal."""
        self._waited_ns = waited_ns
        self._awake = awake
        self.goal_timeout_s = 0.5
        """How old a goal may be, s (setting arm.goal_timeout_s). An older goal is refused."""
        self.unwatched_s = 3.0
        """The longest allowed duration of a goal from the topic, s (setting arm.unwatched_s)."""
        self._busy_ns = 0
        self._asking_stop = Asking()
        kind = type_of(ARM_BUSY.type)
        self._busy, self._message = node.create_publisher(kind, ARM_BUSY.name, qos(ARM_BUSY.qos)), kind()
        self._topic = self._subscribe(qos(ARM_GOAL.qos))
        """The full name of the topic of goals. Empty if the topic can't be subscribed to."""
        self._offer_services(group)
        self._action = self._offer_action(group)

    def _subscribe(self, qos: Any) -> str:
        try:
            goal = self._node.create_subscription(type_of(ARM_GOAL.type), ARM_GOAL.name, self._goal, qos)
        except FailstopError as error:
            self._node.get_logger().warning(f"{ARM_GOAL.name} can't be received: {error}")
            return ""
        return str(goal.topic_name)

    def _offer_services(self, group: Any) -> None:
        acts = (_read, lambda robot: robot.arm.pose("drive"), lambda robot: robot.arm.pose("tuck"), _hold, _release)
        for service, act in zip(ARM_SERVICES, acts, strict=True):
            self._node.create_service(type_of(service.type), service.name, self._answerer(act), callback_group=group())

    def _offer_action(self, group: Any) -> TrajectoryFace | None:
        """The action's server. None if this ROS lacks the action's type."""
        try:
            return TrajectoryFace(self._node, group, self._shared, self.go, self.hold_way, lambda: self.goal_timeout_s)
        except FailstopError as error:
            self._shared.lacks = (f"{ARM_ACTION.name} is not offered: {error}",)
            self._node.get_logger().info(self._shared.lacks[0])
            return None

    def give_up(self) -> int:
        """Drop requests that have not begun yet. Returns the number for a new request."""
        self._newest += 1
        return self._newest

    def begin(self, act: Callable[[Robot], Any]) -> Job:
        """Send the service a request that takes time, in a job. It replaces earlier requests that have not begun yet,
        except for reads and releases. A read or a release replaces nothing. A hold is sent at once."""
        if act in (_read, _release):
            return Job(self._asking, act)
        number = self.give_up()

        def newest(robot: Robot) -> Any:
            if number != self._newest:
                raise Refused("a later request took its place")
            return act(robot)

        # A hold goes through the executor's connection at once, because it must not wait for a job.
        return Job(self._link, act, at_once=True) if act is _hold else Job(self._asking, newest)

    def go(self, path: Way, told: Callable[[str], None]) -> Job:
        """Begin to move to a goal of the action. `told` is called with the progress. Raises Refused, for example if
        another goal is active."""
        if old := self._old():
            raise Refused(old)
        if cause := self.rivals():
            raise Refused(cause)
        if self._under_way():
            raise Refused("the arm is on its way to another goal: cancel that first")
        self._way_job = self.begin(lambda robot: robot.arm.move(path, progress=told))
        return self._way_job

    def _under_way(self) -> bool:
        return any(job and not job() for job in (self._goal_job, self._way_job))

    def hold_way(self) -> None:
        """Hold the arm if the action's goal is still moving it."""
        if self._way_job and not self._way_job():
            self._hold_now()

    def _hold_now(self) -> None:
        self._holds.append(self.begin(_hold))

    def _answerer(self, act: Callable[[Robot], Any]) -> Any:
        async def answer(_request: Any, response: Any) -> Any:
            try:
                # A hold and a read are never too old, because they start no motion.
                if act not in (_read, _hold):
                    self._awake.check_request()
                job = self.begin(act)
                while not job():
                    await Turn()
                response.success, response.message = True, str(job.result())
            except FailstopError as error:
                response.success, response.message = False, words.refused(error)
            return response

        return answer

    def poll(self, now_ns: int) -> None:
        """Do everything that is due for the arm: publish whether it moves, watch who publishes goals, and log failed
        goals. Call it whenever the watch runs."""
        if now_ns - self._busy_ns >= BUSY_NS:
            self._busy_ns = now_ns
            self._busy.publish(fill(self._message, {"data": report.busy(self._shared.state)}))
        self.rivals()
        self._watch_sender(now_ns)
        for job in [job for job in self._holds if job()]:
            self._holds.remove(job)
            try:
                job.result()
            except FailstopError as error:
                latch(self._node, self._link, reason(causes.ROS_ARM_NOT_HELD, str(error)))
        if self._goal_job and self._goal_job():
            job, self._goal_job = self._goal_job, None
            try:
                job.result()
            except FailstopError as error:
                self._node.get_logger().warning(f"{ARM_GOAL.name}: {words.refused(error)}")

    def _old(self, waited_ns: int = 0) -> str:
        """Why the current goal is too old. Empty if it is not. `waited_ns`: the least time that it has waited."""
        waited_ns = self._awake.waited_ns(waited_ns)
        return words.waited(waited_ns / 1e9) if waited_ns > self.goal_timeout_s * 1e9 else ""

    def _watch_sender(self, now_ns: int) -> None:
        """Hold the arm if the sender of its goal is no longer alive."""
        if self._sender is None or self._goal_job is None or self._goal_job():
            self._sender = None
        elif gone := self._sender.look(self._node.count_publishers(self._topic), now_ns):
            self._sender = None
            self._node.get_logger().warning(f"{ARM_GOAL.name}: {gone}, so the arm is held")
            self._hold_now()

    def rivals(self) -> str:
        """If more than one node publishes goals, request a stop and return its cause. Otherwise return ""."""
        cause = ""
        if self._topic and self._node.count_publishers(self._topic) > 1:
            cause = rivals(causes.ROS_ARM_PUBLISHERS, sorted(publishers(self._node, self._topic)))
        state = self._shared.state
        if self._asking_stop.due(cause, state is not None and state.estop is not None, monotonic_ns()):
            latch(self._node, self._link, cause)
        return cause

    def _goal(self, message: Any) -> None:
        try:
            if cause := self.rivals():
                raise Refused(cause)
            self._accept_goal(message)
        except FailstopError as error:
            self._node.get_logger().warning(f"{ARM_GOAL.name}: {words.refused(error)}")

    def _late(self, stamp: Any) -> str:
        """Why a goal is refused because of its stamp. Empty if it is accepted."""
        who = names(publishers(self._node, self._topic))
        return self._stamps.late(ARM_GOAL.name, who, stamp, self.goal_timeout_s, monotonic_ns())

    def _accept_goal(self, message: Any) -> None:
        """Start the arm's goal, or hold the arm if the goal has no points. Raises FailstopError."""
        if not message.points:
            self._hold_now()
            return
        if old := self._old(self._waited_ns()) or self._late(message.header.stamp):
            raise Refused(old)
        path = way(message)
        if (takes_s := path[-1][0]) > self.unwatched_s:
            raise Refused(words.unwatched(takes_s, self.unwatched_s))
        if self._way_job and not self._way_job():
            raise Refused(f"{ARM_ACTION.name} moves the arm")
        self._sender = Unwatched(monotonic_ns(), self.unwatched_s)
        self._goal_job = self.begin(lambda robot: robot.arm.move(path))

    def close(self) -> None:
        """Close the connection. The arm is then held if it was moving."""
        self._asking.close()
        if self._action:
            self._action.close()


def _read(robot: Robot) -> str:
    return json.dumps(robot.arm.read())


def _hold(robot: Robot) -> str:
    return robot.arm.hold()


def _release(robot: Robot) -> str:
    return robot.arm.release()
