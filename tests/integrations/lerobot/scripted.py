"""LeRobot's own scripts with a teleoperator that needs no hands: `python scripted.py SCRIPT OPTION...`, SCRIPT one of
teleoperate, record, replay; `python scripted.py both SERVICE NAME=JOINT...`: a leader arm and a keyboard at once, as
LeRobot's examples for LeKiwi have it; `python scripted.py client PORT PORT`: a laptop that drives LeKiwi's host ahead.
Never imported by a test; the real LeRobot alone has all of it."""

from __future__ import annotations

import importlib
import sys
import time
from dataclasses import dataclass
from typing import Any

from lerobot.robots import make_robot_from_config
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig
from lerobot_robot_failstop import FailstopConfig

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
TO = 20.0
"""The number to which every joint goes."""


@TeleoperatorConfig.register_subclass("scripted")
@dataclass(kw_only=True)
class ScriptedConfig(TeleoperatorConfig):  # type: ignore[misc]
    x: float = 0.0


class Scripted(Teleoperator):  # type: ignore[misc]
    """Every joint to one number, the base ahead."""

    config_class = ScriptedConfig
    name = "scripted"
    is_connected = is_calibrated = property(lambda self: True)
    action_features = property(lambda self: dict.fromkeys(self.get_action(), float))
    feedback_features = property(lambda self: {})
    calibrate = configure = disconnect = lambda self: None

    def __init__(self, config: ScriptedConfig) -> None:
        super().__init__(config)
        self.config = config

    def connect(self, calibrate: bool = True) -> None:
        pass

    def get_action(self) -> dict[str, float]:
        joints = {f"arm_{joint}.pos": TO for joint in JOINTS}
        return {**joints, "x.vel": self.config.x, "y.vel": 0.0, "theta.vel": 0.0}

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        pass


def both(service: str, joints: dict[str, str]) -> None:
    """A leader arm and a keyboard, through LeRobot's loop for two teleoperators."""
    from lerobot.processor import make_default_processors
    from lerobot.scripts.lerobot_record import record_loop
    from lerobot.teleoperators.keyboard import KeyboardTeleop, KeyboardTeleopConfig
    from lerobot.teleoperators.so_leader import SO100Leader, SO100LeaderConfig

    class Leader(SO100Leader):  # type: ignore[misc]
        def get_action(self) -> dict[str, float]:
            return {f"{joint}.pos": TO for joint in JOINTS}

    class Keyboard(KeyboardTeleop):  # type: ignore[misc]
        def get_action(self) -> dict[str, None]:
            return {"w": None}

    robot = make_robot_from_config(FailstopConfig(service=service, id="kiwi", joints=joints, enable=True))
    robot.connect()
    of_teleop, of_robot, of_observation = make_default_processors()
    record_loop(
        robot=robot,
        events={"exit_early": False},
        fps=30,
        teleop=[Leader(SO100LeaderConfig(port="", id="leader")), Keyboard(KeyboardTeleopConfig(id="keys"))],
        control_time_s=2,
        teleop_action_processor=of_teleop,
        robot_action_processor=of_robot,
        robot_observation_processor=of_observation,
    )
    robot.disconnect()


def client(commands: int, observations: int) -> None:
    """A laptop, without end."""
    from lerobot.robots.lekiwi import LeKiwiClient, LeKiwiClientConfig

    ports = {"port_zmq_cmd": commands, "port_zmq_observations": observations}
    robot = LeKiwiClient(LeKiwiClientConfig(remote_ip="127.0.0.1", cameras={}, connect_timeout_s=120, **ports))
    robot.connect()
    while True:
        seen = robot.get_observation()
        robot.send_action({name: float(seen[name]) for name in robot.action_features} | {"x.vel": 0.1})
        time.sleep(1 / 30)


if __name__ == "__main__":
    script, *words = sys.argv[1:]
    if script == "client":
        client(*map(int, words))
    elif script == "both":
        both(words[0], dict(word.split("=") for word in words[1:]))
    else:
        sys.argv[1:] = words
        importlib.import_module(f"lerobot.scripts.lerobot_{script}").main()
