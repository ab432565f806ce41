"""Robots that setup knows, each a file of data: robots/NAME.toml. A robot is added by a file.

What begins with `about.` is for people (name, port, remark); everything else are settings. Figures of the family of
`board.robot` stay where the service takes them from, and a file names that robot alone. A robot that people build in
different sizes has `about.measure`, which says what to measure, and no sizes.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

from failstop import config
from failstop.policy.setting import SettingError

FOLDER = Path(__file__).with_name("robots")
ABOUT = "about."
OTHER = "other"
"""The name of a robot that no file describes."""


@dataclasses.dataclass(frozen=True)
class Known:
    """A robot."""

    key: str
    """The file's name, without its end."""
    name: str
    port: str
    remark: str
    measure: str
    """What to measure, because no two such robots have the same sizes; empty: the sizes are known."""
    settings: dict[str, object]
    """Values by whole key, which Settings take."""

    @property
    def kind(self) -> str:
        """The board's kind."""
        return str(self.settings["board.kind"])


def read(path: Path) -> Known:
    """One robot. Raises SettingError, which names the file."""
    values = config.read(str(path))
    about = {key.removeprefix(ABOUT): str(values.pop(key)) for key in list(values) if key.startswith(ABOUT)}
    if not about.get("name") or "board.kind" not in values or "wheels.layout" not in values:
        raise SettingError(f"{path}: a robot needs about.name, board.kind and wheels.layout")
    config.checked(values, str(path))
    port, remark, measure = (about.get(key, "") for key in ("port", "remark", "measure"))
    return Known(path.stem, about["name"], port, remark, measure, values)


def of_kind(kind: str) -> dict[str, Known]:
    """The robots with this board, by their keys. Raises SettingError."""
    found = [read(path) for path in sorted(FOLDER.glob("*.toml"))]
    return {robot.key: robot for robot in sorted(found, key=lambda robot: robot.name) if robot.kind == kind}
