"""Goals: what clients want the arm to do. Pure.

A trajectory has an end. When it is over, the joints' positions are read, to check that the arm has arrived. In the
modes follow and jog, a client sends a stream of goals. The newest goal counts until it is older than
arm.goal_timeout_s. While there is a trajectory, goals of a stream don't count.
"""

from __future__ import annotations

from bisect import bisect_right
from itertools import pairwise
from math import isfinite
from operator import itemgetter

from failstop.data import Data
from failstop.policy.causes import Cause
from failstop.policy.joints import Joint

FOLLOW = "follow"
JOG = "jog"
TRAJECTORY = "trajectory"
MOVE = "move"
DRIVE = "drive"
TUCK = "tuck"

FINDING = "finding out where it is"
LOADING = "switching its torque on"
ON_ITS_WAY = "on its way"
SETTLING = "settling"
CHECKING = "reading back where it is"

Waypoint = tuple[float, dict[Joint, float]]
"""A time (s from the start), and the position of each joint at that time, in pulses."""


class Goal(Data):
    """A goal of a stream. `ends`: for each joint, a position in pulses (mode follow) or a rate in pulses/s (mode jog).
    Until ArmCore.accept() has accepted the goal, the unit is rad instead of pulses."""

    mode: str
    session: int
    who: str
    t_ns: int
    ends: dict[Joint, float]
    share: float = 1.0

    def targets(self, _then_ns: int) -> dict[Joint, float]:
        """Return `ends`, which do not depend on the time."""
        return self.ends


class Trajectory:
    """A movement to a pose or along a client's path. At the end, the joints' positions are read, to check that the arm
    has arrived."""

    mode = TRAJECTORY

    def __init__(
        self, purpose: str, session: int, who: str, joints: list[Joint], rows: list[Waypoint], share: float = 1.0
    ) -> None:
        """`rows`: the positions of the joints, each with its time. Leave out the start, because it is read from the
        servos. If the first row has the time 0, the joints go there as fast as `share` allows. `share`: how much of its
        top speed each joint may use, from 0 to 1."""
        self.purpose = purpose
        self.session = session
        self.who = who
        self.joints = joints
        self.share = share
        self._rows = rows
        self.phase = FINDING
        self.since_ns = 0
        self.begun_ns = 0
        self.done = self.dropped = False
        """`done`: True if the trajectory is over. `dropped`: True if it is over because the arm was taken from its
        client."""
        self.outcome = ""
        self.stopped_for: Cause | None = None
        """The cause of the latched stop that has ended the trajectory, or None if it ended otherwise."""

    @property
    def ends(self) -> dict[Joint, float]:
        """The position of each joint at the end. Empty if the trajectory only reads where the joints are."""
        return self._rows[-1][1] if self._rows else {}

    @property
    def length_s(self) -> float:
        """How long the trajectory takes after it has begun, s."""
        return self._rows[-1][0]

    def begin(self, now_ns: int) -> str:
        """Begin at the joints' present positions, which must be known. Returns why the trajectory can't begin, or an
        empty text."""
        start = {joint: joint.position for joint in self.joints}
        t_s, first = self._rows[0]
        if not t_s:
            # The time that the slowest joint needs at full speed. The joints' ramps make the movement a little longer.
            t_s = max(0.1, *(abs(end - start[joint]) / (joint.speed * self.share) for joint, end in first.items()))
        self._rows = [(0.0, start), (t_s, first), *self._rows[1:]]
        self.begun_ns = now_ns
        return too_fast_between(self._rows)

    def targets(self, then_ns: int) -> dict[Joint, float]:
        t_s = (then_ns - self.begun_ns) * 1e-9
        after = bisect_right(self._rows, t_s, key=itemgetter(0))
        if after == len(self._rows):
            return self.ends
        (t0, begin), (t1, end) = self._rows[after - 1], self._rows[after]
        share = (t_s - t0) / (t1 - t0)
        return {joint: a + share * (end[joint] - a) for joint, a in begin.items()}

    def left_s(self, now_ns: int) -> float:
        return max(0.0, self.length_s - (now_ns - self.begun_ns) * 1e-9) if self.begun_ns else 0.0

    def finish(self, outcome: str = "", *, dropped: bool = False) -> None:
        """End the trajectory. `outcome`: why it has failed; empty if it has succeeded. `dropped`: True if the arm was
        taken from its client."""
        self.done, self.outcome, self.dropped = True, outcome, dropped

    def progress(self, now_ns: int) -> str:
        left_s = self.left_s(now_ns)
        return f"arm, {self.purpose}: {self.phase}" + (f", {left_s:.1f} s left" if left_s > 0.0 else "")


def too_fast(rates: dict[Joint, float]) -> str:
    """Return a text about the first joint whose rate (rad/s) is too high, or an empty text if all rates are allowed."""
    for joint, rate in rates.items():
        most = joint.speed_radps
        if not isfinite(rate) or abs(rate) > most * 1.000001:
            return f"joint {joint.name} at {rate:g} rad/s: allowed is up to {most:g}"
    return ""


def too_fast_between(rows: list[Waypoint]) -> str:
    """Return a text if a joint would have to turn too fast between two rows, or if the times don't increase. Otherwise
    return an empty text."""
    for (t0, begin), (t1, end) in pairwise(rows):
        if t1 <= t0:
            return f"the times do not go up: {t0:g} s, then {t1:g} s"
        for joint, a in begin.items():
            rate = abs(end[joint] - a) / (t1 - t0)
            if rate > joint.speed * 1.000001:
                most, asked = joint.speed_radps, rate / joint.per_rad
                return f"joint {joint.name} at {asked:.3f} rad/s between {t0:g} and {t1:g} s: allowed is up to {most:g}"
    return ""
