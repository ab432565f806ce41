"""Facts about the RRC: it has four motors and an IMU, and its bus servos turn 240 degrees in 1000 pulses. failstop
needs these facts to read the settings, before it makes a Board."""

from __future__ import annotations

from failstop.board.facts import ArmFacts, Facts

FACTS = Facts(
    speeds=4,
    imu=True,
    battery=True,
    keys=True,
    arm=ArmFacts(highest=1000, turn=1500),
    steers={"pwm": (500, 2500, 4), "bus": (0, 1000, 253)},
)
