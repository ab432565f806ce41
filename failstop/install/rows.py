"""What an installation is made of: where things are in an installed system, and its files as rows, which
`failstop install` and the build of the Debian package read.

Every file is root's, mode 0644, and removing it undoes it. The extras are units beside the service's own, each
installed when it is asked for: the bridge to ROS 2, the robot in its fleet, the operator's page.
"""

from __future__ import annotations

import dataclasses
import glob
import os
from importlib import resources

from failstop.fleet.settings import KEY_PLACE
from failstop.install.system import PREFIX, System

UNIT_COMMAND = f"{PREFIX}/bin/failstop"
"""What the units call; replaced when another environment is used."""
# The administrator's places: those under /usr/lib belong to packages.
UNITS = "/etc/systemd/system"
UDEV = "/etc/udev/rules.d/90-failstop.rules"
CATALOG = "/usr/local/lib/systemd/catalog/failstop.catalog"
SYSUSERS = "/etc/sysusers.d/failstop.conf"
COMMAND_LINK = "/usr/local/bin/failstop"

SERVICE, TEMPLATE, LATE = "failstop.service", "failstop@.service", "failstop-late@.service"
SETTINGS, FLEET_SETTINGS = "failstop.toml", "fleet.toml"
"""Generated texts, every value its default: of the service, of the robot in its fleet."""
USER = "failstop"
"""The service's; its group too."""
PORT_GROUP = "dialout"
ROS_SETUP = "/opt/ros/humble/setup.sh"
"""What the bridge's unit sources as it is shipped."""
ROS_SETUPS = "opt/ros/*/setup.sh"
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
    """Where `failstop install` puts it."""
    remark: str
    boot: bool = False
    """A unit that starts with the machine."""
    vendor: str = ""
    """Where a package has it, if that is not the vendor's counterpart of the place."""

    @property
    def package(self) -> str:
        """Where a package has it."""
        return self.vendor or self.place.replace("/usr/local/", "/usr/").replace("/etc/", "/usr/lib/")

    def filled(self, text: str, word: str, system: System) -> tuple[str, str]:
        """What is written of its text, and shown of it, for the word that an extra is asked for by."""
        return text, self.remark


@dataclasses.dataclass(frozen=True, kw_only=True)
class Extra(Row):
    """A unit that is installed by a word, such as a user's name."""

    option: str
    started: str
    """Shown where it is started."""
    needs: str = ""
    """The extra of failstop's that it runs on, as pip calls it; empty: none."""

    def problem(self, word: str, system: System) -> str:
        """Why the word can't be; empty: it can."""
        return ""

    def word_of(self, text: str) -> str:
        """The word by which this text of an installed unit was made."""
        return YES


class Bridge(Extra):
    """The bridge to ROS 2, by the name of the user that it runs as."""

    def problem(self, word: str, system: System) -> str:
        if word == USER:
            return f" {word}: that is the service's own user; name the user of your ROS nodes"
        if word not in system.accounts("passwd"):
            return f" {word}: no such user; name the one that runs the robot's other nodes"
        return ""

    def word_of(self, text: str) -> str:
        return next((line.partition("=")[2] for line in text.splitlines() if line.startswith("User=")), "")

    def filled(self, text: str, word: str, system: System) -> tuple[str, str]:
        # The newest ROS 2 that is there.
        found = max(glob.glob(ROS_SETUPS, root_dir=system.root), default=ROS_SETUP.lstrip("/"))
        text = text.replace("User=robot\n", f"User={word}\n").replace(ROS_SETUP, f"/{found}")
        return text, f"the bridge to ROS 2, as the user {word}"


class Fleet(Extra):
    """The robot in its fleet."""

    def problem(self, word: str, system: System) -> str:
        if os.path.isfile(system.at(KEY_PLACE)):
            return ""
        return (
            f": there is no {KEY_PLACE}: copy the fleet's key there (chmod 600), or make it, once for the "
            "whole fleet, with `failstop fleet key`"
        )


class Page(Extra):
    """The operator's page, by what its devices may do."""

    def word_of(self, text: str) -> str:
        return OPERATE if MAY_DRIVE in text else VIEW

    def filled(self, text: str, word: str, system: System) -> tuple[str, str]:
        if word == VIEW:
            return text, "the operator's page: it sees and stops"
        text = text.replace(PAGE_USER, PAGE_USER + MAY_DRIVE)
        return text, "the operator's page; paired devices reset and enable (web.pairing)"


def _unit(name: str) -> tuple[str, str]:
    return name, f"{UNITS}/{name}"


OWN = (
    Row(*_unit(SERVICE), "the service", boot=True),
    Row(*_unit(TEMPLATE), "services of further robots, failstop@NAME"),
    Row(*_unit("failstop-sleep.service"), "stops the wheels before the machine sleeps", boot=True),
    Row(*_unit(LATE), "goes on trying, where an ended service could not stop the wheels"),
    Row("failstop.sysusers", SYSUSERS, "its user and group"),
    Row("failstop.udev", UDEV, "the board's port: a name, its rights, nobody else touches it"),
    Row("failstop.catalog", CATALOG, "explanations for journalctl -x"),
    Row(
        "failstop.1",
        "/usr/local/share/man/man1/failstop.1",
        "the manual, man failstop",
        vendor="/usr/share/man/man1/failstop.1.gz",
    ),
    # Where each shell looks by itself.
    Row("bash", "/usr/local/share/bash-completion/completions/failstop", "completion for bash"),
    Row(
        "zsh",
        "/usr/local/share/zsh/site-functions/_failstop",
        "completion for zsh",
        vendor="/usr/share/zsh/vendor-completions/_failstop",
    ),
    Row("fish", "/usr/local/share/fish/vendor_completions.d/failstop.fish", "completion for fish"),
)
"""What every installation has."""
FLEET_SAYS = "the robot is seen on its broker, and obeys a stop of its fleet"
BRIDGE = Bridge(
    *_unit("failstop-ros2.service"),
    "",
    boot=True,
    option="--ros2-user",
    started="ROS 2 nodes drive through the service",
)
FLEET = Fleet(
    *_unit("failstop-fleet.service"),
    FLEET_SAYS,
    boot=True,
    option="--fleet",
    started=FLEET_SAYS,
    needs="fleet",
)
PAGE = Page(
    *_unit("failstop-web.service"),
    "",
    boot=True,
    option="--web",
    started="the address: failstop web pair",
    needs="web",
)
EXTRAS = (BRIDGE, FLEET, PAGE)
ROWS: tuple[Row, ...] = (*OWN, *EXTRAS)


def unit_file(unit: str) -> str:
    """The file that a unit comes from."""
    return f"{UNITS}/{TEMPLATE}" if "@" in unit else f"{UNITS}/{unit}"


def texts() -> dict[str, str]:
    """The texts of this version by their names."""
    from failstop.cli.commands import completion
    from failstop.cli.commands.config import example
    from failstop.fleet import settings

    generated = {shell: completion.script(shell) for shell in completion.SHELLS}
    generated |= {SETTINGS: example(), FLEET_SETTINGS: settings.example()}
    folder = resources.files("failstop") / "systemd"
    names = [row.source for row in ROWS if row.source not in generated]
    return generated | {name: (folder / name).read_text(encoding="utf-8") for name in names}


def wanted_by(unit: str) -> list[str]:
    """The targets that the [Install] section of a unit's text names."""
    lines = [line.split("=", 1)[1] for line in unit.splitlines() if line.startswith("WantedBy=")]
    return " ".join(lines).split()
