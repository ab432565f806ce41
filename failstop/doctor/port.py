"""The checks of the port: whether it exists, what is connected to it, who may open it, and who has it open."""

from __future__ import annotations

import os
import re

from failstop.board.asking import ADAPTERS, DRIVERS
from failstop.board.kinds import board_of
from failstop.board.wire import Commander
from failstop.doctor.look import Finding, Look, fail, ok, skip, warn
from failstop.doctor.service import unit_user
from failstop.doctor.system import Holder, Node, System
from failstop.instances import unit_of
from failstop.policy.layouts import BOARDS

RULE = ("", "the Debian package has a udev rule for this (docs/install.md; without dpkg: docs/service.md)")
USE = 0o6
"""The rights that opening the port needs: read and write."""
LEFT_ALONE = "ModemManager is running, but a rule tells it to leave this port alone"
BRLTTY = "brltty"
LINK = "/dev/failstop"
"""The board's name from the udev rule of the Debian package. This name stays the same when the board is plugged in
again, while the port's number may change."""
BY_ID = "/dev/serial/by-id/"
NUMBERED = ("/dev/ttyACM", "/dev/ttyUSB")
SERIAL_BY_NAME = ("ls -l /dev/serial/by-id", "the board is one of these: set device.path to it")
BY_PATH = "ls -l /dev/serial/by-path"
NAME_BY_PATH = (
    "set device.path to the board's name in that folder, which depends only on its USB socket, and restart the service"
)
NO_DESCRIPTION = "n/a"
"""pyserial's description of a port that has none. It is a built-in port of a PC, which may be unused."""
GONE = re.compile(r"(/dev/tty(?:ACM|USB)\d+) \(deleted\)")
"""How /proc shows an open port that was unplugged meanwhile."""
HIDDEN = "this user can't see the processes of other users (/proc is mounted with hidepid)"


def _as_root(look: Look) -> tuple[str, str]:
    """How to repeat the check as root. Returns (a command, what else to know)."""
    return f'sudo "$(command -v failstop)" {look.again()}', "root can check them all"


def present(look: Look) -> list[Finding]:
    """Check whether the port exists, and whether its name always leads to the board."""
    node, (device, origin) = look.node, look.device
    if node is None and os.path.exists(device):
        return fail(f"{device} is not a serial port", *SERIAL_BY_NAME)
    if node is None:
        own = look.board.usb
        candidates = [(path, what) for path, what in look.system.ports(own) if what != NO_DESCRIPTION]
        there = "found: " + ", ".join(f"{path} ({what})" for path, what in candidates)
        text = f"no device {device} ({origin}); {there if candidates else 'no USB serial device is plugged in'}"
        if not candidates and (found := taken(look.system)):
            return fail(f"no device {device} ({origin}); {found[0].text}", found[0].fix, found[0].advice)
        boards = [path for path, what in candidates if any(usb in what for usb in own)]
        if len(boards) > 1:
            return fail(text, BY_PATH, f"{' and '.join(boards)} have the board's USB chip: {NAME_BY_PATH}")
        if boards:
            return fail(text, f"failstop doctor --device {boards[0]}", f"then set device.path to {boards[0]}")
        return fail(text, "sudo dmesg | tail", "plug the board in, and look whether the kernel reports it")
    shared = device == LINK or device.startswith(NUMBERED) or (look.twins and device.startswith(BY_ID))
    if shared and look.look_alikes and not look.device_path:
        others = " and ".join(look.look_alikes)
        text = (
            f"{device} ({origin}) may be the board or {others}: both have the same USB chip, and a reset may swap "
            "their names"
        )
        return warn(text, BY_PATH, NAME_BY_PATH)
    if not look.device_path and device != LINK and os.path.realpath(look.system.path(LINK)) == node.resolved:
        text = f"{device} ({origin}) is the board now, but after a replug another device may get that number"
        advice = f"set device.path to {LINK}, which always names the board, and restart the service"
        return warn(text, "", advice)
    behind = "" if node.resolved == node.path else f", which is {node.resolved}"
    return ok(f"{device}{behind} ({origin})")


