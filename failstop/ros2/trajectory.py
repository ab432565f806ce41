"""Trajectory: the action FollowJointTrajectory, for planners such as MoveIt. It is offered if this ROS has the package
control_msgs.

A goal is accepted when the gate accepts it. If the gate refuses a goal, the gate's reason is logged, because a
rejection in ROS has no text. Only the positions and times of a goal are used. Its velocities, accelerations and
tolerances are ignored, because the service's settings limit these.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from math import nan
from time import monotonic_ns
from typing import TYPE_CHECKING, Any

from failstop.api.errors import FailstopError, Refused
from failstop.ros2 import words
from failstop.ros2.alive import Alive
from failstop.ros2.contract import ARM_ACTION
from failstop.ros2.fill import fill, type_of
from failstop.ros2.graph import BEST_EFFORT
from failstop.ros2.turn import Turn

if TYPE_CHECKING:
    from failstop.api.snapshot import ArmState, State
    from failstop.ros2.job import Job
    from failstop.ros2.shared import Shared

FEEDBACK_NS = 100_000_000
"""The time between two feedback messages. The state is not read more often either."""
TRAJECTORY_LOOK_NS = 20_000_000
"""How often to look whether the feedback was acknowledged."""
SETTLED_NS = 500_000_000
"""How long the client of an earlier goal may take to acknowledge the last feedback. If it takes longer, it is dead or
suspended."""
FEEDBACK = f"{ARM_ACTION.name}/_action/feedback"
"""The topic of the action's feedback. Every client of the action receives it."""
UNSETTLED = "a node that received an earlier goal is dead or stopped, and DDS counts it for up to 20 s: try again then"
Way = list[tuple[float, dict[str, float]]]


def way(trajectory: Any) -> Way:
    """Turn a JointTrajectory into a path for Arm.move(). Raises FailstopError if it makes no sense."""
    names = list(trajectory.joint_names)
    if len(set(names)) != len(names):
        raise FailstopError("a joint is named twice")
    points = [
        (point.time_from_start.sec + point.time_from_start.nanosec / 1e9, list(point.positions))
        for point in trajectory.points
    ]
    if not points or not names:
        raise FailstopError("a trajectory needs at least one joint and one point")
    if any(len(positions) != len(names) for _, positions in points):
        raise FailstopError("a point without a position for each joint")
    if len(points) > 1 and points[0][0] == 0.0:
        points = points[1:]  # the first point is only the start, and the arm starts where it is
    return [(t_s, dict(zip(names, positions, strict=True))) for t_s, positions in points]


def positions(names: Sequence[str], arm: ArmState | None) -> tuple[list[float], list[float]]:
    """For each joint, the commanded angle and the angle that was last read, rad. NaN if an angle is not known."""
    joints = [arm.joints.get(name) if arm else None for name in names]
    return (
        [nan if joint is None or joint.commanded_rad is None else joint.commanded_rad for joint in joints],
        [nan if joint is None or joint.angle_rad is None else joint.angle_rad for joint in joints],
    )


class Feedback:
    """Publishes the action's feedback, instead of rclpy's action server, and finds out whether every receiver has
    acknowledged it. The publisher keeps only one message, so that DDS asks for the acknowledgement at once."""

    def __init__(self, node: Any, kind: Any) -> None:
        """Raises FailstopError if this ROS can't tell what was acknowledged."""
        from rclpy.duration import Duration
        from rclpy.qos import QoSProfile

        self._node = node
        self._kind = kind
        self._publisher = node.create_publisher(kind.Impl.FeedbackMessage, FEEDBACK, QoSProfile(depth=1))
        self._at_once = Duration(seconds=0)
        try:
            self.acknowledged()
        except Exception as error:
            raise FailstopError(f"this RMW doesn't show whether its client is alive ({error})") from None

    def heard(self) -> int:
        """How many nodes receive the feedback reliably. Other nodes acknowledge nothing."""
        ends = self._node.get_subscriptions_info_by_topic(self._publisher.topic_name)
        return sum(int(end.qos_profile.reliability) != BEST_EFFORT for end in ends)

    def acknowledged(self) -> bool:
        """True if every receiver has acknowledged the last feedback."""
        return bool(self._publisher.wait_for_all_acked(self._at_once))

    def send(self, handle: Any, names: list[str], state: State | None) -> None:
        """Publish the commanded and the last read positions of the goal's joints."""
        desired, actual = positions(names, state.arm if state else None)
        error = [wanted - there for wanted, there in zip(desired, actual, strict=True)]
        places = {"desired": desired, "actual": actual, "error": error}
        fields = {name: {"positions": values} for name, values in places.items()}
        message = self._kind.Impl.FeedbackMessage()
        message.goal_id = handle.goal_id
        fill(message.feedback, {"joint_names": names, **fields})
        message.feedback.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)


