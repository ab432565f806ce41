"""Putting the board into this machine's own USB: the kernel's virtual host controller (vhci_hcd) takes a socket.

No network and no tool of USB/IP's: one end of a socket pair is written to the controller's file `attach`. Needs root.
"""

from __future__ import annotations

import glob
import os
import socket

from failstop_lab.sim.pty_port import SimError
from failstop_lab.sim.usb.descriptors import SPEED
from failstop_lab.sim.usb.usbip import DEVICE_ID

CONTROLLER = "/sys/devices/platform/vhci_hcd.0"
DEVICES = "/sys/bus/usb/devices"
_FREE = "004"
_REMEDY = "`modprobe vhci-hcd` as root makes it where the kernel has it; without --usb the board is on a pty"


def free_port(status: str) -> int | None:
    """The first free full-speed port of a table like the controller's file `status`."""
    rows = [line.split() for line in status.splitlines()]
    return next((int(row[1]) for row in rows if row[:1] == ["hs"] and row[2] == _FREE), None)


def bus_id(status: str, port: int) -> str:
    """The kernel's name for the device at a port; empty while it has none."""
    rows = [line.split() for line in status.splitlines()]
    found = next((row[-1] for row in rows if row[:1] == ["hs"] and int(row[1]) == port), "0-0")
    return "" if found == "0-0" else found


def check_controller() -> None:
    """Raise SimError, with the remedy, unless there is a controller that may be used."""
    if not os.path.isdir(CONTROLLER):
        raise SimError(f"no virtual USB controller (vhci_hcd) here: {_REMEDY}")
    if not os.access(f"{CONTROLLER}/attach", os.W_OK):
        raise SimError("the virtual USB controller (vhci_hcd) is root's: run this as root")


def plug_in(theirs: socket.socket) -> int:
    """Plug a device in whose URBs come by this socket; returns the controller's port. Raises SimError."""
    check_controller()
    port = free_port(_status())
    if port is None:
        raise SimError("the virtual USB controller (vhci_hcd) has no free port: end another simulated board")
    try:
        with open(f"{CONTROLLER}/attach", "w") as file:
            file.write(f"{port} {theirs.fileno()} {DEVICE_ID} {SPEED}")
    except OSError as error:
        raise SimError(f"the virtual USB controller (vhci_hcd) refuses the board: {error.strerror}") from None
    return port


def node(port: int) -> str:
    """The tty that the kernel gave the device at a port; empty while there is none."""
    found = bus_id(_status(), port)
    ttys = glob.glob(f"{DEVICES}/{found}/{found}:*/tty/tty*") if found else []
    return f"/dev/{os.path.basename(ttys[0])}" if ttys else ""


def _status() -> str:
    with open(f"{CONTROLLER}/status") as file:
        return file.read()
