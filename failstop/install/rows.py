"""What an installation is made of, as rows: read by `failstop install`, and by the build of the Debian package.

Every file is root's, mode 0644, and removing it undoes it. The extras are units beside the service's own, each
installed when it is asked for: the bridge to ROS 2, the robot in its fleet, the operator's page. Pure but for texts().
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from importlib import resources

from failstop.fleet.settings import KEY_PLACE, PLACE
from failstop.install import InstallError
from failstop.install.layout import CATALOG, PACKAGE_UNITS, UDEV, UNITS
from failstop.shm.instance import DEFAULT_NAME

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.install.found import Found, Request

SERVICE, LATE, SYSUSERS = "failstop.service", "failstop-late@.service", "failstop.sysusers"
SETTINGS, FLEET_SETTINGS = "failstop.toml", "fleet.toml"
"""Generated texts, every value its default: of the service, of the robot in its fleet."""
SERVICE_USER = "failstop"
ROS_SETUP = "/opt/ros/humble/setup.sh"
"""What the bridge's unit sources as it is shipped."""
VIEW, OPERATE = "view", "operate"
PAGE_USER = "User=failstop-web\n"
MAY_DRIVE = "SupplementaryGroups=failstop\n"
"""What lets the page's client drive, and with it enable."""
YES = "yes"


@dataclasses.dataclass(frozen=True)
class Row:
    """One file."""

    source: str
    """The name of its text; of a unit, its own."""
    place: str
    """Where `failstop install` puts it: a place of the administrator's."""
    package: str
    """Where a package has it."""
    remark: str
    boot: bool = False
    """A unit that starts with the machine."""

    def choice(self, request: Request, found: Found) -> str:
        """By what it is installed: as asked for, or as it is there; empty: not at all."""
        return YES

    def filled(self, text: str, choice: str, found: Found) -> tuple[str, str]:
        """The text that is installed by that choice, and what is shown of it."""
        return text, self.remark


@dataclasses.dataclass(frozen=True, kw_only=True)
class Extra(Row):
    """A unit whose choice is a word, such as a user."""

    option: str
    field: str
    """Of the request: what was asked for."""
    started: str
    """Shown where it is started."""
    chosen: Callable[[str], str] = lambda text: YES
    """The choice by which this text of an installed unit was made."""
    fill: Callable[[str, str, Found], tuple[str, str]] | None = None
    """What the choice makes of the text, and what is shown of it."""
    problem: Callable[[str, Found], str] = lambda choice, found: ""
    """Why the choice can't be; empty: it can."""
    needs: str = ""
    """The extra of failstop's that it runs on, as pip calls it; empty: none."""
    settings: str = ""
    """Where its own settings are, if it has some; they are the user's."""

    def choice(self, request: Request, found: Found) -> str:
        asked = str(getattr(request, self.field) or "")
        if asked or not (found.manifest and self.place in found.manifest.files):
            return asked
        return self.chosen(found.files.get(self.place, b"").decode())

    def filled(self, text: str, choice: str, found: Found) -> tuple[str, str]:
        return self.fill(text, choice, found) if self.fill else (text, self.remark)

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
    lacks = (
        f": there is no {KEY_PLACE}: copy the fleet's key there (chmod 600), or make it, once for the "
        "whole fleet, with `failstop fleet key`"
    )
    return "" if found.fleet_key else lacks


def _page(text: str, choice: str, _: Found) -> tuple[str, str]:
    if choice == VIEW:
        return text, "the operator's page: it sees and stops"
    text = text.replace(PAGE_USER, PAGE_USER + MAY_DRIVE)
    return text, "the operator's page; paired devices reset and enable (web.pairing)"


def _unit(name: str) -> tuple[str, str, str]:
    return name, f"{UNITS}/{name}", f"{PACKAGE_UNITS}/{name}"


def _completion(shell: str, place: str, package: str = "") -> Row:
    return Row(shell, f"/usr/local/share/{place}", f"/usr/share/{package or place}", f"completion for {shell}")


