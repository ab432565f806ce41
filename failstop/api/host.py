"""Host: the commands that start or stop a service on this computer."""

from __future__ import annotations

import os

from failstop.files import instance, root
from failstop.instances import unit_of

BOOTED = "/run/systemd/system"
"""This folder exists if the computer was booted with systemd (sd_booted(3))."""
FOLDERS = ("/etc/systemd/system", "/run/systemd/system", "/usr/local/lib/systemd/system", "/usr/lib/systemd/system")
"""The folders in which systemd looks for units (systemd.unit(5))."""


def unit(name: str) -> str:
    """The systemd unit of the service with this name. Empty if this computer was not booted with systemd, or if the
    unit is not installed."""
    found = unit_of(name)
    file = found.replace(f"@{name}.", "@.")
    there = any(os.path.exists(root.at(f"{folder}/{file}")) for folder in FOLDERS)
    return found.removesuffix(".service") if there and os.path.isdir(root.at(BOOTED)) else ""


def start(name: str) -> str:
    """Return the command that starts the service, in backquotes. If a command has started this service before, it is
    that command. Otherwise it is `systemctl start` if the systemd unit is installed, and `failstop run` if not."""
    if not instance.last(name).command and (found := unit(name)):
        return f"`sudo systemctl start {found}`"
    return f"`{instance.start_command(name)}`"


def stop(name: str) -> str:
    """Return the command, in backquotes, that stops the board of this service while the service is not running. It
    names no port, because with the name it finds the port and the kind of board of the last run. With the port alone it
    would not know which kind of board is there."""
    return f"`failstop stop{instance.option(name)}`"


def journal(name: str) -> str:
    """Return the command, in backquotes, that shows the service's events in the journal. Empty if the service has no
    systemd unit, because its events are then not in the journal."""
    return f"`journalctl -u {found} -e`" if (found := unit(name)) else ""
