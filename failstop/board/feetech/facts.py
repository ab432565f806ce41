"""Facts about Feetech's servos: LeKiwi's three wheels, and its arm on the same bus. failstop needs them to read the
settings, before it makes a Board."""

from __future__ import annotations

from failstop.board.facts import ArmFacts, Facts

FACTS = Facts(
    speeds=3,
    imu=False,
    battery=True,
    arm=ArmFacts(highest=4095, turn=4096, wheels=(7, 8, 9), joint={"zero": 2048, "high": 4095}),
    # What LeKiwi's servos can turn in every direction at once.
    defaults={"limits.vx_mps": 0.1, "limits.vy_mps": 0.1, "limits.wz_radps": 0.5},
)
