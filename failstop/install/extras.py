"""Units beside the service's own, each installed when it is asked for: the bridge to ROS 2, the robot in its fleet, the
operator's page. Pure."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from failstop.fleet.settings import KEY_PLACE, PLACE
from failstop.install import InstallError
from failstop.install.layout import PACKAGE_UNITS, UNITS
from failstop.shm.instance import DEFAULT_NAME

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.install.found import Found, Request

VIEW, OPERATE = "view", "operate"
SERVICE_USER = "failstop"
ROS_SETUP = "/opt/ros/humble/setup.sh"
"""What the bridge's unit sources as it is shipped."""
PAGE_USER = "User=failstop-web\n"
FLEET_REMARK = "the robot is seen on its broker, and obeys a stop of its fleet"
MAY_DRIVE = "SupplementaryGroups=failstop\n"
"""What lets the page's client drive, and with it enable."""


@dataclasses.dataclass(frozen=True)
class Extra:
    """One of them. Its choice is a word, such as a user: as asked for, or as it is installed; empty: there is none."""

    unit: str
    field: str
    """Of the request: what was asked for."""
    remark: str
    """Shown where it is started."""
    filled: Callable[[str, str, Found], tuple[str, str]]
    """(the shipped text, the choice, what is there): the unit by that choice, and what is shown of it."""
    chosen: Callable[[str], str] = lambda text: "yes"
    """The choice by which this text of an installed unit was made."""
    problem: Callable[[str, Found], str] = lambda choice, found: ""
    """Why the choice can't be; empty: it can."""
    option: str = ""
    needs: str = ""
    """The extra of failstop's that it runs on, as pip calls it; empty: none."""
    settings: str = ""
    """Where its own settings are, if it has some; they are the user's."""

    @property
    def place(self) -> str:
        """Where its unit is."""
        return f"{UNITS}/{self.unit}"

    @property
    def package(self) -> str:
        """Where a package has its unit."""
        return f"{PACKAGE_UNITS}/{self.unit}"

    def choice(self, request: Request, found: Found) -> str:
        """As asked for, or as it is installed."""
        asked = str(getattr(request, self.field) or "")
        if asked or not (found.manifest and self.place in found.manifest.files):
            return asked
        return self.chosen(found.files.get(self.place, b"").decode())

    def refuse(self, request: Request, found: Found) -> None:
        """Raise InstallError where it could not be put in place."""
        if not (asked := getattr(request, self.field)):
            return
        if request.name != DEFAULT_NAME:
            only = f"its unit is for the robot {DEFAULT_NAME!r} alone, not {request.name!r}"
            raise InstallError(f"{self.option}: {only}")
        if problem := self.problem(asked, found):
            raise InstallError(f"{self.option}{problem}")
        if self.place in found.links:
            link = found.links[self.place]
            raise InstallError(f"{self.place} is a link to {link}, and is not an installation's: remove it")


def _bridge_user(text: str) -> str:
    return next((line.partition("=")[2] for line in text.splitlines() if line.startswith("User=")), "")


def _bridge_problem(user: str, found: Found) -> str:
    if user == SERVICE_USER:
        return f" {user}: that is the service's own user; name the user of your ROS nodes"
    if user not in {row[0] for row in found.rows("/etc/passwd")}:
        return f" {user}: no such user; name the one that runs the robot's other nodes"
    return ""


def _bridge(text: str, user: str, found: Found) -> tuple[str, str]:
    text = text.replace("User=robot\n", f"User={user}\n").replace(ROS_SETUP, found.ros_setup or ROS_SETUP)
    return text, f"the bridge to ROS 2, as the user {user}"


def _fleet_problem(_: str, found: Found) -> str:
    return (
        ""
        if found.fleet_key
        else (
            f": there is no {KEY_PLACE}: copy the fleet's key there (chmod 600), or make it, once for the "
            "whole fleet, with `failstop fleet key`"
        )
    )


def _page(text: str, choice: str, _: Found) -> tuple[str, str]:
    if choice == OPERATE:
        text = text.replace(PAGE_USER, PAGE_USER + MAY_DRIVE)
        return text, "the operator's page; paired devices reset and enable (web.pairing)"
    return text, "the operator's page: it sees and stops"


BRIDGE = Extra(
    "failstop-ros2.service",
    "ros2_user",
    "ROS 2 nodes drive through the service",
    _bridge,
    _bridge_user,
    _bridge_problem,
    "--ros2-user",
)
FLEET = Extra(
    "failstop-fleet.service",
    "fleet",
    FLEET_REMARK,
    lambda text, *_: (text, FLEET_REMARK),
    problem=_fleet_problem,
    option="--fleet",
    needs="fleet",
    settings=PLACE,
)
PAGE = Extra(
    "failstop-web.service",
    "web",
    "the address: failstop web pair",
    _page,
    lambda text: OPERATE if MAY_DRIVE in text else VIEW,
    option="--web",
    needs="web",
)
EXTRAS = (BRIDGE, FLEET, PAGE)
UNITS_OF_EXTRAS = tuple(extra.unit for extra in EXTRAS)
