"""The robot in its fleet as a service: its unit, and an example of its settings. Pure."""

from __future__ import annotations

from failstop.fleet.settings import KEY_PLACE
from failstop.fleet.settings import PLACE as SETTINGS
from failstop.install import InstallError
from failstop.install.layout import UNITS
from failstop.install.parts import UNIT_COMMAND, wanted_by
from failstop.install.steps import File
from failstop.shm.instance import DEFAULT_NAME

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.install.parts import Parts
    from failstop.install.plan import Found, Request

UNIT = "failstop-fleet.service"
PLACE = f"{UNITS}/{UNIT}"
REMARK = "the robot is seen on its broker, and obeys a stop of its fleet"


def wanted(request: Request, found: Found) -> bool:
    """It was asked for, or is installed."""
    return request.fleet or (found.manifest is not None and PLACE in found.manifest.files)


def refuse(request: Request, found: Found) -> None:
    """Raise InstallError where it could not work."""
    if not request.fleet:
        return
    if request.name != DEFAULT_NAME:
        raise InstallError(f"--fleet: its unit is for the robot {DEFAULT_NAME!r} alone, not {request.name!r}")
    if PLACE in found.links:
        raise InstallError(f"{PLACE} is a link to {found.links[PLACE]}, and is not an installation's: remove it")
    if not found.fleet_key:
        raise InstallError(
            f"--fleet: there is no {KEY_PLACE}: copy the fleet's key there (chmod 600), or make it, once for the whole "
            "fleet, with `failstop fleet key`"
        )


def files(parts: Parts, request: Request, found: Found) -> dict[str, tuple[bytes, str]]:
    """The unit, if there is to be one."""
    if not wanted(request, found):
        return {}
    return {PLACE: (parts.fleet.replace(UNIT_COMMAND, request.command).encode(), REMARK)}


def links(parts: Parts, request: Request, found: Found) -> dict[str, str]:
    """What starts it at boot."""
    targets = wanted_by(parts.fleet) if wanted(request, found) else []
    return {f"{UNITS}/{target}.wants/{UNIT}": PLACE for target in targets}


def configuration(parts: Parts, request: Request, found: Found) -> list[File]:
    """The example, unless there are settings: those are the user's, and stay as they are."""
    if not wanted(request, found) or SETTINGS in found.files:
        return []
    return [File("create", SETTINGS, "where its broker is: look at it", SETTINGS, parts.fleet_example.encode())]


def units(request: Request, found: Found) -> list[str]:
    """What is to run besides the service."""
    return [UNIT] if wanted(request, found) else []
