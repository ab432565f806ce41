"""The facts about VESCs that are needed before a Board is made."""

from __future__ import annotations

from failstop.board.facts import Facts

FACTS = Facts(
    speeds=2,
    imu=False,
    # SERVO_OUT_PULSE_MIN_US and SERVO_OUT_PULSE_MAX_US of conf_general.h; it has one servo.
    steers={"pwm": (1000, 2000, 1)},
    layouts={"ackermann": 1},
    # RoboRacer's car: the servo's gain -1.2135 and offset 0.5304 (f1tenth_system 03865a0, vesc.yaml) in us, and what
    # its servo_max of 0.85 leaves to the side where that is less. Sources differ on its wheelbase (0.25 there).
    steered_defaults={
        "wheels.id_1": 0,
        "wheels.diameter_m": 0.1,
        "wheels.wheelbase_m": 0.33,
        "steering.servo": 1,
        "steering.centre": 1530,
        "steering.per_rad": 1213.5,
        "steering.most_deg": 15.0,
    },
    can=True,
    motors={1: "motor 1 (the VESC at the port)", 2: "motor 2 (the VESC on its CAN)"},
)
