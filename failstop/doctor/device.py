"""The device's file as it is found: what is behind it, and who has it open."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import stat

from failstop import discovery
from failstop.discovery import BOARD_PID, BOARD_VID
from failstop.doctor.system import System

BOARD_USB = f"{BOARD_VID:04x}:{BOARD_PID:04x}"
PSEUDO_MAJORS = range(136, 144)
"""Of the pseudo-terminals (the kernel's list of devices)."""
USB_DEPTH = 6
"""A serial node is so many directories below its USB device at most."""


@dataclasses.dataclass(frozen=True)
class Node:
    """The device's file."""

    path: str
    resolved: str
    """The path behind all links."""
    character: bool
    pseudo: bool
    """A pseudo-terminal, as the simulated board's."""
    mode: int
    uid: int
    gid: int
    group: str
    usb_id: str | None = None
    """vendor:product in hexadecimal."""
    product: str = ""
    modem_ignored: bool = False
    """udev tells ModemManager to leave it, or the whole USB device, alone."""
    acl: bool = False
    """Access is refined by an access control list."""
    accessible: bool = False
    """This process may read and write it."""
    link: str = ""
    """The name that udev's rule gives this same device, if it is another; empty: none."""


@dataclasses.dataclass(frozen=True)
class Holder:
    """A process that has the device open."""

    pid: int
    name: str
    unit: str = ""
    """Its systemd service, if it is in one."""
    ours: bool = False
    """One of the processes of the running service of this name."""
    instance: str = ""
    """Whose service it belongs to, if it is one of failstop's processes."""


def node(path: str, system: System) -> Node | None:
    """The device's file; None when it is not there."""
    import grp

    try:
        found = os.stat(path)
    except OSError:
        return None
    group = str(found.st_gid)
    with contextlib.suppress(KeyError):
        group = grp.getgrgid(found.st_gid).gr_name
    acl = False
    with contextlib.suppress(OSError):
        acl = "system.posix_acl_access" in os.listxattr(path)
    resolved, link = os.path.realpath(path), system.path(discovery.LINK)
    character, major, minor = stat.S_ISCHR(found.st_mode), os.major(found.st_rdev), os.minor(found.st_rdev)
    place = f"/sys/dev/char/{major}:{minor}"
    usb_id, product = usb_identity(f"{place}/device", system)
    return Node(
        path,
        resolved,
        character,
        character and major in PSEUDO_MAJORS,
        stat.S_IMODE(found.st_mode),
        found.st_uid,
        found.st_gid,
        group,
        usb_id,
        product,
        modem_ignored(place, system),
        acl,
        os.access(path, os.R_OK | os.W_OK),
        link if path != link and os.path.realpath(link) == resolved else "",
    )


def usb_identity(device: str, system: System) -> tuple[str | None, str]:
    """(vendor:product, product's name) of the USB device above a node in sysfs."""
    at = _usb_device(device, system)
    if at is None:
        return None, ""
    return f"{system.read(f'{at}/idVendor')}:{system.read(f'{at}/idProduct')}", system.read(f"{at}/product") or ""


def _usb_device(device: str, system: System) -> str | None:
    """Where in sysfs the USB device above another device is."""
    place = os.path.realpath(system.path(device))
    for _ in range(USB_DEPTH):
        at = "/" + os.path.relpath(place, system.root)
        if system.read(f"{at}/idVendor") and system.read(f"{at}/idProduct"):
            return at
        place = os.path.dirname(place)
    return None


def modem_ignored(place: str, system: System) -> bool:
    """What udev's database says of a node, whose place in sysfs is given, or of the USB device above it."""
    of_node = _record(place, system)
    of_device = _record(_usb_device(f"{place}/device", system), system)
    return "E:ID_MM_PORT_IGNORE=1" in of_node or "E:ID_MM_DEVICE_IGNORE=1" in (*of_node, *of_device)


def _record(place: str | None, system: System) -> list[str]:
    """The lines of udev's database for a device of a number."""
    number = system.read(f"{place}/dev") if place else None
    return (system.read(f"/run/udev/data/c{number}") or "").splitlines() if number else []


def holders(resolved: str, ours: set[int], system: System) -> tuple[tuple[Holder, ...], int]:
    """The processes that have the device open, and how many could not be looked into. `ours`: pids of the service."""
    found = []
    unseen = 0
    for pid, paths in system.open_files():
        unseen += paths is None
        if paths and resolved in paths:
            name = _instance(system.read(f"/proc/{pid}/cmdline") or "")
            found.append(Holder(pid, system.comm(pid), system.unit(pid), pid in ours, name))
    return tuple(found), unseen


def _instance(command_line: str) -> str:
    """The instance that a process of failstop's belongs to, from its arguments; empty for others."""
    words = command_line.split("\0")
    if not any(word.endswith("/supervisor/child.py") for word in words):
        return ""
    return next((word.removeprefix("name=") for word in words if word.startswith("name=")), "")
