"""LeKiwiConfig: the defaults of LeRobot's own LeKiwi."""

from __future__ import annotations

import dataclasses

import lerobot
from lerobot.robots import RobotConfig


@RobotConfig.register_subclass("lekiwi")
@dataclasses.dataclass(kw_only=True)
class LeKiwiConfig(RobotConfig):
    use_degrees: bool = lerobot.__version__ >= "0.6"
