"""Arm: moves the robot's arm from Python. Angles are in rad. Joints are named as in the settings ([joints.NAME])."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from time import monotonic_ns
from typing import Any

from failstop.api.errors import FailstopError, Refused
from failstop.api.session import Progress, Session, sleep_through
from failstop.api.snapshot import ArmState
from failstop.messages import records
from failstop.policy.capsules import Model, on_the_way, would_hit
from failstop.policy.joints import Joint, too_far
from failstop.policy.settings import Settings

Point = tuple[float, Mapping[str, float]]
POSES = {"drive": records.ARM_DRIVE, "tuck": records.ARM_TUCK}


class Arm:
    """Moves the robot's arm. Get it as `robot.arm`. The arm does not move while a stop is latched. If the board
    can't move the arm and the wheels together, the arm also does not move while motion is enabled. If two programs try
    to move the arm at the same time, a stop is latched."""

    def __init__(self, session: Session) -> None:
        """Raises FailstopError if the robot's settings name no joints."""
        self._session = session
        _ = self.joints

    @property
    def joints(self) -> dict[str, Joint]:
        """The joints by name, each with its range (range_rad). They are read again at each access, because a restart of
        the service may change them. Raises NoService, FailstopError."""
        with self._session._lock:
            found = self._session._current().joints
        if not found:
            raise FailstopError(f"the robot of {self._session.name!r} has no arm: its settings name no [joints.NAME]")
        return found

    def _ask(self, verb: int, progress: Progress = None, about: tuple[Any, ...] = (), asked_ns: int = 0) -> str:
        return sleep_through(self._session._asking(verb, progress, about, asked_ns=asked_ns))

    def move(
        self,
        to: Mapping[str, float] | Sequence[Point],
        over_s: float = 0.0,
        *,
        speed: float = 1.0,
        progress: Progress = None,
    ) -> str:
        """Move the arm to these angles, and return when a reading confirms that the arm has reached them.

        `to`: one set of angles, or a trajectory as a list of points (seconds from the start, angles). Every point must
        name the same joints. `over_s`: the time for one set of angles; with 0 the arm moves as fast as `speed` allows.
        `speed`: the share of each joint's highest speed to use. `progress`: called with each text about the progress.

        Raises ValueError for an unknown joint. Raises Refused before the move if an angle is out of range, the move
        would be too fast, the arm would hit something, or a stop is latched. If the board can't move the arm and the
        wheels together, it also raises Refused while motion is enabled. Raises Refused during the move if arm.hold(), a
        later request or a stop ends the move, or if a servo does not answer or follow.
        """
        asked_ns = monotonic_ns()  # another request may be made while the whole way is checked
        points = [(over_s, to)] if isinstance(to, Mapping) else to
        if not points:
            raise ValueError("a trajectory needs at least one point")
        names = list(points[0][1])
        servos = [joint.servo for joint in self._named(points[0][1])]
        rows = []
        for t_s, angles in points:
            if set(angles) != set(names):
                raise ValueError(f"the point at {t_s:g} s has other joints than the first: {', '.join(angles)}")
            self._check(angles)
            rows.append((float(t_s), [float(angles[name]) for name in names]))
        self._check_way([(t_s, dict(zip(names, angles, strict=True))) for t_s, angles in rows])
        return self._ask(records.ARM_MOVE, progress, ("arm_path", speed, servos, rows), asked_ns)

    def pose(self, name: str, progress: Progress = None) -> str:
        """Move the arm slowly (setting arm.pose_speed) to a pose from the settings, "drive" or "tuck". Raises Refused,
        ValueError."""
        if name not in POSES:
            raise ValueError(f"no pose {name!r}: the poses are {' and '.join(POSES)}")
        asked_ns = monotonic_ns()
        ends = {joint.name: joint.rad(at) for joint in self.joints.values() if (at := getattr(joint, name)) >= 0}
        if ends:
            self._check_way([(0.0, ends)])
        return self._ask(POSES[name], progress, asked_ns=asked_ns)

    def follow(self, to: Mapping[str, float]) -> None:
        """Move the arm toward these angles, and return at once. Repeat the call, because the arm stops if no new call
        comes within the setting arm.goal_timeout_s. State.arm shows whether the arm moves, and if not, why. Raises
        Refused for an angle out of range."""
        self._check(to)
        self._goal(records.ARM_FOLLOW, to)

    def jog(self, rates: Mapping[str, float]) -> None:
        """Turn joints at these rates (rad/s), and return at once. Repeat the call, because the joints stop if no new
        call comes within the setting arm.goal_timeout_s. Raises Refused for a rate that is not finite."""
        for name, rate in rates.items():
            if not isfinite(rate):
                raise Refused(f"joint {name} at {rate:g} rad/s: every rate must be finite")
        self._goal(records.ARM_JOG, rates)

    def _goal(self, mode: int, values: Mapping[str, float]) -> None:
        found = {joint.servo: float(value) for joint, value in self._named(values).items()}
        with self._session._lock:
            self._session._client().write("arm_goal", mode, found, wake=True)

    def hold(self) -> str:
        """Stop the arm where it is, and drop all goals. The torque stays on. If Robot.enable() is moving the arm to its
        drive pose, then enable() fails, and motion stays disabled."""
        return self._ask(records.ARM_HOLD)

    def release(self) -> str:
        """Switch the torque off. The arm then falls, and may drop what it holds. Raises Refused while a stop is
        latched. If the board can't move the arm and the wheels together, it also raises Refused while motion is
        enabled."""
        return self._ask(records.ARM_RELEASE)

    def read(self, progress: Progress = None) -> dict[str, float]:
        """Read where each joint is, and return the angles by name, in rad. Raises Refused."""
        self._ask(records.ARM_READ, progress)
        return {name: angle for name, joint in self.state.joints.items() if (angle := joint.angle_rad) is not None}

    @property
    def state(self) -> ArmState:
        """The state of the arm (State.arm). Raises FailstopError if the service reports no arm."""
        found = self._session.state.arm
        if found is None:
            raise FailstopError(f"the service {self._session.name!r} reports no arm: see `failstop status`")
        return found

    def _check_way(self, rows: list[tuple[float, dict[str, float]]]) -> None:
        """Check the whole path of a move, from the arm's present position, before the move begins. Raises Refused if
        the arm would hit something.

        The client does this check, because it takes many milliseconds and the gate must always be ready to stop the
        wheels. The gate checks only the end of each small step before it sends that step.
        """
        settings = Settings(dict(self._session.settings))
        if not settings.on("arm.collision"):
            return
        start = {name: joint.at_rad or 0.0 for name, joint in self.state.joints.items()}
        if hit := on_the_way(Model(settings), start, rows):
            raise Refused(would_hit(*hit[1:], f"after {hit[0]:.2f} s " if rows[-1][0] else ""))

    def _named(self, values: Mapping[str, float]) -> dict[Joint, float]:
        joints = self.joints
        if unknown := [name for name in values if name not in joints]:
            raise ValueError(f"no joint {unknown[0]!r}: the joints are {', '.join(joints)}")
        return {joints[name]: value for name, value in values.items()}

    def _check(self, angles: Mapping[str, float]) -> None:
        if fault := too_far(self._named(angles)):
            raise Refused(fault)
