"""Facts of a LeRobot, as JSON: a fact's name says what it is. Never imported by a test. With a real one, in this
folder: `HF_LEROBOT_HOME=/tmp/home python facts_seen.py`. facts.json has the facts of the oldest version, and what
differs in newer ones."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import sys
import tempfile
from operator import methodcaller
from pathlib import Path
from typing import Any

from lerobot.motors import MotorCalibration
from lerobot.robots import Robot, RobotConfig, make_robot_from_config
from lerobot.utils import constants, errors
from lerobot.utils.import_utils import register_third_party_plugins

PLUGIN = """
import dataclasses
from typing import Any
from lerobot.robots import Robot, RobotConfig

@RobotConfig.register_subclass("{name}")
@dataclasses.dataclass(kw_only=True)
class {kind}Config(RobotConfig):
    pass

class {kind}(Robot):
    config_class = {kind}Config
    name = "{name}_device"
    observation_features = action_features = property(lambda self: {{}})
    is_connected = is_calibrated = property(lambda self: False)
    calibrate = configure = get_observation = disconnect = connect = send_action = lambda self, *given: None
"""
ROWS = [
    MotorCalibration(id=1, drive_mode=0, homing_offset=0, range_min=700, range_max=3400),
    MotorCalibration(id=2, drive_mode=1, homing_offset=-20, range_min=0, range_max=4095),
]
POSITIONS = (0, 700, 1234, 2048, 3400, 4095)
VALUES = (-150.0, -100.0, -33.3, 0.0, 45.0, 100.0, 150.0)
PRESSED = ("", "w", "s", "wa", "wsd", "z", "x", "r", "rwz", "rw", "fdx", "f", "fw", "q")
"""Keys that are down at one look after another."""


def plugin(folder: Path, distribution: str, module: str) -> type[Robot] | None:
    """The robot that is made of a plugin of these names; None: LeRobot does not find it."""
    kind = module.rpartition("_")[2].title()
    (folder / f"{module}.py").write_text(PLUGIN.format(name=module, kind=kind))
    info = folder / f"{module}-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1\n")
    register_third_party_plugins()
    if module not in sys.modules:
        return None
    made: type[Robot] = getattr(sys.modules[module], kind)
    return made


def robots(folder: Path) -> dict[str, Any]:
    sys.path.insert(0, str(folder))
    found = plugin(folder, "lerobot_robot_one", "lerobot_robot_one")
    assert found
    config = found.config_class(id="kiwi")
    robot = make_robot_from_config(config)
    robot.calibration = {f"arm_{row.id}": row for row in ROWS}
    methodcaller("_save_calibration")(robot)
    other = found(found.config_class(id="kiwi"))
    return {
        "abstract": sorted(Robot.__abstractmethods__),
        "config": {field.name: field.default for field in dataclasses.fields(RobotConfig)},
        "found with hyphens in its name": plugin(folder, "lerobot-robot-two", "lerobot_robot_two") is not None,
        "made by its config's name": type(robot).__name__,
        "type of the config": config.type,
        "type of the robot": robot.robot_type,
        "as text": str(robot),
        "calibration file": str(robot.calibration_fpath.relative_to(constants.HF_LEROBOT_HOME)),
        "what it holds": json.loads(robot.calibration_fpath.read_text()),
        "read again": {name: dataclasses.asdict(row) for name, row in other.calibration.items()},
    }


def devices() -> dict[str, Any]:
    kinds = (errors.DeviceNotConnectedError, errors.DeviceAlreadyConnectedError)
    return {kind.__name__: [str(kind("said")), kind.__base__.__name__] for kind in kinds}


def kiwi() -> dict[str, Any]:
    """LeKiwi's names, its numbers and its keys; only the real one has it."""
    from lerobot.motors import Motor, MotorNormMode
    from lerobot.motors.feetech import FeetechMotorsBus
    from lerobot.robots.lekiwi import LeKiwi, LeKiwiClient, LeKiwiClientConfig, LeKiwiConfig

    client = LeKiwiClient(LeKiwiClientConfig(remote_ip="127.0.0.1", cameras={}))
    host = LeKiwi(LeKiwiConfig(cameras={}))
    assert list(client.observation_features) == list(host.observation_features)
    numbers = []
    for row in ROWS:
        for mode in MotorNormMode:
            bus = FeetechMotorsBus("", {"one": Motor(row.id, "sts3215", mode)}, {"one": row})
            shown = [methodcaller("_normalize", {row.id: at})(bus)[row.id] for at in POSITIONS]
            sent = [methodcaller("_unnormalize", {row.id: value})(bus)[row.id] for value in VALUES]
            numbers.append([row.range_min, row.range_max, row.drive_mode, mode.value, shown, sent])
    return {
        "observations": {name: kind.__name__ for name, kind in client.observation_features.items()},
        "actions": {name: kind.__name__ for name, kind in client.action_features.items()},
        "name": client.name,
        "calibration folder": str(host.calibration_fpath.parent.relative_to(constants.HF_LEROBOT_HOME)),
        "servos": {name: motor.id for name, motor in host.bus.motors.items()},
        "norm modes": {name: motor.norm_mode.value for name, motor in host.bus.motors.items()},
        "keys": client.config.teleop_keys,
        "keyboard": [[keys, methodcaller("_from_keyboard_to_base_action", list(keys))(client)] for keys in PRESSED],
        "positions": POSITIONS,
        "values": VALUES,
        "numbers": numbers,
    }


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        found = {"robots": robots(Path(folder)), "devices": devices()}
    if importlib.util.find_spec("lerobot.motors.feetech"):
        found["kiwi"] = kiwi()
    sys.stdout.write(json.dumps(found, indent=1) + "\n")


main()
