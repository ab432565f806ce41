"""A policy's program on LeRobot's side: `python bench/kiwi_policy.py SERVICE PART [SECONDS]` streams LeKiwi's nine
numbers, 30 times a second, as LeRobot's own loops do. It says `streams` with the first, and at the end, as JSON, when
each turn began, and how long it took to observe and to act, in ns.

PART: arm, whose joints go to and fro; wheels, with the joints as they are observed; both, where a board moves them at
once; or nothing, a loop alone.
"""

from __future__ import annotations

import json
import math
import sys
import time

from lerobot.robots import make_robot_from_config
from lerobot_robot_failstop import FailstopConfig
from lerobot_robot_failstop.config_failstop import JOINTS as KIWIS

from failstop import Robot

JOINTS = {"shoulder_pan": "base", "shoulder_lift": "shoulder", "elbow_flex": "elbow"}
JOINTS |= {"wrist_flex": "wrist", "wrist_roll": "roll", "gripper": "gripper"}
"""LeKiwi's joints by the names of the simulated robot's settings."""
PERIOD_NS = 1_000_000_000 // 30
STROKE_S = 4.0


def main(service: str, part: str, seconds: float = math.inf) -> None:
    """Stream for so long."""
    robot = None
    if part != "nothing":
        with Robot(service) as found:
            joints = JOINTS if "base" in found.arm.joints else dict(zip(KIWIS, KIWIS, strict=True))
        robot = make_robot_from_config(FailstopConfig(id="kiwi", service=service, joints=joints))
        robot.connect()
    begun_ns = time.monotonic_ns()
    turns: list[tuple[int, int, int]] = []
    while (now_ns := time.monotonic_ns()) - begun_ns < seconds * 1e9:
        action = robot.get_observation() if robot else {}
        seen_ns = time.monotonic_ns()
        if part in ("arm", "both"):
            t = (now_ns - begun_ns) / 1e9 % STROKE_S
            action |= {f"arm_{joint}.pos": 40 * min(t, STROKE_S - t) for joint in JOINTS}
            action |= dict.fromkeys(("x.vel", "y.vel", "theta.vel"), 0.0)
        if part in ("wheels", "both"):
            action["x.vel"] = 0.1
        if robot:
            robot.send_action(action)
        sent_ns = time.monotonic_ns()
        if now_ns - begun_ns < PERIOD_NS:
            print("streams", flush=True)
        if seconds < math.inf:
            turns.append((now_ns, seen_ns - now_ns, sent_ns - seen_ns))
        time.sleep(max(0, now_ns + PERIOD_NS - time.monotonic_ns()) / 1e9)
    if robot:
        robot.disconnect()
    print(json.dumps(turns), flush=True)


main(sys.argv[1], sys.argv[2], *map(float, sys.argv[3:]))
