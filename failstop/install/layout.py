"""Where things are in an installed system, and the list that `failstop install` keeps of what it put there. Pure."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from typing import Any

from failstop import config
from failstop.install import InstallError
from failstop.shm.instance import DEFAULT_NAME

PREFIX = "/opt/failstop"
UNIT_COMMAND = f"{PREFIX}/bin/failstop"
"""What the units call; replaced when another environment is used."""
MANIFEST_NAME = "install.json"
MANIFEST = f"{PREFIX}/{MANIFEST_NAME}"
# The administrator's places: those under /usr/lib belong to packages.
UNITS = "/etc/systemd/system"
UDEV = "/etc/udev/rules.d/90-failstop.rules"
CATALOG = "/usr/local/lib/systemd/catalog/failstop.catalog"
COMMAND_LINK = "/usr/local/bin/failstop"
CONFIGURATION = config.FOLDER
configuration_of = config.file_of
STATE = "/var/lib/failstop"
RUNTIME = "/run/failstop"
PACKAGE_UNITS = "/usr/lib/systemd/system"
PACKAGE_UNIT = f"{PACKAGE_UNITS}/failstop.service"
"""There when the Debian package is installed."""
ACCOUNT_FILES = tuple(
    f"/etc/{name}"
    for name in ("passwd", "passwd-", "group", "group-", "shadow", "shadow-", "gshadow", "gshadow-", ".pwd.lock")
)
CATALOG_DATABASE = "/var/lib/systemd/catalog/database"


def unit_of(name: str) -> str:
    """The unit of an instance."""
    return "failstop.service" if name == DEFAULT_NAME else f"failstop@{name}.service"


def unit_file(unit: str) -> str:
    """The file that a unit comes from."""
    return f"{UNITS}/failstop@.service" if "@" in unit else f"{UNITS}/{unit}"


def parents(path: str) -> list[str]:
    """The directories that hold a path, the outermost first, without the root."""
    found = []
    while (path := os.path.dirname(path)) != "/":
        found.append(path)
    return found[::-1]


@dataclasses.dataclass(frozen=True)
class Manifest:
    """What is installed; the same content always has the same bytes."""

    version: str = ""
    command: str = ""
    """The command that the units call."""
    tree: str = ""
    """The digest of the environment; empty when another one is used."""
    files: dict[str, str] = dataclasses.field(default_factory=dict)
    """SHA-256 by path. Configuration is not among them: it is the user's."""
    links: dict[str, str] = dataclasses.field(default_factory=dict)
    directories: tuple[str, ...] = ()
    """Made by an installation, the outermost first."""

    def dump(self) -> bytes:
        """As JSON."""
        return (json.dumps(dataclasses.asdict(self), indent=2, sort_keys=True) + "\n").encode()

    @classmethod
    def load(cls, data: bytes) -> Manifest:
        """The inverse. Raises InstallError."""
        try:
            found: dict[str, Any] = json.loads(data)
            return cls(**{**found, "directories": tuple(found["directories"])})
        except (ValueError, TypeError, KeyError) as error:
            raise InstallError(
                f"{MANIFEST} is damaged ({error}): remove it, and `failstop install` writes it again"
            ) from None


def sha256(data: bytes) -> str:
    """As hex digits."""
    return hashlib.sha256(data).hexdigest()
