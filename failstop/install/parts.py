"""What this version of failstop brings to a machine: the files of the folder systemd/, and generated texts: an example
configuration, completion for the shells."""

from __future__ import annotations

import dataclasses
from importlib import resources

from failstop.install import InstallError
from failstop.version import VERSION

SERVICE = "failstop.service"
TEMPLATE = "failstop@.service"
SLEEP = "failstop-sleep.service"
LATE = "failstop-late@.service"
OWN_UNITS = (SERVICE, TEMPLATE, SLEEP, LATE)
UNIT_COMMAND = "/opt/failstop/bin/failstop"
"""What the units call; replaced when another environment is used."""


@dataclasses.dataclass(frozen=True)
class Parts:
    """The texts that are installed."""

    version: str
    units: dict[str, str]
    """By the unit's name."""
    sysusers: str
    udev: str
    catalog: str
    example: str
    """A complete configuration, every value its default."""
    manual: str
    """The man page, as roff."""
    completions: dict[str, str]
    """The completion script by shell."""
    bridge: str = ""
    """The unit of the bridge to ROS 2."""
    fleet: str = ""
    """The unit of the robot in its fleet."""
    fleet_example: str = ""
    """Its settings, every value its default."""
    page: str = ""
    """The unit of the operator's page."""


def of_this_version() -> Parts:
    """The parts of the running failstop. Raises InstallError when its files are not there."""
    from failstop.cli.commands import completion, config
    from failstop.fleet import settings

    return Parts(
        VERSION,
        {name: _text(name) for name in OWN_UNITS},
        _text("failstop.sysusers"),
        _text("failstop.udev"),
        _text("failstop.catalog"),
        config.example(),
        _text("failstop.1"),
        {shell: completion.script(shell) for shell in completion.SHELLS},
        _text("failstop-ros2.service"),
        _text("failstop-fleet.service"),
        settings.example(),
        _text("failstop-web.service"),
    )


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


def accounts(sysusers: str) -> tuple[list[str], list[tuple[str, str]]]:
    """The users that a sysusers.d text creates, and the memberships (user, group) that it asks for."""
    rows = [line.split() for line in sysusers.splitlines() if line.strip() and not line.startswith("#")]
    users = [row[1] for row in rows if row[0].startswith("u")]
    return users, [(row[1], row[2]) for row in rows if row[0] == "m"]
