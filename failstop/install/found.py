"""What is asked for, and what a machine, or a root directory for one, has of failstop already."""

from __future__ import annotations

import dataclasses
import glob
import os

from failstop import config, discovery
from failstop.fleet.settings import KEY_PLACE
from failstop.install import layout, machine, tree
from failstop.install.rows import FLEET, ROWS, UNIT_COMMAND
from failstop.shm.instance import DEFAULT_NAME

ROS_SETUPS = "/opt/ros/*/setup.sh"
UDEV_CONTROL = "/run/udev/control"


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


def look(request: Request) -> Found:
    """What is there of what an installation would have. Raises InstallError when the list of what was installed is
    damaged."""
    at = request.at
    boot = [layout.unit_of(request.name), *(row.source for row in ROWS if row.boot)]
    wants = [_inside(path, request) for path in glob.glob(at(f"{layout.UNITS}/*.wants"))]
    paths = [*(row.place for row in ROWS), *(f"{folder}/{unit}" for folder in wants for unit in boot), FLEET.settings]
    paths += [
        layout.COMMAND_LINK,
        layout.MANIFEST,
        layout.PREFIX,
        layout.configuration_of(request.name),
        "/etc/passwd",
        "/etc/group",
    ]
    files, links = {}, {}
    for path in paths:
        if os.path.islink(at(path)):
            links[path] = os.readlink(at(path))
        elif os.path.isfile(at(path)):
            with open(at(path), "rb") as file:
                files[path] = file.read()
    return Found(
        files,
        links,
        frozenset(
            part for path in [*paths, f"{layout.STATE}/x"] for part in layout.parents(path) if os.path.isdir(at(part))
        ),
        _tree(at(layout.PREFIX)),
        layout.Manifest.load(files[layout.MANIFEST]) if layout.MANIFEST in files else None,
        machine.active_units() if request.live else (),
        request.live and os.path.exists(UDEV_CONTROL),
        os.path.exists(at(layout.PACKAGE_UNIT)),
        board=request.live and discovery.board_there(),
        fleet_key=os.path.isfile(at(KEY_PLACE)),
        ros_setup=max((_inside(path, request) for path in glob.glob(at(ROS_SETUPS))), default=""),
    )


def _inside(path: str, request: Request) -> str:
    return f"/{os.path.relpath(path, request.root)}"


def _tree(path: str) -> str:
    """The digest of the environment; empty when there is none, nor anything else."""
    return tree.digest_of(path, layout.MANIFEST_NAME) if os.path.isdir(path) and os.listdir(path) else ""


def configured_device(request: Request) -> str:
    """What the instance's configuration says of the board's port; empty when there is none. Raises SettingError when
    this version refuses it."""
    path = request.at(layout.configuration_of(request.name))
    return str(config.load(path).flat()["device.path"]) if os.path.exists(path) else ""
