"""What a machine, or a root directory for one, has of failstop already."""

from __future__ import annotations

import glob
import os

from failstop import discovery
from failstop.fleet.settings import KEY_PLACE, PLACE
from failstop.install import machine, tree
from failstop.install.extras import EXTRAS
from failstop.install.layout import (
    COMMAND_LINK,
    MANIFEST,
    MANIFEST_NAME,
    PACKAGE_UNIT,
    PREFIX,
    STATE,
    UNITS,
    Manifest,
    configuration_of,
    parents,
    unit_of,
)
from failstop.install.parts import SLEEP, wanted_by
from failstop.install.plan import Found, Request, files_of

SETUPS = "/opt/ros/*/setup.sh"
UDEV_CONTROL = "/run/udev/control"


def look(request: Request, units: dict[str, str]) -> Found:
    """What is there of what an installation of these units would have. Raises InstallError when the list of what was
    installed is damaged."""

    def at(path: str) -> str:
        return os.path.join(request.root, path.lstrip("/"))

    targets = {target for unit in units.values() for target in wanted_by(unit)}
    wants = [f"{UNITS}/{target}.wants/{unit}" for target in targets for unit in (unit_of(request.name), SLEEP)]
    paths = [*files_of(), COMMAND_LINK, MANIFEST, *wants]
    for extra in EXTRAS:
        paths += [extra.place, *(f"{UNITS}/{target}.wants/{extra.unit}" for target in targets)]
    paths += [PLACE]
    paths += [configuration_of(request.name), "/etc/passwd", "/etc/group"]
    files, links = {}, {}
    for path in [*paths, PREFIX]:
        if os.path.islink(at(path)):
            links[path] = os.readlink(at(path))
        elif os.path.isfile(at(path)):
            with open(at(path), "rb") as file:
                files[path] = file.read()
    return Found(
        files,
        links,
        frozenset(part for path in [*paths, f"{STATE}/x"] for part in parents(path) if os.path.isdir(at(part))),
        _tree(at(PREFIX)),
        Manifest.load(files[MANIFEST]) if MANIFEST in files else None,
        machine.active_units() if request.live else (),
        request.live and os.path.exists(UDEV_CONTROL),
        os.path.exists(at(PACKAGE_UNIT)),
        board=request.live and discovery.board_there(),
        fleet_key=os.path.isfile(at(KEY_PLACE)),
        ros_setup=max((f"/{os.path.relpath(path, request.root)}" for path in glob.glob(at(SETUPS))), default=""),
    )


def _tree(path: str) -> str:
    """The digest of the environment; empty when there is none, nor anything else."""
    return tree.digest_of(path, MANIFEST_NAME) if os.path.isdir(path) and os.listdir(path) else ""


def configured_device(request: Request) -> str:
    """What the instance's configuration says of the board's port; empty when there is none. Raises SettingError when
    this version refuses it."""
    from failstop import config

    path = os.path.join(request.root, configuration_of(request.name).lstrip("/"))
    return str(config.load(path).flat()["device.path"]) if os.path.exists(path) else ""
