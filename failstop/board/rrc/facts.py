"""The facts about the RRC that are needed before a Board is made: four motors, an IMU, bus servos with 240 degrees in
1000 pulses."""

from __future__ import annotations

from failstop.board.facts import ArmFacts, Facts

FACTS = Facts(
    speeds=4,
    imu=True,
    arm=ArmFacts(highest=1000, turn=1500),
    steers={"pwm": (500, 2500, 4), "bus": (0, 1000, 253)},
)
