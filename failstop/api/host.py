"""Host: how a service is started on this computer: in the same way as the last time, else by systemd if the unit is
installed."""

from __future__ import annotations

import os

from failstop.files import instance, root
from failstop.instances import unit_of
from failstop.policy.settings import BY_KEY

BOOTED = "/run/systemd/system"
"""Exists when systemd runs the machine (sd_booted(3))."""
FOLDERS = ("/etc/systemd/system", "/run/systemd/system", "/usr/local/lib/systemd/system", "/usr/lib/systemd/system")
"""Where systemd finds units (systemd.unit(5))."""
DEVICE = str(BY_KEY["device.path"].default)


def unit(name: str) -> str:
    """The systemd unit of a service of this name; empty if systemd does not run or has no such unit."""
    found = unit_of(name)
    file = found.replace(f"@{name}.", "@.")
    there = any(os.path.exists(root.at(f"{folder}/{file}")) for folder in FOLDERS)
    return found.removesuffix(".service") if there and os.path.isdir(root.at(BOOTED)) else ""


def start(name: str) -> str:
    """The command that starts the service, in backquotes. If there was a run before, it is the command line of that
    run."""
    if not instance.last(name).command and (found := unit(name)):
        return f"`sudo systemctl start {found}`"
    return f"`{instance.start_command(name)}`"


def stop(device: str | None = None) -> str:
    """The command that writes a stop without a service, in backquotes."""
    import shlex  # a program that drives may not have it installed

    return f"`failstop stop{f' --device {shlex.quote(device)}' if device and device != DEVICE else ''}`"


def journal(name: str) -> str:
    """The command that shows the service's events in the journal, in backquotes; empty if there is no journal with
    them."""
    return f"`journalctl -u {found} -e`" if (found := unit(name)) else ""
