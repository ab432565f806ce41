"""What an installation is made of, as rows: read by `failstop install`, and by the build of the Debian package.

Every file is root's, mode 0644, and removing it undoes it. What is a unit beside the service's own is in extras.py.
"""

from __future__ import annotations

import dataclasses
from importlib import resources

from failstop.install import InstallError
from failstop.install.layout import CATALOG, PACKAGE_UNITS, UDEV, UNITS

LATE = "failstop-late@.service"
SYSUSERS = "failstop.sysusers"
UNIT_COMMAND = "/opt/failstop/bin/failstop"
"""What the units call; replaced when another environment is used."""
SETTINGS, FLEET_SETTINGS = "failstop.toml", "fleet.toml"
"""Generated texts, every value its default: of the service, of the robot in its fleet."""


@dataclasses.dataclass(frozen=True)
class Row:
    """One file."""

    source: str
    """The name of its text."""
    place: str
    """Where `failstop install` puts it: a place of the administrator's."""
    package: str
    """Where a package has it."""
    remark: str
    boot: bool = False
    """A unit that starts with the machine."""


def _unit(name: str, remark: str, boot: bool = False) -> Row:
    return Row(name, f"{UNITS}/{name}", f"{PACKAGE_UNITS}/{name}", remark, boot)


def _completion(shell: str, place: str, package: str = "") -> Row:
    return Row(shell, f"/usr/local/share/{place}", f"/usr/share/{package or place}", f"completion for {shell}")


ROWS = (
    _unit("failstop.service", "the service", boot=True),
    _unit("failstop@.service", "services of further robots, failstop@NAME"),
    _unit("failstop-sleep.service", "stops the wheels before the machine sleeps", boot=True),
    _unit(LATE, "goes on trying, where an ended service could not stop the wheels"),
    Row(
        "failstop.sysusers", "/etc/sysusers.d/failstop.conf", "/usr/lib/sysusers.d/failstop.conf", "its user and group"
    ),
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
BY_SOURCE = {row.source: row for row in ROWS}


def texts(units: tuple[str, ...]) -> dict[str, str]:
    """The texts of this version by their names, with those of further units. Raises InstallError when its files are not
    there."""
    from failstop.cli.commands import completion, config
    from failstop.fleet import settings

    generated = {shell: completion.script(shell) for shell in completion.SHELLS}
    generated |= {SETTINGS: config.example(), FLEET_SETTINGS: settings.example()}
    return generated | {name: _text(name) for name in (*BY_SOURCE, *units) if name not in generated}


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
