"""The ROS 2 bridge as a service: its unit for the user of the robot's other nodes, and that user's membership. Pure."""

from __future__ import annotations

from failstop.install import InstallError
from failstop.install.layout import ACCOUNT_FILES, UNITS
from failstop.install.parts import UNIT_COMMAND, wanted_by
from failstop.install.steps import Command
from failstop.shm.instance import DEFAULT_NAME

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.install.parts import Parts
    from failstop.install.plan import Found, Request

UNIT = "failstop-ros2.service"
PLACE = f"{UNITS}/{UNIT}"
SETUP = "/opt/ros/humble/setup.sh"
"""What the unit sources as it is shipped."""
SHIPPED_USER = "robot"
GROUP = "failstop"


def user(request: Request, found: Found) -> str:
    """Whose the bridge is: as asked for, or as it is installed; empty: there is to be none."""
    if request.ros2_user or not (found.manifest and PLACE in found.manifest.files):
        return request.ros2_user
    lines = found.files.get(PLACE, b"").decode().splitlines()
    return next((line.partition("=")[2] for line in lines if line.startswith("User=")), "")


def refuse(request: Request, found: Found) -> None:
    """Raise InstallError for a user that can't be the bridge's."""
    name = request.ros2_user
    if not name:
        return
    if request.name != DEFAULT_NAME:
        raise InstallError(
            f"--ros2-user: the bridge's unit is for the robot {DEFAULT_NAME!r} alone, not {request.name!r}"
        )
    if name == GROUP:
        raise InstallError(f"--ros2-user {name}: that is the service's own user; name the user of your ROS nodes")
    passwd = {line.split(":")[0] for line in found.files.get("/etc/passwd", b"").decode().splitlines()}
    if name not in passwd:
        raise InstallError(f"--ros2-user {name}: no such user; name the one that runs the robot's other nodes")
    if PLACE in found.links:
        raise InstallError(f"{PLACE} is a link to {found.links[PLACE]}, and is not an installation's: remove it")


def files(parts: Parts, request: Request, found: Found) -> dict[str, tuple[bytes, str]]:
    """The unit, if there is to be one."""
    name = user(request, found)
    if not name:
        return {}
    text = parts.bridge.replace(UNIT_COMMAND, request.command).replace(f"User={SHIPPED_USER}\n", f"User={name}\n")
    text = text.replace(SETUP, found.ros_setup or SETUP)
    return {PLACE: (text.encode(), f"the bridge to ROS 2, as the user {name}")}


def links(parts: Parts, request: Request, found: Found) -> dict[str, str]:
    """What starts it at boot."""
    targets = wanted_by(parts.bridge) if user(request, found) else []
    return {f"{UNITS}/{target}.wants/{UNIT}": PLACE for target in targets}


def membership(request: Request, found: Found) -> list[Command]:
    """The user may drive."""
    name = request.ros2_user
    rows = [line.split(":") for line in found.files.get("/etc/group", b"").decode().splitlines()]
    members = next((row[3].split(",") for row in rows if len(row) == 4 and row[0] == GROUP), [])
    if not name or name == "root" or name in members:
        return []
    where = () if request.live else ("--prefix", request.root)
    words = ("usermod", *where, "--append", "--groups", GROUP, name)
    return [Command("add", f"user {name} to the group {GROUP}", "it may drive", words, touches=ACCOUNT_FILES)]


def units(request: Request, found: Found) -> list[str]:
    """What is to run besides the service."""
    return [UNIT] if user(request, found) else []
