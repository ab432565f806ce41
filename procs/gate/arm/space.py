"""Space: would the arm hit something where it is to be next? Pure."""

from __future__ import annotations

from math import inf

from failstop.policy.capsules import Model, would_hit
from failstop.policy.joints import Joint
from failstop.policy.settings import Settings


class Space:
    """May the joints go on to where they are to be next, or would the arm hit something? What is looked at is where
    each move ends, before it is sent: a servo that is sent no further move stands where the last one ended, which was
    looked at before. A touch that is there already, by the model, may become less."""

    def __init__(self, settings: Settings, joints: list[Joint]) -> None:
        self._joints = joints
        self._model = Model(settings) if settings.on("arm.collision") else None
        """None: nothing is looked at."""
        self._gap_m = inf

    def wanted(self, joints: list[Joint]) -> list[Joint]:
        """Joints whose place must be known before these move; silent ones count where they were last."""
        return [joint for joint in self._joints if not joint.silent or joint in joints] if self._model else joints

    def begin(self) -> None:
        """The joints stand where they are, whatever they touch."""
        self._gap_m = self._nearest()[0]

    def hit(self) -> str:
        """The thing that the arm would hit where its joints are to be; empty: nothing. Then they go on from there."""
        gap_m, name, other = self._nearest()
        if gap_m < min(0.0, self._gap_m):
            return would_hit(name, other)
        self._gap_m = gap_m
        return ""

    def _nearest(self) -> tuple[float, str, str]:
        if self._model is None:
            return inf, "", ""
        return self._model.nearest({joint.name: joint.rad(joint.position) for joint in self._joints})
