"""A joint of the arm swings to and fro at a steady rate, moved by a program of its own, as an arm's programs are."""

from __future__ import annotations

import dataclasses
import subprocess
from collections.abc import Sequence

from failstop import helpers
from failstop.api.arm import Arm
from failstop.api.errors import FailstopError
from failstop.policy.joints import Joint
from failstop.procs.gate.arm.reader import AGREE
from failstop.setup.ending import end_with_parent
from failstop_lab.prove.watch import Move, Reading

REACH_RAD = 0.5
LEAST_RAD = 0.3
STEADY = 1.01
"""Pulses by which a move may differ from the rate: both of its ends are rounded."""
PROGRAM = """
import sys, time
from failstop.api.robot import Robot
name, joint, (middle, reach, rate, *velocity) = sys.argv[1], sys.argv[2], map(float, sys.argv[3:])
with Robot(name, client="prove arm") as robot:
    begun = time.monotonic()
    while True:
        x = (time.monotonic() - begun) * rate / reach % 4.0
        robot.arm.follow({joint: middle + reach * (x if x < 1.0 else 2.0 - x if x < 3.0 else x - 4.0)})
        if any(velocity):
            robot.drive(*velocity, wait_s=0.0)
        time.sleep(0.02)
"""


@dataclasses.dataclass(frozen=True)
class Swing:
    """A joint, around where it swings, how far to each side: as fast as it may turn. With a slower goal it would turn
    at two rates, one of them to catch up after each end."""

    joint: Joint
    middle_rad: float
    reach_rad: float

    @property
    def rate_radps(self) -> float:
        """How fast."""
        return self.joint.speed_radps

    def begin(self, name: str, velocity: Sequence[float] = ()) -> subprocess.Popen[bytes]:
        """Have a program move it, and drive at a velocity, if any is given; the program ends with this one."""
        values = (self.middle_rad, self.reach_rad, self.rate_radps, *velocity)
        words = [name, self.joint.name, *(f"{value:.6f}" for value in values)]
        command = helpers.python("-c", PROGRAM, *words)
        return subprocess.Popen(command, stderr=subprocess.DEVNULL, preexec_fn=end_with_parent)

    def struck_now(self, moves: list[Move]) -> bool:
        """A good moment: at a steady rate, in the first half of a way with most of it ahead."""
        mine = [move for move in moves if move[1] == self.joint.servo][-3:]
        if len(mine) < 3:
            return False
        steps = [mine[2][2] - mine[1][2], mine[1][2] - mine[0][2]]
        step = self.joint.speed * (mine[2][0] - mine[0][0]) * 1e-9
        steady = abs(abs(sum(steps)) - step) <= STEADY and steps[0] * steps[1] > 0
        reach = abs(self.joint.pulses(self.reach_rad) - self.joint.zero)
        gone = (mine[2][2] - self.joint.pulses(self.middle_rad)) * (1 if steps[0] > 0 else -1) / reach
        return steady and -0.7 <= gone <= -0.3

    def at(self, moves: list[Move], t_ns: int) -> tuple[float, int]:
        """(where it was told to be at this time, which way it went, +1 or -1): on the way of the move in force."""
        mine = [move for move in moves if move[1] == self.joint.servo and move[0] <= t_ns]
        (_, _, begin, _), (made_ns, _, end, took_ns) = mine[-2:]
        share = min(1.0, (t_ns - made_ns) / took_ns)
        return begin + share * (end - begin), 1 if end >= begin else -1

    def read(self, readings: list[Reading], since_ns: int) -> float | None:
        """Where it is by the last two readings that agree; None: there are none since then."""
        mine = [position for t_ns, servo, position in readings if servo == self.joint.servo and t_ns >= since_ns]
        if len(mine) < 2 or abs(mine[-1] - mine[-2]) > AGREE:
            return None
        return (mine[-1] + mine[-2]) / 2


def choose(arm: Arm, base_servo: int) -> Swing:
    """The base joint, or the first where there is none, around where it is. Raises FailstopError, Refused."""
    found = [joint for joint in arm.joints.values() if joint.servo == base_servo]
    joint = found[0] if found else next(iter(arm.joints.values()))
    at_rad = arm.read()[joint.name]
    low, high = joint.range_rad()
    reach_rad = min(REACH_RAD, (high - low) / 2)
    if reach_rad < LEAST_RAD:
        raise FailstopError(
            f"joint {joint.name} may turn from {low:.2f} to {high:.2f} rad: too little to time a stop by"
        )
    return Swing(joint, max(low + reach_rad, min(high - reach_rad, at_rad)), reach_rad)
