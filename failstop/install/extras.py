"""Units beside the service's own, each installed when it is asked for: the bridge to ROS 2, the robot in its fleet, the
operator's page. Pure."""

from __future__ import annotations

from failstop.fleet.settings import KEY_PLACE
from failstop.fleet.settings import PLACE as FLEET_SETTINGS
from failstop.install import InstallError
from failstop.install.layout import ACCOUNT_FILES, UNITS
from failstop.install.parts import UNIT_COMMAND, wanted_by
from failstop.install.steps import Command, File, Step
from failstop.shm.instance import DEFAULT_NAME

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.install.parts import Parts
    from failstop.install.plan import Found, Request


class Extra:
    """One of them. Its choice is a word, such as a user: as asked for, or as it is installed; empty: there is none."""

    part = ""
    """The name of its text among the parts."""
    option = ""
    needs = ""
    """The extra of failstop's that it runs on, as pip calls it; empty: none."""
    unit = ""
    remark = ""
    """Shown where it is started."""

    @property
    def place(self) -> str:
        """Where its unit is."""
        return f"{UNITS}/{self.unit}"

    def asked(self, request: Request) -> str:
        """The choice that was made."""
        raise NotImplementedError

    def chosen(self, text: str) -> str:
        """The choice by which this text of an installed unit was made."""
        return "yes"

    def filled(self, text: str, choice: str, found: Found) -> tuple[str, str]:
        """The unit by a choice, and what is shown of it."""
        return text, self.remark

    def check(self, choice: str, found: Found) -> None:
        """Raise InstallError for a choice that can't be."""

    def before(self, parts: Parts, request: Request, found: Found) -> list[Step]:
        """What it needs besides."""
        return []

    def choice(self, request: Request, found: Found) -> str:
        """As asked for, or as it is installed."""
        if (asked := self.asked(request)) or not (found.manifest and self.place in found.manifest.files):
            return asked
        return self.chosen(found.files.get(self.place, b"").decode())

    def refuse(self, request: Request, found: Found) -> None:
        """Raise InstallError where it could not be put in place."""
        if not (asked := self.asked(request)):
            return
        if request.name != DEFAULT_NAME:
            only = f"its unit is for the robot {DEFAULT_NAME!r} alone, not {request.name!r}"
            raise InstallError(f"{self.option}: {only}")
        self.check(asked, found)
        if self.place in found.links:
            link = found.links[self.place]
            raise InstallError(f"{self.place} is a link to {link}, and is not an installation's: remove it")

    def files(self, parts: Parts, request: Request, found: Found) -> dict[str, tuple[bytes, str]]:
        """The unit, if there is to be one."""
        if not (choice := self.choice(request, found)):
            return {}
        shipped: str = getattr(parts, self.part)
        text, remark = self.filled(shipped.replace(UNIT_COMMAND, request.command), choice, found)
        return {self.place: (text.encode(), remark)}

    def links(self, parts: Parts, request: Request, found: Found) -> dict[str, str]:
        """What starts it at boot."""
        targets = wanted_by(getattr(parts, self.part)) if self.choice(request, found) else []
        return {f"{UNITS}/{target}.wants/{self.unit}": self.place for target in targets}


class Bridge(Extra):
    """The choice is the user of the robot's other nodes."""

    part, option, unit = "bridge", "--ros2-user", "failstop-ros2.service"
    remark = "ROS 2 nodes drive through the service"
    setup = "/opt/ros/humble/setup.sh"
    """What the unit sources as it is shipped."""
    shipped_user = "User=robot\n"
    group = "failstop"

    def asked(self, request: Request) -> str:
        return request.ros2_user

    def chosen(self, text: str) -> str:
        return next((line.partition("=")[2] for line in text.splitlines() if line.startswith("User=")), "")

    def check(self, choice: str, found: Found) -> None:
        if choice == self.group:
            raise InstallError(f"--ros2-user {choice}: that is the service's own user; name the user of your ROS nodes")
        if choice not in {row[0] for row in found.rows("/etc/passwd")}:
            raise InstallError(f"--ros2-user {choice}: no such user; name the one that runs the robot's other nodes")

    def filled(self, text: str, choice: str, found: Found) -> tuple[str, str]:
        text = text.replace(self.shipped_user, f"User={choice}\n").replace(self.setup, found.ros_setup or self.setup)
        return text, f"the bridge to ROS 2, as the user {choice}"

    def before(self, parts: Parts, request: Request, found: Found) -> list[Step]:
        """The user may drive."""
        name = request.ros2_user
        members = next((row[3].split(",") for row in found.rows("/etc/group") if row[0] == self.group), [])
        if not name or name == "root" or name in members:
            return []
        where = () if request.live else ("--prefix", request.root)
        words = ("usermod", *where, "--append", "--groups", self.group, name)
        return [Command("add", f"user {name} to the group {self.group}", "it may drive", words, touches=ACCOUNT_FILES)]


class Fleet(Extra):
    """It is there or not."""

    part, option, unit, needs = "fleet", "--fleet", "failstop-fleet.service", "fleet"
    remark = "the robot is seen on its broker, and obeys a stop of its fleet"

    def asked(self, request: Request) -> str:
        return "yes" if request.fleet else ""

    def check(self, choice: str, found: Found) -> None:
        if not found.fleet_key:
            raise InstallError(
                f"--fleet: there is no {KEY_PLACE}: copy the fleet's key there (chmod 600), or make it, once for the "
                "whole fleet, with `failstop fleet key`"
            )

    def before(self, parts: Parts, request: Request, found: Found) -> list[Step]:
        """The example, unless there are settings: those are the user's, and stay as they are."""
        if not self.choice(request, found) or FLEET_SETTINGS in found.files:
            return []
        remark = "where its broker is: look at it"
        return [File("create", FLEET_SETTINGS, remark, FLEET_SETTINGS, parts.fleet_example.encode())]


class Page(Extra):
    """The choice is VIEW, or OPERATE: paired devices may do more than see and stop."""

    part, option, unit, needs = "page", "--web", "failstop-web.service", "web"
    remark = "the address: failstop web pair"
    user = "User=failstop-web\n"
    group = "SupplementaryGroups=failstop\n"
    """What lets its client drive, and with it enable."""

    def asked(self, request: Request) -> str:
        return request.web

    def chosen(self, text: str) -> str:
        return OPERATE if self.group in text else VIEW

    def filled(self, text: str, choice: str, found: Found) -> tuple[str, str]:
        if choice == OPERATE:
            text = text.replace(self.user, self.user + self.group)
            return text, "the operator's page; paired devices reset and enable (web.pairing)"
        return text, "the operator's page: it sees and stops"


VIEW, OPERATE = "view", "operate"
BRIDGE, FLEET, PAGE = Bridge(), Fleet(), Page()
EXTRAS: tuple[Extra, ...] = (BRIDGE, FLEET, PAGE)
