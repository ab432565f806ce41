"""The robot type `failstop` for LeRobot. It has LeKiwi's names for observations and actions, and drives through a
failstop service on the same computer."""

from lerobot_robot_failstop.config_failstop import FailstopConfig
from lerobot_robot_failstop.robot import Failstop, RobotStopped

__all__ = ["Failstop", "FailstopConfig", "RobotStopped"]
