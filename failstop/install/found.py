"""What is asked for, and what a machine has of failstop already: as values. Pure."""

from __future__ import annotations

import dataclasses
import os

from failstop.install import layout
from failstop.install.layout import UNIT_COMMAND
from failstop.shm.instance import DEFAULT_NAME


@dataclasses.dataclass(frozen=True)
class Request:
    """What the user asked for."""

    name: str = DEFAULT_NAME
    device: str = ""
    """The board's port; empty: the setting's default."""
    root: str = "/"
    live: bool = True
    """False: files only, the system whose root this is does not run."""
    start: bool = True
    command: str = UNIT_COMMAND
    """What the units call; another than the default: no environment is made."""
    ros2_user: str = ""
    """The user of the robot's ROS nodes, whose the bridge is to be; empty: no bridge, or the one that is there."""
    fleet: bool = False
    """The robot is to be published to its fleet's broker; False: it is not, or goes on to be."""
    web: str = ""
    """The operator's page: rows.VIEW or rows.OPERATE; empty: none, or the one that is there."""

    def at(self, path: str) -> str:
        """Where a path of the installed system is now."""
        return os.path.join(self.root, path.lstrip("/"))


@dataclasses.dataclass(frozen=True)
class Found:
    """What is there already. Paths are those of the installed system."""

    files: dict[str, bytes] = dataclasses.field(default_factory=dict)
    links: dict[str, str] = dataclasses.field(default_factory=dict)
    directories: frozenset[str] = frozenset()
    tree: str = ""
    """The digest of the environment."""
    manifest: layout.Manifest | None = None
    active: tuple[str, ...] = ()
    """Units of failstop that run."""
    udev: bool = False
    """udev runs, or could be told to read its rules again."""
    package: bool = False
    """The Debian package is installed."""
    configured_device: str = ""
    """What the instance's configuration, if there is one, says of the board's port."""
    device_there: bool = True
    """The board is plugged in; true if it would be looked for under a name that only the installation's rule makes."""
    board: bool = False
    """A board is plugged in that the rule gives a name."""
    fleet_key: bool = False
    """The fleet's key is where its unit wants it."""
    ros_setup: str = ""
    """What makes the environment of the ROS 2 that is there."""

    def rows(self, path: str) -> list[list[str]]:
        """The fields of a file of accounts, such as /etc/passwd, line by line."""
        lines = self.files.get(path, b"").decode().splitlines()
        return [line.split(":") for line in lines if line.count(":") >= 3]
