"""Facts about VESCs. failstop needs them to read the settings, before it makes a Board."""

from __future__ import annotations

from failstop.board.facts import Facts

FACTS = Facts(
    speeds=2,
    imu=False,
    battery=True,
    # SERVO_OUT_PULSE_MIN_US and SERVO_OUT_PULSE_MAX_US of conf_general.h. A VESC has one servo.
    steers={"pwm": (1000, 2000, 1)},
    # APPCONF_SERVO_OUT_ENABLE of appconf_default.h, and app_set_configuration() of app.c. The servo reports nothing, so
    # failstop shows the commanded angle.
    no_steering="a VESC's servo output is off as delivered: in VESC Tool, switch Enable Servo Output on, and choose no "
    "app with PPM",
    layouts={"ackermann": 1},
    # RoboRacer's car. centre and per_rad are the servo's offset 0.5304 and gain -1.2135 (f1tenth_system 03865a0,
    # vesc.yaml) in us. most_deg is what its servo_max of 0.85 leaves on the side where less is left. Sources differ on
    # the wheelbase: that file has 0.25.
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