OWN = (
    Row(*_unit(SERVICE), "the service", boot=True),
    Row(*_unit("failstop@.service"), "services of further robots, failstop@NAME"),
    Row(*_unit("failstop-sleep.service"), "stops the wheels before the machine sleeps", boot=True),
    Row(*_unit(LATE), "goes on trying, where an ended service could not stop the wheels"),
    Row(SYSUSERS, "/etc/sysusers.d/failstop.conf", "/usr/lib/sysusers.d/failstop.conf", "its user and group"),
    Row(
        "failstop.udev",
        UDEV,
        "/usr/lib/udev/rules.d/90-failstop.rules",
        "the board's port: a name, its rights, nobody else touches it",
    ),
    Row("failstop.catalog", CATALOG, "/usr/lib/systemd/catalog/failstop.catalog", "explanations for journalctl -x"),
    Row(
        "failstop.1",
        "/usr/local/share/man/man1/failstop.1",
        "/usr/share/man/man1/failstop.1.gz",
        "the manual, man failstop",
    ),
    # Where each shell looks by itself.
    _completion("bash", "bash-completion/completions/failstop"),
    _completion("zsh", "zsh/site-functions/_failstop", "zsh/vendor-completions/_failstop"),
    _completion("fish", "fish/vendor_completions.d/failstop.fish"),
)
"""What every installation has."""
BRIDGE = Extra(
    *_unit("failstop-ros2.service"),
    "",
    boot=True,
    option="--ros2-user",
    field="ros2_user",
    started="ROS 2 nodes drive through the service",
    chosen=_bridge_user,
    fill=_bridge,
    problem=_bridge_problem,
)
FLEET = Extra(
    *_unit("failstop-fleet.service"),
    "the robot is seen on its broker, and obeys a stop of its fleet",
    boot=True,
    option="--fleet",
    field="fleet",
    started="the robot is seen on its broker, and obeys a stop of its fleet",
    problem=_fleet_problem,
    needs="fleet",
    settings=PLACE,
)
PAGE = Extra(
    *_unit("failstop-web.service"),
    "",
    boot=True,
    option="--web",
    field="web",
    started="the address: failstop web pair",
    chosen=lambda text: OPERATE if MAY_DRIVE in text else VIEW,
    fill=_page,
    needs="web",
)
EXTRAS = (BRIDGE, FLEET, PAGE)
ROWS: tuple[Row, ...] = (*OWN, *EXTRAS)


def texts() -> dict[str, str]:
    """The texts of this version by their names. Raises InstallError when its files are not there."""
    from failstop.cli.commands import completion, config
    from failstop.fleet import settings

    generated = {shell: completion.script(shell) for shell in completion.SHELLS}
    generated |= {SETTINGS: config.example(), FLEET_SETTINGS: settings.example()}
    return generated | {row.source: _text(row.source) for row in ROWS if row.source not in generated}


def _text(name: str) -> str:
    try:
        return (resources.files("failstop") / "systemd" / name).read_text(encoding="utf-8")
    except OSError as error:
        raise InstallError(
            f"this failstop comes without its file systemd/{name} ({error.strerror}): install it again with pip"
        ) from None


def wanted_by(unit: str) -> list[str]:
    """The targets that the [Install] section of a unit's text names."""
    lines = [line.split("=", 1)[1] for line in unit.splitlines() if line.startswith("WantedBy=")]
    return " ".join(lines).split()


def entries(sysusers: str) -> list[str]:
    """The lines of a sysusers.d text that say something."""
    return [line for line in sysusers.splitlines() if line.strip() and not line.startswith("#")]


def accounts(sysusers: str) -> tuple[list[str], list[tuple[str, str]]]:
    """The users that a sysusers.d text creates, and the memberships (user, group) that it asks for."""
    rows = [line.split() for line in entries(sysusers)]
    return [row[1] for row in rows if row[0].startswith("u")], [(row[1], row[2]) for row in rows if row[0] == "m"]
