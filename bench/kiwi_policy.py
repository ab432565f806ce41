"""A policy's program on LeRobot's side: `python bench/kiwi_policy.py SERVICE PART [SECONDS]` streams LeKiwi's nine
numbers, 30 times a second, as LeRobot's own loops do. It says `streams` with the first, and at the end, as JSON, when
each turn began, and how long it took to observe and to act, in ns. Without SECONDS it streams through stops, and
connects again where the service was started again; SIGUSR1 has it pause, after which a stop's end lets it move the arm.

PART: arm, whose joints go to and fro; wheels, with the joints as they are observed; both, where a board moves them at
once; or nothing, a loop alone.
"""

from __future__ import annotations

import contextlib
import json
import math
import signal
import sys
import time
from typing import Any

from lerobot.robots import make_robot_from_config
from lerobot.utils.errors import DeviceNotConnectedError
from lerobot_robot_failstop import FailstopConfig
from lerobot_robot_failstop.config_failstop import JOINTS as KIWIS

from failstop import FailstopError, Robot

JOINTS = {"shoulder_pan": "base", "shoulder_lift": "shoulder", "elbow_flex": "elbow"}
JOINTS |= {"wrist_flex": "wrist", "wrist_roll": "roll", "gripper": "gripper"}
"""LeKiwi's joints by the names of the simulated robot's settings."""
PERIOD_NS = 1_000_000_000 // 30
STROKE_S = 4.0
PAUSE_S = 0.7
"""Longer than arm.goal_timeout_s."""
AGAIN_S = 0.1


class Policy:
    """The robot, and what it is told."""

    def __init__(self, service: str, part: str, *, again: bool) -> None:
        """`again`: go on after a stop, and with the next run of the service."""
        self._service, self._part, self._again = service, part, again
        self._robot: Any = None

    def __enter__(self) -> Policy:
        if self._part != "nothing":
            self._connect()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """One that is interrupted ends as it is."""
        if self._robot and kind is None:
            self._robot.disconnect()

    def _connect(self) -> None:
        with Robot(self._service) as found:
            joints = JOINTS if "base" in found.arm.joints else dict(zip(KIWIS, KIWIS, strict=True))
        after_stop = "wait" if self._again else "raise"
        config = FailstopConfig(id="kiwi", service=self._service, joints=joints, after_stop=after_stop)
        robot = make_robot_from_config(config)
        robot.connect()
        self._robot = robot

    def turn(self, t_s: float) -> int:
        """Observe and act; when it had observed."""
        try:
            return self._turn(t_s)
        except (DeviceNotConnectedError, FailstopError):
            if not self._again:
                raise
        with contextlib.suppress(DeviceNotConnectedError, FailstopError):
            if self._robot:
                self._robot.disconnect()
        self._robot = None
        with contextlib.suppress(DeviceNotConnectedError, FailstopError):
            self._connect()
        time.sleep(AGAIN_S)
        return time.monotonic_ns()

    def _turn(self, t_s: float) -> int:
        if self._robot is None and self._part != "nothing":
            raise DeviceNotConnectedError("not yet connected again")
        action = self._robot.get_observation() if self._robot else {}
        seen_ns = time.monotonic_ns()
        if self._part in ("arm", "both"):
            t = t_s % STROKE_S
            action |= {f"arm_{joint}.pos": 40 * min(t, STROKE_S - t) for joint in JOINTS}
            action |= dict.fromkeys(("x.vel", "y.vel", "theta.vel"), 0.0)
        if self._part in ("wheels", "both"):
            action["x.vel"] = 0.1
        if self._robot:
            self._robot.send_action(action)
        return seen_ns


def main(service: str, part: str, seconds: float = math.inf) -> None:
    """Stream for so long."""
    signal.signal(signal.SIGUSR1, lambda *_: time.sleep(PAUSE_S))
    turns: list[tuple[int, int, int]] = []
    with Policy(service, part, again=seconds == math.inf) as policy:
        begun_ns = time.monotonic_ns()
        while (now_ns := time.monotonic_ns()) - begun_ns < seconds * 1e9:
            seen_ns = policy.turn((now_ns - begun_ns) / 1e9)
            sent_ns = time.monotonic_ns()
            if now_ns - begun_ns < PERIOD_NS:
                print("streams", flush=True)
            if seconds < math.inf:
                turns.append((now_ns, seen_ns - now_ns, sent_ns - seen_ns))
            time.sleep(max(0, now_ns + PERIOD_NS - time.monotonic_ns()) / 1e9)
    print(json.dumps(turns), flush=True)


main(sys.argv[1], sys.argv[2], *map(float, sys.argv[3:]))
