"""The robots that setup knows. Each has a file, robots/NAME.toml. To add a robot, add a file.

Keys that begin with `about.` are for people (name, port, remark), and all other keys are settings. A file with
`board.robot` has no sizes, because the service knows the sizes of that robot. If robots of one kind have different
sizes, their file has `about.measure` instead, a text that says what a person must measure.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

from failstop import config
from failstop.policy.setting import SettingError

FOLDER = Path(__file__).with_name("robots")
ABOUT = "about."
OTHER = "other"
"""The answer for a robot that has no file."""


@dataclasses.dataclass(frozen=True)
class Known:
    """A robot that setup knows, as its file describes it."""

    key: str
    """The name of the robot's file, without .toml."""
    name: str
    port: str
    remark: str
    measure: str
    """What a person must measure if robots of this kind are built in different sizes. Empty if the sizes are known."""
    settings: dict[str, object]
    """The robot's settings, each with its whole key, for example `wheels.layout`."""

    @property
    def kind(self) -> str:
        """The kind of the robot's board."""
        return str(self.settings["board.kind"])


def read(path: Path) -> Known:
    """Read a robot's file. Raises SettingError, which names the file."""
    values = config.read(str(path))
    about = {key.removeprefix(ABOUT): str(values.pop(key)) for key in list(values) if key.startswith(ABOUT)}
    if not about.get("name") or "board.kind" not in values or "wheels.layout" not in values:
        raise SettingError(f"{path}: a robot needs about.name, board.kind and wheels.layout")
    config.checked(values, str(path))
    port, remark, measure = (about.get(key, "") for key in ("port", "remark", "measure"))
    return Known(path.stem, about["name"], port, remark, measure, values)


def of_kind(kind: str) -> dict[str, Known]:
    """Return the robots that have this kind of board, each under its key, sorted by name. Raises SettingError."""
    found = [read(path) for path in sorted(FOLDER.glob("*.toml"))]
    return {robot.key: robot for robot in sorted(found, key=lambda robot: robot.name) if robot.kind == kind}
