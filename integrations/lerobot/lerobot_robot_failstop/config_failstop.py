"""FailstopConfig: what `--robot.type=failstop` can be told. LeRobot's parser reads the types from the annotations, so
they are not postponed here."""

from dataclasses import dataclass, field

from lerobot.cameras import CameraConfig
from lerobot.robots import RobotConfig
from lerobot.robots.lekiwi import LeKiwiConfig

from lerobot_robot_failstop.keys import KEYS

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
"""LeKiwi's joints, in the order of its servos, without the `arm_` that LeRobot puts in front."""
WORDS = {"after_stop": ("raise", "wait"), "at_end": ("hold", "park", "release")}


@RobotConfig.register_subclass("failstop")
@dataclass(kw_only=True)
class FailstopConfig(RobotConfig):  # type: ignore[misc]
    """Where the robot is, and how it behaves at the edges of a run."""

    service: str = "failstop"
    """Name of the failstop service on this machine."""
    joints: dict[str, str] = field(default_factory=lambda: {name: name for name in JOINTS})
    """Name in failstop's settings ([joints.NAME]) of each of LeKiwi's joints; empty: a base without an arm."""
    source: str = "cmd_vel"
    """The source of the settings as which the base is driven."""
    manual: bool = False
    """A person drives: exempt from the interlock of the obstacle sensor (failstop's setting scan.gate)."""
    enable: bool = False
    """Enable motion when connecting. Otherwise a person does: `failstop enable`."""
    after_stop: str = "raise"
    """A latched stop ends the run (raise: RobotStopped), or the actions go on without effect until the reset (wait)."""
    at_end: str = "hold"
    """End of the arm by disconnect(): hold it, park it (tuck pose, then torque off), or release it at once."""
    use_degrees: bool = LeKiwiConfig.use_degrees
    """Joints in degrees instead of -100 to 100; the gripper is 0 to 100 always. The default is that of LeKiwi in the
    LeRobot that is installed (degrees since 0.6.0), because datasets and policies do not say which unit they have."""
    teleop_keys: dict[str, str] = field(default_factory=lambda: dict(KEYS))
    """The key of each of LeKiwi's acts of driving."""
    cameras: dict[str, CameraConfig] = field(default_factory=dict)
    """LeRobot's own cameras, by name."""

    def __post_init__(self) -> None:
        """Raises ValueError for a word that there is not, and for a joint that LeKiwi does not have."""
        super().__post_init__()
        for key, words in WORDS.items():
            if (given := getattr(self, key)) not in words:
                raise ValueError(f"{key} is {given!r}: must be {' or '.join(words)}")
        if unknown := sorted(set(self.joints) - set(JOINTS)):
            raise ValueError(f"no joint {unknown[0]!r}: LeKiwi has {', '.join(JOINTS)}")
        if unknown := sorted(set(self.teleop_keys) - set(KEYS)):
            raise ValueError(f"no act {unknown[0]!r} for a key: there are {', '.join(KEYS)}")
