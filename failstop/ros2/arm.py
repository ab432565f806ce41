"""The arm's face: goals, poses, hold and release, each asked of the service by a thread of its own.

An answer of the arm's takes seconds. The executor has one thread, and the bridge's interlock and commands go through
it, so nothing here waits in it: a job runs beside it, and whoever asked is answered when it has ended.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from time import monotonic_ns
from typing import Any

from failstop.api.errors import FailstopError, Refused
from failstop.api.robot import Robot
from failstop.ros2 import report, words
from failstop.ros2.alive import Unwatched
from failstop.ros2.commanders import FRESH_NS, Asking, names, rivals
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
    """Its subscription, publisher and services."""

    def __init__(
        self,
        node: Any,
        qos: Any,
        group: Any,
        link: RobotLink,
        shared: Shared,
        stamps: Stamps,
        waited_ns: Callable[[], int],
    ) -> None:
        """`link`: of the executor's thread, for what is done at once; `waited_ns`: how long the message at hand has
        waited for its callback."""
        self._node = node
        self._link = link
        self._shared = shared
        self._stamps = stamps
        self._asking = RobotLink(link.name)
        """Of the jobs: one client moves the arm, however many of its jobs have ended."""
        self._newest = 0
        """Of what was asked for: a job that has not begun when a later one is asked for does nothing."""
        self._holds: list[Job] = []
        """For the action, whose end they are to be."""
        self._goal_job: Job | None = None
        self._sender: Unwatched | None = None
        """The sender of the topic's goal that the arm is on its way to; None: it is held already."""
        self._way_job: Job | None = None
        """Of the action's goal."""
        self._waited_ns = waited_ns
        self.goal_timeout_s = 0.5
        """A goal older than this starts nothing (arm.goal_timeout_s)."""
        self.unwatched_s = 3.0
        """A goal of the topic takes this long at most (arm.unwatched_s)."""
        self._turned_ns = monotonic_ns()
        self._since_ns = 0
        """Goals that came before this may have lain in the kernel while this node did not run, for `_away_ns`."""
        self._away_ns = 0
        self._busy_ns = 0
        self._asking_stop = Asking()
        kind = type_of(ARM_BUSY.type)
        self._busy, self._message = node.create_publisher(kind, ARM_BUSY.name, qos(ARM_BUSY.qos)), kind()
        self._topic = ""
        try:
            goal = node.create_subscription(type_of(ARM_GOAL.type), ARM_GOAL.name, self._goal, qos(ARM_GOAL.qos))
            self._topic = goal.topic_name
        except FailstopError as error:
            node.get_logger().warning(f"{ARM_GOAL.name} is not heard: {error}")
        acts = (_read, lambda robot: robot.arm.pose("drive"), lambda robot: robot.arm.pose("tuck"), _hold, _release)
        for service, act in zip(ARM_SERVICES, acts, strict=True):
            node.create_service(type_of(service.type), service.name, self._answerer(act), callback_group=group())
        self._action: TrajectoryFace | None = None
        try:
            self._action = TrajectoryFace(node, group, shared, self.go, self.hold_way, lambda: self.goal_timeout_s)
        except FailstopError as error:
            shared.lacks = (f"{ARM_ACTION.name} is not offered: {error}",)
            node.get_logger().info(shared.lacks[0])

    def give_up(self) -> int:
        """Drop requests that have not begun. Returns the number of the new one."""
        self._newest += 1
        return self._newest

    def begin(self, act: Callable[[Robot], Any]) -> Job:
        """Ask the service for what takes time, in the place of what was asked for before."""
        if act in (_read, _release):
            return Job(self._asking, act)
        number = self.give_up()

        def newest(robot: Robot) -> Any:
            if number != self._newest:
                raise Refused("a later request took its place")
            return act(robot)

        # Of the executor's client, whose enable a stop or a disable may follow: a hold must not wait for a job.
        return Job(self._link, act, at_once=True) if act is _hold else Job(self._asking, newest)

    def go(self, path: Way, told: Callable[[str], None]) -> Job:
        """The action's goal, which two are not at once. Raises Refused."""
        if old := self._old():
            raise Refused(old)
        if cause := self.rivals():
            raise Refused(cause)
        if self._under_way():
            raise Refused("the arm is on its way to another goal: cancel that first")
        self._way_job = self.begin(lambda robot: robot.arm.move(path, told=told))
        return self._way_job

    def _under_way(self) -> bool:
        return any(job and not job() for job in (self._goal_job, self._way_job))

    def hold_way(self) -> None:
        """Hold the arm, if the action moves it still."""
        if self._way_job and not self._way_job():
            self._hold_now()

    def _hold_now(self) -> None:
        self._holds.append(self.begin(_hold))

    def _answerer(self, act: Callable[[Robot], Any]) -> Any:
        async def answer(_request: Any, response: Any) -> Any:
            job = self.begin(act)
            while not job():
                await Turn()
            try:
                response.success, response.message = True, str(job.result())
            except FailstopError as error:
                response.success, response.message = False, words.refused(error)
            return response

        return answer

    def follow(self, now_ns: int) -> None:
        """With every turn of the watch: whether it moves, who else sends goals, and how the last goal ended."""
        self._turned(now_ns)
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
                latch(self._node, self._link, f"the arm could not be held: {error}")
        if self._goal_job and self._goal_job():
            job, self._goal_job = self._goal_job, None
            try:
                job.result()
            except FailstopError as error:
                self._node.get_logger().warning(f"{ARM_GOAL.name}: {words.refused(error)}")

    def _turned(self, now_ns: int) -> None:
        """This node runs. Whoever was held up for longer than a goal counts takes what it finds for old: how long that
        has lain in the kernel nobody knows."""
        if now_ns - self._turned_ns > self.goal_timeout_s * 1e9:
            self._since_ns, self._away_ns = now_ns + FRESH_NS, now_ns - self._turned_ns
        self._turned_ns = now_ns

    def _old(self, waited_ns: int = 0) -> str:
        """Why the goal at hand, which is known to have waited so long, starts nothing; empty: it is young enough."""
        now_ns = monotonic_ns()
        self._turned(now_ns)
        if now_ns - waited_ns < self._since_ns:
            waited_ns = self._away_ns
        return words.waited(waited_ns / 1e9) if waited_ns > self.goal_timeout_s * 1e9 else ""

    def _watch_sender(self, now_ns: int) -> None:
        """Hold the arm for a goal of the topic whose sender can't be seen to live."""
        if self._sender is None or self._goal_job is None or self._goal_job():
            self._sender = None
        elif gone := self._sender.look(self._node.count_publishers(self._topic), now_ns):
            self._sender = None
            self._node.get_logger().warning(f"{ARM_GOAL.name}: {gone}: held")
            self._hold_now()

    def rivals(self) -> str:
        """The cause of the stop while more than one node publishes goals, which is asked for here; empty: there is one
        at most."""
        cause = ""
        if self._topic and self._node.count_publishers(self._topic) > 1:
            cause = rivals(ARM_GOAL.name, sorted(publishers(self._node, self._topic)))
        state = self._shared.state
        if self._asking_stop.due(cause, state is not None and state.estop is not None, monotonic_ns()):
            latch(self._node, self._link, cause)
        return cause

    def _goal(self, message: Any) -> None:
        try:
            if cause := self.rivals():
                raise Refused(cause)
            self._take_goal(message)
        except FailstopError as error:
            self._node.get_logger().warning(f"{ARM_GOAL.name}: {words.refused(error)}")

    def _late(self, stamp: Any) -> str:
        """Why a goal is refused for its stamp; empty: it is not."""
        who = names(publishers(self._node, self._topic))
        return self._stamps.late(ARM_GOAL.name, who, stamp, self.goal_timeout_s, monotonic_ns())

    def _take_goal(self, message: Any) -> None:
        """Raises FailstopError."""
        if not message.points:
            self._goal_job = self.begin(_hold)
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
        """Give its connection back: what it moved is held."""
        self._asking.close()
        if self._action:
            self._action.close()


def _read(robot: Robot) -> str:
    return json.dumps(robot.arm.read())


def _hold(robot: Robot) -> str:
    return robot.arm.hold()


def _release(robot: Robot) -> str:
    return robot.arm.release()
