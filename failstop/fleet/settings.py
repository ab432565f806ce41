"""The fleet's settings: the broker, this robot's name in the fleet, and the key. These settings have a file of their
own.

The service does not read that file, so a mistake in the file can't keep the service from starting. A computer without a
robot needs the file too, if it is used to stop the fleet.
"""

from __future__ import annotations

import os
import re
import socket

from failstop import config
from failstop.files import durable, root
from failstop.files.instance import DEFAULT_NAME
from failstop.fleet import FleetError
from failstop.policy.setting import Setting, SettingError
from failstop.policy.settings import SWITCH

PLACE = f"{config.FOLDER}/fleet/fleet.toml"
KEY_PLACE = f"{config.FOLDER}/fleet/fleet.key"
UNIT = "failstop-fleet.service"
KEY, PASSWORD, CERT_KEY = "fleet.key", "broker.password", "broker.cert_key"
"""The names of the credentials that systemd may pass to the publisher's unit (LoadCredential)."""
ID = re.compile(r"[A-Za-z0-9_.:-]{1,64}")
"""The allowed names of robots and fleets. They have no `/`, `+` or `#`, because these have a meaning in MQTT topics."""
MOST_DIGITS = 9
"""The longest text that is read as a port. Python refuses to read a number of thousands of digits."""

DECLARED = (
    Setting("broker.host", "127.0.0.1", "", None, None, "the host name or address of the MQTT broker"),
    Setting("broker.port", 1883, "", 1, 65535, "the broker's port; with TLS it is usually 8883"),
    Setting(
        "broker.tls",
        "off",
        "",
        None,
        None,
        "encrypt the connection and check the broker's certificate. Turn it on unless you trust the network",
        SWITCH,
    ),
    Setting(
        "broker.ca_file",
        "",
        "",
        None,
        None,
        "the certificate authority that signed the broker's certificate. Empty: the ones that this computer trusts",
    ),
    Setting("broker.cert_file", "", "", None, None, "this robot's own certificate, if the broker asks for one"),
    Setting("broker.cert_key_file", "", "", None, None, "the private key of that certificate"),
    Setting("broker.user", "", "", None, None, "the user name for the broker. Empty: log in without one"),
    Setting("broker.password_file", "", "", None, None, "a file with the user's password, which nobody else may read"),
    Setting(
        "broker.keepalive_s",
        10,
        "s",
        2,
        600,
        "the broker reports a robot as lost after one and a half times this long without a sign of life",
    ),
    Setting("robot.id", "", "", None, None, "this robot's name in the fleet. Empty: the computer's host name"),
    Setting("robot.fleet", "failstop", "", None, None, "the fleet's name, which must be the same on all its robots"),
    Setting(
        "robot.publish_s", 5.0, "s", 0.5, 30.0, "the robot publishes its state when it changes, and at least this often"
    ),
    Setting(
        "stop.key_file", KEY_PLACE, "", None, None, "the file with the fleet's key, which `failstop fleet key` makes"
    ),
    Setting(
        "stop.tolerance_s",
        10.0,
        "s",
        1.0,
        300.0,
        "a robot refuses a fleet stop whose date differs from its own clock by more than this. Raise it if your clocks "
        "differ",
    ),
    Setting(
        "stop.robots_file",
        "",
        "",
        None,
        None,
        "a file with the names of the robots that must confirm a fleet stop, one per line. Without it, only robots "
        "that the broker remembers are counted",
    ),
)
BY_KEY = {row.key: row for row in DECLARED}
GONE = {
    "robot.manufacturer": "failstop no longer publishes VDA 5050. Remove this line; if it named your fleet, write "
    "robot.fleet instead, the same on every robot and on the computer that stops them",
}
"""Settings of older versions of failstop, each with a text that says what to do."""