def taken(system: System) -> list[Finding]:
    """Check for a board that is plugged in but has no serial port. Then brltty has taken it, or its driver is not
    loaded."""
    chips = {**{usb: "a board's own port" for kind in BOARDS for usb in board_of(kind, 1.0, 0.0).usb}, **ADAPTERS}
    for usb in system.portless(chips):
        what = f"USB {usb} ({chips[usb]}) is plugged in but has no serial port"
        if BRLTTY in _running(system):
            text = f"{what}, because brltty took it for a braille display"
            return fail(text, "sudo apt purge brltty", "then unplug the board and plug it in again")
        module = next((module for chip, module in DRIVERS.items() if chips[usb].startswith(chip)), "cdc_acm")
        advice = "if modprobe finds no such module, this kernel was built without the driver for this chip"
        if system.hides_processes():
            advice += f"; or brltty has taken it for a braille display (`sudo apt purge {BRLTTY}`), but {HIDDEN}"
        return fail(f"{what}, because no driver has taken it", f"sudo modprobe {module}", advice)
    return []


def _running(system: System) -> set[str | None]:
    """The names of all running processes."""
    return {system.read(f"/proc/{pid}/comm") for pid in system.names("/proc")}


def identity(look: Look) -> list[Finding]:
    """Check whether the device at the port can be the board, by its USB id."""
    node, usb, kind, board = look.node, look.usb_id, look.kind, look.board
    if node is None:
        return []
    if node.pseudo:
        return ok("a pseudo-terminal: a simulated board, or a program between the board and failstop")
    if usb in board.usb:
        return ok(f"USB {usb}, as the board has it")
    if board.usb_alone and not usb:
        text = f"{node.path} is not a USB device, but the board's port has a USB id: {', '.join(board.usb)}"
        return skip(
            text,
            f"failstop doctor --device {node.path}",
            "if it is the board, name it like this, and the stop is tested too",
        )
    if board.usb_alone:
        return fail(f"{node.path} is USB {usb}; the board is {', '.join(board.usb)}", *SERIAL_BY_NAME)
    if chip := ADAPTERS.get(usb):
        return ok(f"USB {usb}, a {chip} chip: many devices have one, so it doesn't tell which board this is")
    if usb and (other := next((each for each in BOARDS if usb in board_of(each, 1.0, 0.0).usb), None)):
        return warn(
            f"{node.path} is USB {usb}, which is a board of the kind {other}, but board.kind is {kind}", *SERIAL_BY_NAME
        )
    return ok(f"{f'USB {usb}' if usb else 'no USB device'}; a board of the kind {kind} may be at any port")


def permission(look: Look) -> list[Finding]:
    """Check whether the service may open the port: the user of its systemd unit, or without a unit this user. With a
    running service, report the state of the service's port instead."""
    user = unit_user(look)
    if look.node is None or look.state or not look.unit or (uid := look.system.account(user)) < 0:
        return accessible(look)
    if look.system.barrier(look.node.path, uid, USE, look.unit.get("SupplementaryGroups", "").split()):
        return _refused(look.node, user, "then start the service")
    return ok(f"{user}, the user of {unit_of(look.name)}, may open it")


def accessible(look: Look) -> list[Finding]:
    """Check whether this user may open the port. With a running service, report the state of the service's port
    instead."""
    node, who = look.node, look.system.owner("/proc/self")
    if node is None:
        return []
    if look.state:
        return ok(f"the running service opens the port; it is {look.state.device.state}")
    return ok(f"{who} may open it") if node.accessible else _refused(node, who, "then log out and in again")


def _refused(node: Node, who: str, then: str) -> list[Finding]:
    text = f"user {who} may not open {node.path}, which belongs to the group {node.group}"
    # Membership in root's group would give the user far more than this port.
    if node.group == "root" or not node.by_group:
        return fail(text, *RULE)
    return fail(text, f"sudo usermod -aG {node.group} {who}", then)


def held(look: Look) -> list[Finding]:
    """Check whether another program has the port open."""
    found = []
    for pid, paths in look.system.open_files():
        for gone in filter(None, map(GONE.fullmatch, sorted(paths or ()))):
            holder = look.system.holder(pid)
            what = "open since before it was unplugged, so the board gets another number when it comes back"
            found += warn(f"{holder} has {gone[1]} {what}", holder.end())
    if look.node is None:
        return found
    holders, unseen = look.holders
    ours = {row.pid for row in look.state.processes.values()} if look.state else set()
    if look.service[-1]:
        # The service is running, but its state can't be read. So its processes are known only by its name.
        ours |= {holder.pid for holder in holders if holder.instance == look.name}
    # A login has its own check (console), which shows the command that ends it for good.
    others = [holder for holder in holders if holder.pid not in ours and not holder.is_login]
    for name in dict.fromkeys(holder.instance for holder in others if holder.instance):
        text = f"the service {name!r} has the port open, and two services can't share a board"
        found += fail(text, f"failstop doctor --name {name}", "perhaps you mean that service; if not, end it")
    for holder in others:
        if not holder.instance:
            text = f"{holder} has the port open, and failstop checks nothing that it writes"
            known = _known(look, holder)
            found += fail(text, known.fix or holder.end(), known.remedy) if known else fail(text, holder.end())
    hidden = look.system.hides_processes()
    if (unseen or hidden) and not found:
        why = HIDDEN if hidden else f"{unseen} processes couldn't be checked as this user"
        return warn(f"no other program seems to have it open, but {why}", *_as_root(look))
    holders = tuple(holder for holder in holders if not holder.is_login)
    return found or ok("only the service has it open" if holders else "no program has it open")


