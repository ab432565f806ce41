"""An arm as a robot's settings have it: six joints, servos 1 to 5 and the gripper's 10."""

from __future__ import annotations

JOINTS = ("base", "shoulder", "elbow", "wrist", "roll", "gripper")
SERVOS = (1, 2, 3, 4, 5, 10)
TUCK = (500, 963, 46, 131, 498, 629)
DRIVE = (500, 793, 51, 160, 499, 499)
ARM: dict[str, object] = {
    f"joints.{name}.{key}": value
    for name, *values in zip(JOINTS, SERVOS, TUCK, DRIVE, strict=True)
    for key, value in zip(("servo", "tuck", "drive"), values, strict=True)
} | {"joints.gripper.judged": "off"}
