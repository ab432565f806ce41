"""Robot, RobotConfig, and the factory that finds a robot by its configuration."""

from __future__ import annotations

import abc
import contextlib
import dataclasses
import importlib
import json
from pathlib import Path
from typing import Any

from lerobot.motors import MotorCalibration
from lerobot.utils.constants import HF_LEROBOT_CALIBRATION, ROBOTS


@dataclasses.dataclass(kw_only=True)
class RobotConfig:
    """Base of a robot's configuration."""

    id: str | None = None
    calibration_dir: Path | None = None

    def __post_init__(self) -> None:
        """Nothing to fill in."""

    _choices = {}  # noqa: RUF012 - no field

    @classmethod
    def register_subclass(cls, name: str) -> Any:
        def register(subclass: Any) -> Any:
            cls._choices[name] = subclass
            return subclass

        return register

    @property
    def type(self) -> str:
        return next(name for name, kind in self._choices.items() if kind is type(self))


class Robot(abc.ABC):
    """Base of a robot."""

    config_class: Any
    name: str

    def __init__(self, config: RobotConfig) -> None:
        self.robot_type = self.name
        self.id = config.id
        self.calibration_dir = config.calibration_dir or HF_LEROBOT_CALIBRATION / ROBOTS / self.name
        self.calibration_dir.mkdir(parents=True, exist_ok=True)
        self.calibration_fpath = self.calibration_dir / f"{self.id}.json"
        self.calibration: dict[str, MotorCalibration] = {}
        if self.calibration_fpath.is_file():
            rows = json.loads(self.calibration_fpath.read_text())
            self.calibration = {name: MotorCalibration(**row) for name, row in rows.items()}

    def __str__(self) -> str:
        return f"{self.id} {type(self).__name__}"

    def __enter__(self) -> Robot:
        self.connect()
        return self

    def __exit__(self, *_raised: object) -> None:
        self.disconnect()

    def __del__(self) -> None:
        with contextlib.suppress(Exception):
            if self.is_connected:
                self.disconnect()

    def _save_calibration(self) -> None:
        rows = {name: dataclasses.asdict(row) for name, row in self.calibration.items()}
        self.calibration_fpath.write_text(json.dumps(rows, indent=4))

    @property
    @abc.abstractmethod
    def observation_features(self) -> dict[str, Any]: ...

    @property
    @abc.abstractmethod
    def action_features(self) -> dict[str, Any]: ...

    @property
    @abc.abstractmethod
    def is_connected(self) -> bool: ...

    @abc.abstractmethod
    def connect(self, calibrate: bool = True) -> None: ...

    @property
    @abc.abstractmethod
    def is_calibrated(self) -> bool: ...

    @abc.abstractmethod
    def calibrate(self) -> None: ...

    @abc.abstractmethod
    def configure(self) -> None: ...

    @abc.abstractmethod
    def get_observation(self) -> dict[str, Any]: ...

    @abc.abstractmethod
    def send_action(self, action: dict[str, Any]) -> dict[str, Any]: ...

    @abc.abstractmethod
    def disconnect(self) -> None: ...


def make_robot_from_config(config: RobotConfig) -> Robot:
    """The robot whose class has the configuration's name without `Config`, in the package of its module."""
    kind = type(config)
    module = importlib.import_module(kind.__module__.rpartition(".")[0] or kind.__module__)
    made: Robot = getattr(module, kind.__name__.removesuffix("Config"))(config)
    return made