class TrajectoryFace:
    """The action's server. It handles one goal at a time, and rejects a second one until the first has ended."""

    def __init__(
        self,
        node: Any,
        group: Any,
        shared: Shared,
        go: Callable[[Way, Callable[[str], None]], Job],
        hold: Callable[[], None],
        timeout_s: Callable[[], float],
    ) -> None:
        """`go(path, told)` asks the gate to follow a path, and calls `told` with the gate's progress. `hold()` holds
        the arm, if the path still moves it. `timeout_s()` returns how long a client may be silent, s. Raises
        FailstopError if this ROS does not have the action, or can't tell what was acknowledged."""
        self._kind = type_of(ARM_ACTION.type)
        from rclpy.action import ActionServer, CancelResponse, GoalResponse

        self._accept, self._reject = GoalResponse.ACCEPT, GoalResponse.REJECT
        self._cancelling = CancelResponse.ACCEPT
        self._node = node
        self._go, self._hold, self._timeout_s = go, hold, timeout_s
        self._shared = shared
        self._jobs: dict[int, Job] = {}
        """The jobs of goals that were accepted but have not ended, by the id of the goal message."""
        self._feedback = Feedback(node, self._kind)
        self._server = ActionServer(
            node,
            self._kind,
            ARM_ACTION.name,
            self._execute,
            callback_group=group(),
            goal_callback=self._asked,
            cancel_callback=self._cancel,
        )

    async def _asked(self, goal: Any) -> Any:
        """Accept or reject a goal, as the gate decides."""
        taken = threading.Event()
        try:
            await self._settle()
            job = self._go(way(goal.trajectory), lambda _: taken.set())
            while not (ended := job()) and not taken.is_set():
                await Turn()
            if ended:
                job.result()
        except FailstopError as error:
            self._node.get_logger().warning(f"{ARM_ACTION.name}: the goal is rejected: {words.refused(error)}")
            return self._reject
        self._jobs[id(goal)] = job
        return self._accept

    def _cancel(self, _handle: Any) -> Any:
        """Hold the arm, which also ends the goal."""
        self._hold()
        return self._cancelling

    async def _settle(self) -> None:
        """Wait until all clients of earlier goals have acknowledged their feedback. Raises Refused after SETTLED_NS.
        The silent client is then dead or suspended. While DDS lists such a client, the client of a new goal can't be
        watched."""
        until_ns = monotonic_ns() + SETTLED_NS
        while not self._feedback.acknowledged():
            if monotonic_ns() > until_ns:
                raise Refused(UNSETTLED)
            await Turn()

    async def _execute(self, handle: Any) -> Any:
        job = self._jobs.pop(id(handle.request))
        names = list(handle.request.trajectory.joint_names)
        told_ns = looked_ns = 0
        client: Alive | None = Alive(monotonic_ns(), self._timeout_s())
        while not job():
            now_ns = monotonic_ns()
            if client and now_ns - looked_ns >= TRAJECTORY_LOOK_NS:
                looked_ns = now_ns
                if gone := client.look(self._feedback.heard(), self._feedback.acknowledged(), now_ns):
                    client = None
                    self._node.get_logger().warning(f"{ARM_ACTION.name}: {gone}, so the arm is held")
                    self._hold()
            if now_ns - told_ns >= FEEDBACK_NS:
                told_ns = now_ns
                self._feedback.send(handle, names, self._shared.state)
            await Turn()
        result = self._kind.Result()
        try:
            result.error_string = str(job.result())
            ended = handle.succeed
        except FailstopError as error:
            result.error_string = words.refused(error)
            # All failures have the same code. The text says what happened.
            result.error_code = self._kind.Result.PATH_TOLERANCE_VIOLATED
            ended = handle.abort
        if handle.is_cancel_requested:
            result.error_code = self._kind.Result.SUCCESSFUL
            ended = handle.canceled
        ended()
        return result

    def close(self) -> None:
        """Close the action's server."""
        self._server.destroy()
