"""Space: may the joints go on to where they are to be next, or would the arm hit something? Pure.

What is looked at is where each move ends, before it is sent: a servo that is sent no further move stands where the last
one ended, which was looked at before. A touch that is there already, by the model, may become less.
"""

from __future__ import annotations

from math import inf

from failstop.policy.capsules import Model, would_hit

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.policy.settings import Settings
    from failstop.procs.gate.arm.joints import Joint


class Space:
    """The arm's shape around its joints; without arm.collision nothing is looked at."""

    __slots__ = ("_gap_m", "_joints", "_model")

    def __init__(self, settings: Settings, joints: list[Joint]) -> None:
        self._joints = joints
        self._model = Model(settings) if settings.on("arm.collision") else None
        self._gap_m = inf

    def wanted(self, joints: list[Joint]) -> list[Joint]:
        """Whose place must be known before these move; silent ones count where they were last."""
        return [joint for joint in self._joints if not joint.silent or joint in joints] if self._model else joints

    def begin(self) -> None:
        """The joints are about to move from where they were read to be."""
        if self._model:
            self._gap_m = self._model.nearest(self._angles())[0]

    def hit(self) -> str:
        """What the arm would hit where its joints are to be now; empty: nothing. Then they go on from there."""
        if self._model is None:
            return ""
        gap_m, name, other = self._model.nearest(self._angles())
        if gap_m < min(0.0, self._gap_m):
            return would_hit(name, other)
        self._gap_m = gap_m
        return ""

    def _angles(self) -> dict[str, float]:
        return {joint.name: joint.rad(joint.position) for joint in self._joints}
