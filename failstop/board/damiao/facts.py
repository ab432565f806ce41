"""Facts about Damiao's motors. failstop needs them to read the settings, before it makes a Board."""

from __future__ import annotations

from failstop.board.facts import Facts

FACTS = Facts(
    speeds=2,
    layouts={"omni3": 3, "mecanum": 4},
    most=4,
    imu=False,
    motors={motor: f"motor {motor} (CAN id {motor})" for motor in range(1, 5)},
)
