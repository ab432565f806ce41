"""The operator's page as a service: its unit, and whether paired devices may do more than see and stop. Pure."""

from __future__ import annotations

from failstop.install import InstallError
from failstop.install.layout import UNITS
from failstop.install.parts import UNIT_COMMAND, wanted_by
from failstop.shm.instance import DEFAULT_NAME

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.install.parts import Parts
    from failstop.install.plan import Found, Request

UNIT = "failstop-web.service"
REMARK = "the address: failstop web pair"
PLACE = f"{UNITS}/{UNIT}"
VIEW = "view"
OPERATE = "operate"
GROUP = "SupplementaryGroups=failstop\n"
"""What lets its client drive, and with it enable."""
USER = "User=failstop-web\n"


def wanted(request: Request, found: Found) -> str:
    """VIEW or OPERATE: as asked for, or as it is installed; empty: there is to be none."""
    if request.web or not (found.manifest and PLACE in found.manifest.files):
        return request.web
    return OPERATE if GROUP in found.files.get(PLACE, b"").decode() else VIEW


def refuse(request: Request, found: Found) -> None:
    """Raise InstallError for a page that can't be put in place."""
    if request.web and request.name != DEFAULT_NAME:
        raise InstallError(f"--web: the page's unit is for the robot {DEFAULT_NAME!r} alone, not {request.name!r}")
    if request.web and PLACE in found.links:
        raise InstallError(f"{PLACE} is a link to {found.links[PLACE]}, and is not an installation's: remove it")


def files(parts: Parts, request: Request, found: Found) -> dict[str, tuple[bytes, str]]:
    """The unit, if there is to be one."""
    which = wanted(request, found)
    if not which:
        return {}
    text = parts.page.replace(UNIT_COMMAND, request.command)
    remark = "the operator's page: it sees and stops"
    if which == OPERATE:
        text = text.replace(USER, USER + GROUP)
        remark = "the operator's page; paired devices reset and enable (web.pairing)"
    return {PLACE: (text.encode(), remark)}


def links(parts: Parts, request: Request, found: Found) -> dict[str, str]:
    """What starts it at boot."""
    targets = wanted_by(parts.page) if wanted(request, found) else []
    return {f"{UNITS}/{target}.wants/{UNIT}": PLACE for target in targets}


def units(request: Request, found: Found) -> list[str]:
    """What is to run besides the service."""
    return [UNIT] if wanted(request, found) else []