def talkers(system: System, path: str) -> list[Finding]:
    """Check whether a login or the kernel's own messages use this port. Both write to the board, and a login also reads
    its answers."""
    name, real = os.path.basename(path), os.path.basename(os.path.realpath(path))
    words = (system.read("/proc/cmdline") or "").split()
    found: list[Finding] = []
    # The baud rate may follow after a comma.
    if any(word.partition(",")[0] in (f"console={name}", f"console={real}") for word in words):
        advice = "or remove that console= from cmdline.txt; then reboot"
        found += fail(f"the kernel writes its messages to {path}", "sudo raspi-config nonint do_serial_cons 1", advice)
    unit = f"serial-getty@{real}.service"
    if (system.said("systemctl", "is-active", unit) or "").strip() == "active":
        return [*found, *fail(f"a login waits on {path}", f"sudo systemctl disable --now {unit}")]
    logins = (holder for holder in system.every() if holder.is_login and {name, real} & holder.files)
    if login := next(logins, None):
        text = f"a login waits on {path}: {login}"
        found += fail(text, f"sudo systemctl disable --now {login.unit}" if login.unit else login.end())
    return found


def console(look: Look) -> list[Finding]:
    """Check whether a login or the kernel uses the board's port."""
    if look.node is None or look.node.pseudo:
        return []
    if found := talkers(look.system, look.node.path):
        return found
    if look.system.hides_processes():
        return skip(f"the kernel writes no messages to it; whether a login waits on it: {HIDDEN}", *_as_root(look))
    return ok("no login waits on it, and the kernel writes no messages to it")


def commanders(look: Look) -> list[Finding]:
    """Check whether anything but failstop could drive this board."""
    found = [row for one in look.board.commanders if not one.program for row in warn(one.who, "", one.remedy)]
    for holder in look.system.every():
        if known := _known(look, holder):
            found += warn(f"{holder} runs: {known.who}", known.fix or holder.end(), known.remedy)
    if any(one.program for one in look.board.commanders) and look.system.hides_processes():
        found += skip(f"whether a program that drives this board is running: {HIDDEN}", *_as_root(look))
    return found or ok("failstop knows of nothing else here that could drive this board")


def _known(look: Look, holder: Holder) -> Commander | None:
    """The board's entry for the program that this process runs. None if the board has no such entry."""
    programs = (one for one in look.board.commanders if one.program)
    return next((one for one in programs if one.program in holder.command), None)


def grabbers(look: Look) -> list[Finding]:
    """Check whether ModemManager or brltty is running. Both open serial ports by themselves."""
    found = []
    names = _running(look.system)
    left_alone = look.node and (look.node.modem_ignored or look.node.pseudo)
    if "ModemManager" in names and not left_alone:
        text = "ModemManager is running and may open the port and write to the board, because no rule tells it not to"
        ours = look.usb_id in ADAPTERS or look.usb_id in look.board.usb
        found += fail(text, *(RULE if ours or look.node is None else ("sudo systemctl disable --now ModemManager", "")))
    if BRLTTY in names:
        text = (
            "brltty is running: it takes USB serial adapters (CH340, CP210x, FTDI) for braille displays, so "
            "their port disappears"
        )
        found += warn(text, "sudo apt purge brltty")
    unseen = [name for name in ("ModemManager", BRLTTY) if name not in names and (name == BRLTTY or not left_alone)]
    if unseen and look.system.hides_processes():
        found += skip(f"whether {' or '.join(unseen)} is running: {HIDDEN}", *_as_root(look))
    return found or ok(LEFT_ALONE if "ModemManager" in names else "neither ModemManager nor brltty is running")
