"""Host: how a service is started on this machine - by systemd where it has the unit, else by hand."""

from __future__ import annotations

import os

from failstop.api import words
from failstop.policy.settings import BY_KEY
from failstop.shm import instance, root

BOOTED = "/run/systemd/system"
"""There when systemd runs the machine (sd_booted(3))."""
FOLDERS = ("/etc/systemd/system", "/run/systemd/system", "/usr/local/lib/systemd/system", "/usr/lib/systemd/system")
"""Where systemd finds units (systemd.unit(5))."""
DEVICE = str(BY_KEY["device.path"].default)


def unit(name: str) -> str:
    """The systemd unit of a service of this name; empty where systemd does not run, or does not have it."""
    found = words.unit(name)
    file = f"{found.partition('@')[0]}{'@' * ('@' in found)}.service"
    folders = [root.at(folder) for folder in FOLDERS]
    there = os.path.isdir(root.at(BOOTED)) and any(os.path.exists(os.path.join(folder, file)) for folder in folders)
    return found if there else ""


def start(name: str, device: str | None = None) -> str:
    """The command that starts it, in backquotes. `device`: the port that it had, where that is known."""
    if found := unit(name):
        return f"`sudo systemctl start {found}`"
    return f"`failstop run{instance.option(name)}{f' --device {device}' if device and device != DEVICE else ''}`"


def stop(device: str | None = None) -> str:
    """The command that writes a stop without a service, in backquotes."""
    return f"`failstop stop{f' --device {device}' if device and device != DEVICE else ''}`"


def journal(name: str) -> str:
    """The command that shows what it told, in backquotes; empty where no journal has it."""
    return f"`journalctl -u {found} -e`" if (found := unit(name)) else ""
