"""Facts of the port: the device's file, what is behind it, who may open it, who has it open."""

from __future__ import annotations

import contextlib
import os
import re
import stat
from collections.abc import Iterator

from failstop import discovery
from failstop.doctor.facts import Holder, Node, User
from failstop.doctor.system import System

PSEUDO_MAJORS = range(136, 144)
"""Of the pseudo-terminals (the kernel's list of devices)."""
UNKNOWN = "n/a"
"""pyserial's description of a port without one."""
GONE = re.compile(r"(/dev/tty(?:ACM|USB)\d+) \(deleted\)")
"""As /proc names what a process has open and an unplug has removed."""
GRABBERS = ("ModemManager", "brltty")
USB_DEPTH = 6
"""A serial node is so many directories below its USB device at most."""


def user(uid: int) -> User:
    """Somebody by number, with all groups."""
    import grp
    import pwd

    try:
        found = pwd.getpwuid(uid)
    except KeyError:
        return User(str(uid), uid, frozenset())
    gids = {found.pw_gid, *(group.gr_gid for group in grp.getgrall() if found.pw_name in group.gr_mem)}
    if uid == os.geteuid():
        gids |= {os.getegid(), *os.getgroups()}
    return User(found.pw_name, uid, frozenset(gids))


def account(name: str) -> User | None:
    """Somebody by name; None when there is no such account."""
    import pwd

    try:
        return user(pwd.getpwnam(name).pw_uid)
    except KeyError:
        return None


def node(path: str, system: System) -> Node | None:
    """The device's file; None when it is not there."""
    try:
        found = os.stat(path)
    except OSError:
        return None
    resolved = os.path.realpath(path)
    major, minor = os.major(found.st_rdev), os.minor(found.st_rdev)
    usb_id, product = usb_identity(f"/sys/dev/char/{major}:{minor}/device", system)
    return Node(
        path=path,
        resolved=resolved,
        character=stat.S_ISCHR(found.st_mode),
        pseudo=stat.S_ISCHR(found.st_mode) and major in PSEUDO_MAJORS,
        mode=stat.S_IMODE(found.st_mode),
        uid=found.st_uid,
        gid=found.st_gid,
        group=_group(found.st_gid),
        usb_id=usb_id,
        product=product,
        modem_ignored=modem_ignored(f"/run/udev/data/c{major}:{minor}", system),
        acl=_has_acl(path),
        accessible=os.access(path, os.R_OK | os.W_OK),
        link=link if path != (link := system.path(discovery.LINK)) and os.path.realpath(link) == resolved else "",
    )


def _group(gid: int) -> str:
    import grp

    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)


def _has_acl(path: str) -> bool:
    with contextlib.suppress(OSError):
        return "system.posix_acl_access" in os.listxattr(path)
    return False


def usb_identity(device: str, system: System) -> tuple[str | None, str]:
    """(vendor:product, product's name) of the USB device above a node in sysfs."""
    place = os.path.realpath(system.path(device))
    for _ in range(USB_DEPTH):
        at = "/" + os.path.relpath(place, system.root)
        vendor, product = system.read(f"{at}/idVendor"), system.read(f"{at}/idProduct")
        if vendor and product:
            return f"{vendor}:{product}", system.read(f"{at}/product") or ""
        place = os.path.dirname(place)
    return None, ""


def modem_ignored(record: str, system: System) -> bool | None:
    """What udev's database says of a node; None without a record."""
    text = system.read(record)
    return None if text is None else "E:ID_MM_DEVICE_IGNORE=1" in text.splitlines()


def holders(resolved: str, ours: set[int], system: System) -> tuple[tuple[Holder, ...], int]:
    """The processes that have the device open, and how many could not be looked into. `ours`: pids of the service."""
    found = []
    unseen = 0
    for pid, paths in _open_files(system):
        unseen += paths is None
        if paths and resolved in paths:
            name = _instance(system.read(f"/proc/{pid}/cmdline") or "")
            found.append(Holder(pid, system.comm(pid), system.unit(pid), pid in ours, name))
    return tuple(found), unseen


def unplugged(system: System) -> tuple[Holder, ...]:
    """The processes that have a serial device open which an unplug has removed."""
    return tuple(
        Holder(pid, system.comm(pid), system.unit(pid), gone=gone[1])
        for pid, paths in _open_files(system)
        for path in sorted(paths or ())
        if (gone := GONE.fullmatch(path))
    )


def _open_files(system: System) -> Iterator[tuple[int, set[str] | None]]:
    """The paths of what each other process has open; None where that is hidden from this user."""
    for pid in system.pids():
        if pid == os.getpid():
            continue
        folder = system.path(f"/proc/{pid}/fd")
        try:
            yield pid, {_target(os.path.join(folder, number)) for number in os.listdir(folder)}
        except PermissionError:
            yield pid, None
        except OSError:
            continue


def _instance(command_line: str) -> str:
    """The instance that a process of failstop's belongs to, from its arguments; empty for others."""
    words = command_line.split("\0")
    if not any(word.endswith("/supervisor/child.py") for word in words):
        return ""
    return next((word.removeprefix("name=") for word in words if word.startswith("name=")), "")


def _target(link: str) -> str:
    try:
        return os.readlink(link)
    except OSError:
        return ""


def grabbers(system: System) -> tuple[Holder, ...]:
    """Running programs that open serial ports by themselves."""
    return tuple(Holder(pid, name, system.unit(pid)) for pid in system.pids() if (name := system.comm(pid)) in GRABBERS)


def candidates() -> tuple[tuple[str, str], ...]:
    """Serial devices that are there instead; those that nothing is known of are the PC's own ports, used or not."""
    return tuple((path, what) for path, what in discovery.candidates() if what != UNKNOWN)
