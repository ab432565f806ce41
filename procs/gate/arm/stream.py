"""Stream: sends each moving joint a move every arm.period_s. Pure.

Each frame has the moves of a few servos. The frames of one period are spread evenly over the period.
"""

from __future__ import annotations

from math import inf

from failstop.board.interface import ServoBus
from failstop.board.servos import LONGEST_MOVE_NS, MOST_MOVES, MOVE_NS
from failstop.policy.capsules import Model, would_hit
from failstop.policy.joints import Joint
from failstop.policy.settings import Settings
from failstop.procs.gate.arm import goals
from failstop.procs.gate.arm.goals import Goal, Trajectory

MOVES_APART_NS = MOST_MOVES * MOVE_NS
"""The shortest time between two frames of moves. The port owner would drop a frame that comes sooner, because a stop
might have to wait too long behind both."""


class Space:
    """Checks whether the arm would hit something if its joints moved to their next positions.

    The end of each move is checked before the move is sent, so a servo that gets no further move stops at a checked
    position. Parts of the arm that touch already, according to the model, may move apart.
    """

    def __init__(self, settings: Settings, joints: list[Joint]) -> None:
        self._joints = joints
        self._model = Model(settings) if settings.on("arm.collision") else None
        """The model of the arm, or None if collisions are not checked."""
        self._gap_m = inf

    def wanted(self, joints: list[Joint]) -> list[Joint]:
        """Return the joints whose positions must be known before `joints` move. With collision checks these are all
        joints, except silent ones that are not in `joints`. A silent joint counts as being at its last position."""
        return [joint for joint in self._joints if not joint.silent or joint in joints] if self._model else joints

    def begin(self) -> None:
        """Begin a movement from the joints' present positions. Parts of the arm that touch there may move apart, but
        not closer."""
        self._gap_m = self._nearest()[0]

    def hit(self) -> str:
        """Return a text about what the arm would hit at its joints' next positions, or an empty text. If it would hit
        nothing, the next positions become the present ones."""
        gap_m, name, other = self._nearest()
        if gap_m < min(0.0, self._gap_m):
            return would_hit(name, other)
        self._gap_m = gap_m
        return ""

    def _nearest(self) -> tuple[float, str, str]:
        if self._model is None:
            return inf, "", ""
        return self._model.nearest({joint.name: joint.rad(joint.position) for joint in self._joints})


class Stream:
    """Makes the moves of the joints that are moving, and plans when each joint gets its next move."""

    def __init__(self, settings: Settings, bus: ServoBus, space: Space) -> None:
        self._bus = bus
        self._period_ns = settings.ns("arm.period_s")
        self._move_ms = round(settings["arm.period_s"] * 1000)
        self._space = space
        self._schedule: list[tuple[int, list[Joint]]] = []
        """One entry per group of joints, as (the time when its next frame is due, its joints). The group that is due
        first comes first. Empty if no servo is moving."""
        self._apart_ns = 0
        """The time when the servos' bus is free again after the last move."""
        self._blocked: dict[Joint, str] = {}
        """For each group of joints: why the group can't move toward the goal, or an empty text if it can. The key is
        the group's first joint."""

    @property
    def on(self) -> bool:
        return bool(self._schedule)

    @property
    def joints(self) -> list[Joint]:
        return [joint for _, group in self._schedule for joint in group]

    @property
    def blocked(self) -> str:
        """The reason why a joint can't move toward the goal. Empty if all joints can."""
        return next(filter(None, self._blocked.values()), "")

    @property
    def due_ns(self) -> int:
        """The time when the next move is due, while joints are moving."""
        return max(self._schedule[0][0], self._apart_ns)

    def begin(self, joints: list[Joint], now_ns: int) -> None:
        """From now on, give each of these joints a move every period, starting at its present position."""
        self._space.begin()
        self._blocked.clear()
        groups = [joints[at : at + MOST_MOVES] for at in range(0, len(joints), MOST_MOVES)]
        step_ns = self._period_ns // len(groups)
        self._schedule = [(now_ns + index * step_ns, group) for index, group in enumerate(groups)]
        for joint in joints:
            joint.stepped_ns = 0

    def end(self) -> None:
        """Send no further moves. This forgets the joints' positions, so they are read again before the next move."""
        for joint in self.joints:
            joint.forget()
        self._schedule = []

    def move(self, followed: Goal | Trajectory, now_ns: int) -> tuple[bytes, str]:
        """Return (frame, hit) for the group of joints that is due. `frame` has their next moves toward the followed
        goal. If the arm would hit something, `hit` names it, and the moves keep the joints where they are. Otherwise
        `hit` is empty."""
        due_ns, group = self._schedule[0]
        self._apart_ns = now_ns + MOVES_APART_NS
        # Count from the time when the move was due. Then a late wake-up delays one frame, but not all later ones.
        again_ns = due_ns + self._period_ns
        self._schedule = [*self._schedule[1:], (again_ns if again_ns > now_ns else now_ns + self._period_ns, group)]
        before = [joint.position for joint in group]
        self._advance(group, followed, now_ns)
        if hit := self._space.hit():
            for joint, position in zip(group, before, strict=True):
                joint.position, joint.velocity = position, 0.0
        if isinstance(followed, Goal):
            self._blocked[group[0]] = hit
        moves = [(joint.servo, round(joint.position)) for joint in group]
        return self._bus.move(moves, self._move_ms), hit

    def _advance(self, group: list[Joint], followed: Goal | Trajectory, now_ns: int) -> None:
        """Calculate each joint's position at the end of its next move. A joint without a goal slows down until it
        rests."""
        targets = followed.targets(now_ns + self._period_ns)
        for joint in group:
            elapsed_ns = min(now_ns - joint.stepped_ns, LONGEST_MOVE_NS) if joint.stepped_ns else self._period_ns
            joint.stepped_ns = now_ns
            if followed.mode != goals.JOG and joint in targets:
                joint.step_towards(targets[joint], followed.share, elapsed_ns * 1e-9)
            else:
                joint.jog(targets.get(joint, 0.0), elapsed_ns * 1e-9)
