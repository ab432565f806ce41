"""Trajectory: the action FollowJointTrajectory, for planners such as MoveIt. Offered where this ROS has control_msgs.

A goal is accepted when the gate has taken it, and rejected in the gate's words, which the log has: the protocol of
actions has no place for them. Positions and times count; velocities, accelerations and tolerances of the goal do not,
since the settings of the service have them.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from math import nan
from time import monotonic_ns
from typing import TYPE_CHECKING, Any

from failstop.api.errors import FailstopError
from failstop.ros2 import words
from failstop.ros2.contract import ARM_ACTION
from failstop.ros2.fill import fill, type_of
from failstop.ros2.turn import Turn

if TYPE_CHECKING:
    from failstop.api.snapshot import ArmState
    from failstop.ros2.arm import ArmFace, Job
    from failstop.ros2.shared import Shared

FEEDBACK_NS = 100_000_000
"""The state is as new as this."""
FEEDBACK = f"{ARM_ACTION.name}/_action/feedback"
"""Every client of the action hears it, so that the end of the last one is seen."""
DISCOVERY_NS = 1_000_000_000
"""By then a client that has sent a goal is known to hear of it."""
Way = list[tuple[float, dict[str, float]]]


def way(trajectory: Any) -> Way:
    """A JointTrajectory as Arm.move takes it. Raises FailstopError for one that makes no sense."""
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
        points = points[1:]  # where it is said to begin; it begins where it is
    return [(t_s, dict(zip(names, positions, strict=True))) for t_s, positions in points]


def positions(names: Sequence[str], arm: ArmState | None) -> tuple[list[float], list[float]]:
    """Where each joint is to be now, and where it was read to be last; NaN: not known."""
    joints = [arm.joints.get(name) if arm else None for name in names]
    return (
        [nan if joint is None or joint.commanded_rad is None else joint.commanded_rad for joint in joints],
        [nan if joint is None or joint.angle_rad is None else joint.angle_rad for joint in joints],
    )


class TrajectoryFace:
    """The action's server. One goal at a time: a second one is rejected while the first is under way."""

    def __init__(self, node: Any, group: Any, arm: ArmFace, shared: Shared) -> None:
        """Raises FailstopError where this ROS has no such action."""
        self._kind = type_of(ARM_ACTION.type)
        from rclpy.action import ActionServer, CancelResponse, GoalResponse

        self._accept, self._reject = GoalResponse.ACCEPT, GoalResponse.REJECT
        self._cancelling = CancelResponse.ACCEPT
        self._node = node
        self._arm = arm
        self._shared = shared
        self._jobs: dict[int, Job] = {}
        """Of goals that were accepted and are not carried out yet, by the identity of the message."""
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
        """A goal: it is asked of the gate, whose answer decides."""
        taken = threading.Event()
        try:
            job = self._arm.go(way(goal.trajectory), lambda _: taken.set())
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
        """The arm is held; the goal ends by that."""
        self._arm.hold_way()
        return self._cancelling

    async def _execute(self, handle: Any) -> Any:
        job = self._jobs.pop(id(handle.request))
        names = list(handle.request.trajectory.joint_names)
        told_ns, gone_ns = 0, monotonic_ns() + DISCOVERY_NS
        while not job():
            if (now_ns := monotonic_ns()) - told_ns >= FEEDBACK_NS:
                told_ns = now_ns
                handle.publish_feedback(self._feedback(names))
                if self._node.count_subscribers(FEEDBACK) > 0:
                    gone_ns = 0
                elif now_ns >= gone_ns:
                    self._node.get_logger().warning(f"{ARM_ACTION.name}: nobody hears of the goal: held")
                    self._arm.hold_way()
                    gone_ns = now_ns + DISCOVERY_NS
            await Turn()
        result = self._kind.Result()
        try:
            result.error_string = str(job.result())
            ended = handle.succeed
        except FailstopError as error:
            result.error_string = words.refused(error)
            # One code for all: which of them it is only the text says.
            result.error_code = self._kind.Result.PATH_TOLERANCE_VIOLATED
            ended = handle.abort
        if handle.is_cancel_requested:
            result.error_code = self._kind.Result.SUCCESSFUL
            ended = handle.canceled
        ended()
        return result

    def _feedback(self, names: list[str]) -> Any:
        state = self._shared.state
        desired, actual = positions(names, state.arm if state else None)
        error = [wanted - there for wanted, there in zip(desired, actual, strict=True)]
        places = {"desired": desired, "actual": actual, "error": error}
        fields = {name: {"positions": values} for name, values in places.items()}
        message = fill(self._kind.Feedback(), {"joint_names": names, **fields})
        message.header.stamp = self._node.get_clock().now().to_msg()
        return message

    def close(self) -> None:
        """Offer it no more."""
        self._server.destroy()
