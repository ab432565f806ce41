"""LeRobot's robot of the type `failstop`: LeKiwi's names, driven through a failstop service on the same machine."""

from lerobot_robot_failstop.config_failstop import FailstopConfig
from lerobot_robot_failstop.robot import Failstop, RobotStopped

__all__ = ["Failstop", "FailstopConfig", "RobotStopped"]
