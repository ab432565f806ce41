"""FailstopConfig: the options of `--robot.type=failstop`. LeRobot's parser reads their types from the annotations, so
this module does not postpone annotations."""

from dataclasses import dataclass, field

from lerobot.cameras import CameraConfig
from lerobot.robots import RobotConfig
from lerobot.robots.lekiwi import LeKiwiConfig

from lerobot_robot_failstop.keys import KEYS

DEFAULT_SERVICE = "failstop"
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
"""The names of LeKiwi's joints, in the order of their servos. LeRobot puts `arm_` in front of these names."""
WORDS = {"after_stop": ("raise", "wait"), "at_end": ("hold", "park", "release")}


@RobotConfig.register_subclass("failstop")
@dataclass(kw_only=True)
class FailstopConfig(RobotConfig):  # type: ignore[misc]
    """Options of the robot: which service drives it, and what happens at the beginning and the end of a run."""

    service: str = DEFAULT_SERVICE
    """The name of the failstop service on this computer."""
    joints: dict[str, str] = field(default_factory=lambda: {name: name for name in JOINTS})
    """For each of LeKiwi's joints, its name in failstop's settings ([joints.NAME]). Empty for a base without an arm."""
    source: str = "cmd_vel"
    """The source in failstop's settings under which the base is driven."""
    manual: bool = False
    """Set this if a person drives. The base then also drives without an obstacle sensor (failstop's setting
    scan.gate)."""
    enable: bool = False
    """Enable motion when connecting. Otherwise a person must do it, with `failstop enable`."""
    after_stop: str = "raise"
    """What happens after a latched stop. With `raise`, RobotStopped ends the run. With `wait`, actions have no effect
    until the stop is reset."""
    at_end: str = "hold"
    """What disconnect() does with the arm when the run ends normally: hold it; park it, which moves it to the tuck pose
    and then switches its torque off; or release it at once. After an exception the arm is held."""
    use_degrees: bool = LeKiwiConfig.use_degrees
    """Use degrees for the joints instead of -100 to 100. The gripper is always 0 to 100. The default is that of LeKiwi
    in the installed LeRobot (degrees since 0.6.0), because datasets and policies don't record their unit."""
    teleop_keys: dict[str, str] = field(default_factory=lambda: dict(KEYS))
    """The key for each of LeKiwi's driving actions."""
    cameras: dict[str, CameraConfig] = field(default_factory=dict)
    """LeRobot's cameras, by their names."""

    def __post_init__(self) -> None:
        """Raise ValueError for a value that is not allowed, for a joint that LeKiwi does not have, or for an unknown
        action in `teleop_keys`."""
        super().__post_init__()
        for key, words in WORDS.items():
            if (given := getattr(self, key)) not in words:
                raise ValueError(f"{key} is {given!r}: must be {' or '.join(words)}")
        if unknown := sorted(set(self.joints) - set(JOINTS)):
            raise ValueError(f"no joint {unknown[0]!r}: LeKiwi has {', '.join(JOINTS)}")
        if unknown := sorted(set(self.teleop_keys) - set(KEYS)):
            raise ValueError(f"no act {unknown[0]!r} for a key: there are {', '.join(KEYS)}")
