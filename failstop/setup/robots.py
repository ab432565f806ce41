"""The robots that setup knows. Each is a file, robots/NAME.toml; to add a robot, add a file.

Keys that begin with `about.` are for people (name, port, remark); all others are settings. For robots of the family of
`board.robot`, the file only names the robot, because the service has the figures. The file of a robot that people build
in different sizes has no sizes, but `about.measure`, which says what to measure.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

from failstop import config
from failstop.policy.setting import SettingError

FOLDER = Path(__file__).with_name("robots")
ABOUT = "about."
OTHER = "other"
"""The answer for a robot that no file describes."""


@dataclasses.dataclass(frozen=True)
class Known:
    """A robot that setup knows."""

    key: str
    """The name of its file, without .toml."""
    name: str
    port: str
    remark: str
    measure: str
    """What people must measure, because no two such robots have the same sizes; empty if the sizes are known."""
    settings: dict[str, object]
    """The values of its settings, by whole key."""

    @property
    def kind(self) -> str:
        """The kind of its board."""
        return str(self.settings["board.kind"])


def read(path: Path) -> Known:
    """Read the file of one robot. Raises SettingError, which names the file."""
    values = config.read(str(path))
    about = {key.removeprefix(ABOUT): str(values.pop(key)) for key in list(values) if key.startswith(ABOUT)}
    if not about.get("name") or "board.kind" not in values or "wheels.layout" not in values:
        raise SettingError(f"{path}: a robot needs about.name, board.kind and wheels.layout")
    config.checked(values, str(path))
    port, remark, measure = (about.get(key, "") for key in ("port", "remark", "measure"))
    return Known(path.stem, about["name"], port, remark, measure, values)


def of_kind(kind: str) -> dict[str, Known]:
    """The robots with this kind of board, by their keys. Raises SettingError."""
    found = [read(path) for path in sorted(FOLDER.glob("*.toml"))]
    return {robot.key: robot for robot in sorted(found, key=lambda robot: robot.name) if robot.kind == kind}
