"""Looking: what a machine, or a root directory for one, has of failstop already."""

from __future__ import annotations

import glob
import os

from failstop import config, discovery
from failstop.fleet.settings import KEY_PLACE
from failstop.install import layout, machine, tree
from failstop.install.found import Found, Request
from failstop.install.rows import FLEET, ROWS

ROS_SETUPS = "/opt/ros/*/setup.sh"
UDEV_CONTROL = "/run/udev/control"


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
