"""Host: how a service is started on this machine - as it was the last time, else by systemd where it has the unit."""

from __future__ import annotations

import os

from failstop.files import instance, root
from failstop.instances import unit_of
from failstop.policy.settings import BY_KEY

BOOTED = "/run/systemd/system"
"""There when systemd runs the machine (sd_booted(3))."""
FOLDERS = ("/etc/systemd/system", "/run/systemd/system", "/usr/local/lib/systemd/system", "/usr/lib/systemd/system")
"""Where systemd finds units (systemd.unit(5))."""
DEVICE = str(BY_KEY["device.path"].default)


def unit(name: str) -> str:
    """The systemd unit of a service of this name; empty where systemd does not run, or does not have it."""
    found = unit_of(name)
    file = found.replace(f"@{name}.", "@.")
    there = any(os.path.exists(root.at(f"{folder}/{file}")) for folder in FOLDERS)
    return found.removesuffix(".service") if there and os.path.isdir(root.at(BOOTED)) else ""


def start(name: str) -> str:
    """The command that starts it, in backquotes: the last run's own command line, where there was a run."""
    if not instance.last(name).command and (found := unit(name)):
        return f"`sudo systemctl start {found}`"
    return f"`{instance.start_command(name)}`"


def stop(device: str | None = None) -> str:
    """The command that writes a stop without a service, in backquotes."""
    import shlex  # a program that drives need not have it

    return f"`failstop stop{f' --device {shlex.quote(device)}' if device and device != DEVICE else ''}`"


def journal(name: str) -> str:
    """The command that shows what it told, in backquotes; empty where no journal has it."""
    return f"`journalctl -u {found} -e`" if (found := unit(name)) else ""