class FleetSettings:
    """All settings of the fleet, checked."""

    def __init__(self, given: dict[str, object]) -> None:
        """`given`: values by whole keys such as `broker.host`. All other settings have their defaults. Raises
        SettingError."""
        for key in sorted(set(given) & set(GONE)):
            raise SettingError(f"{key}: {GONE[key]}")
        if unknown := sorted(set(given) - set(BY_KEY)):
            raise SettingError(f"{unknown[0]} is not a setting of the fleet; there are {', '.join(BY_KEY)}")
        self._values = {row.key: row.check(given.get(row.key, row.default)) for row in DECLARED}
        for key in ("robot.id", "robot.fleet"):
            if (value := self.text(key)) and not ID.fullmatch(value):
                raise SettingError(f"{key} = {value!r}: it may have at most 64 letters, digits, `_`, `.`, `:` and `-`")
        self._check_together()

    def _check_together(self) -> None:
        """Refuse settings that would have no effect, such as a certificate without TLS. Raises SettingError."""
        if not self.on("broker.tls"):
            for key in ("broker.ca_file", "broker.cert_file", "broker.cert_key_file"):
                if self.text(key):
                    raise SettingError(
                        f'{key} is set but broker.tls is "off", so nothing would be encrypted: set broker.tls = "on", '
                        f"or remove {key}"
                    )
        for key, needed in (("broker.password_file", "broker.user"), ("broker.cert_key_file", "broker.cert_file")):
            if self.text(key) and not self.text(needed):
                raise SettingError(f"{key} is set but {needed} is not, so it would not be used: set {needed} too")

    def text(self, key: str) -> str:
        """Return the value of a text setting."""
        return str(self._values[key])

    def secret(self, key: str, credential: str) -> str:
        """Return the path of a file with a secret: systemd's file for `credential` if systemd has passed one, else the
        file that the setting `key` names."""
        folder = os.environ.get("CREDENTIALS_DIRECTORY", "")
        handed = os.path.join(folder, credential)
        return handed if folder and os.path.exists(handed) else self.text(key)

    def number(self, key: str) -> float:
        """Return the value of a number setting."""
        return float(self._values[key])

    def on(self, key: str) -> bool:
        """Return True if this switch is on."""
        return self._values[key] == "on"

    def robot_id(self, name: str) -> str:
        """Return the robot's name in the fleet: the setting robot.id, or the computer's host name if that setting is
        empty. The name of the service is added after a "-", unless it is the default name. Raises SettingError if the
        host name is needed but can't be a robot's name."""
        found = self.text("robot.id")
        if not found:
            found = socket.gethostname()
            if not ID.fullmatch(found):
                raise SettingError(f"the host name {found!r} can't be a robot's name: set robot.id")
        return found if name == DEFAULT_NAME else f"{found}-{name}"


def load(path: str | None, changed: dict[str, object] | None = None) -> FleetSettings:
    """Read the settings from `path`, or from the installed file if it exists. Values in `changed` replace those in the
    file. Raises SettingError."""
    if path is None and not durable.missing(installed := root.at(PLACE)):
        path = installed
    found = config.read(path)
    try:
        return FleetSettings({**found, **(changed or {})})
    except SettingError as error:
        if path and (where := config.misplaced(path, found, BY_KEY.__contains__)):
            raise SettingError(f"{path}: {where}") from None
        raise error


def port_number(text: str) -> int | None:
    """Return the number of a port, or None if the text is no number, or one that is far too large."""
    return int(text) if text.isascii() and text.isdigit() and len(text) <= MOST_DIGITS else None


def robots(found: FleetSettings) -> frozenset[str] | None:
    """Return the names in stop.robots_file: the robots that must confirm a fleet stop. None if that setting is empty.
    Raises FleetError."""
    path = found.text("stop.robots_file")
    if not path:
        return None
    try:
        with open(durable.open_regular(path), encoding="utf-8") as file:
            names = {line.partition("#")[0].strip() for line in file} - {""}
    except (OSError, UnicodeError) as error:
        raise FleetError(f"stop.robots_file {path}: {getattr(error, 'strerror', None) or error}") from None
    if wrong := sorted(name for name in names if not ID.fullmatch(name)):
        raise FleetError(f"stop.robots_file {path}: {wrong[0]!r} can't be a robot's name")
    if not names:
        raise FleetError(
            f"stop.robots_file {path} lists no robot: write one name per line into it, or leave stop.robots_file empty"
        )
    return frozenset(names)


def unreadable(key: str, path: str, error: OSError, credential: str) -> FleetError:
    """Return an error that names the setting and the file. If the permissions of the file are the problem, the error
    also names the remedy. `credential`: the systemd credential that can pass the file to the unit, or "" if the file is
    not secret."""
    text = f"{key} {path}: {error.strerror or error}"
    if not isinstance(error, PermissionError):
        return FleetError(text)
    if not credential:
        return FleetError(f"{text}. It is not a secret, so let everybody read it: chmod 644 {path}")
    return FleetError(
        f"{text}. {UNIT} runs as a user without rights, so hand it the file: `systemctl edit {UNIT}`, and add under "
        f"[Service] LoadCredential={credential}:{path}. Without systemd, chown the file to this user and chmod 600 it"
    )


def example() -> str:
    """Return an example settings file, with every setting commented out at its default. Settings have whole keys, so a
    person may add one anywhere in the file."""
    lines = [
        "# The robot in its fleet: docs/fleet.md. Each line shows a default. To change one, remove its #, or add",
        "# a line with the whole name anywhere.",
    ]
    table = ""
    for row in DECLARED:
        head = row.key.partition(".")[0]
        if head != table:
            table = head
            lines.append("")
        value = f'"{row.default}"' if isinstance(row.default, str) else f"{row.default}"
        lines.append(f"#{row.key} = {value}  # {row.doc}")
    return "\n".join(lines) + "\n"


def markdown() -> list[str]:
    """Return the lines of the settings table in docs/fleet.md."""
    rows = ["| setting | default | allowed | what it is |", "|---|---|---|---|"]
    for row in DECLARED:
        default = f"`{row.default}`" if row.default != "" else ""
        unit = f" {row.unit}" if row.unit else ""
        rows.append(f"| `{row.key}` | {default}{unit} | {row.range()} | {row.doc} |")
    return rows
