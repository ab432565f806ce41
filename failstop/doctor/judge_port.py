"""What the facts of the port mean. Pure."""

from __future__ import annotations

from failstop.board.discovery import BOARD_PID, BOARD_VID
from failstop.doctor.facts import Facts, Node, User
from failstop.doctor.finding import Finding, fail, ok, warn

BOARD_USB = f"{BOARD_VID:04x}:{BOARD_PID:04x}"
RELOAD = "sudo udevadm control --reload && sudo udevadm trigger"
RULE = f"sudo failstop install, or install systemd/failstop.udev and run {RELOAD}"


def present(facts: Facts) -> list[Finding]:
    """The device's file is there."""
    node = facts.node
    if node is None:
        there = ", ".join(f"{path} ({what})" for path, what in facts.candidates)
        boards = [path for path, what in facts.candidates if BOARD_USB in what]
        fix = f"failstop doctor --device {boards[0]}" if boards else "plug the board in"
        return fail(f"no device {facts.device} ({facts.device_origin}); here there is {there or 'no serial port'}", fix)
    if not node.character:
        return fail(
            f"{facts.device} is no serial port",
            "failstop doctor --device /dev/serial/by-id/..., then set device.path to that",
        )
    behind = "" if node.resolved == node.path else f", which is {node.resolved}"
    return ok(f"{facts.device}{behind} ({facts.device_origin})")


def identity(facts: Facts) -> list[Finding]:
    """The board is behind it."""
    node = facts.node
    if node is None or not node.character:
        return []
    if node.pseudo:
        return ok("a pseudo-terminal: a simulated board, or a program between the board and failstop")
    if node.usb_id is None:
        return warn(
            f"{node.path} is no USB device; the board's port is one of {BOARD_USB}",
            f"failstop doctor --device {node.path}, if it is the board",
        )
    if node.usb_id != BOARD_USB:
        text = f"{node.path} is USB {node.usb_id} {node.product}; the board is {BOARD_USB}"
        return fail(text, "failstop doctor --device /dev/serial/by-id/..., then set device.path to that")
    return ok(f"USB {node.usb_id} {node.product}, the board's")


def may_open(node: Node, user: User) -> bool:
    """By owner, group and mode alone."""
    if user.uid == 0:
        return True
    if node.uid == user.uid:
        return node.mode & 0o600 == 0o600
    if node.gid in user.gids:
        return node.mode & 0o060 == 0o060
    return node.mode & 0o006 == 0o006


def permission(facts: Facts) -> list[Finding]:
    """This user and the service's may open it."""
    node = facts.node
    if node is None or not node.character:
        return []
    found = []
    whose = f"{node.path} is of the group {node.group}, mode {node.mode:04o}"
    if facts.service_user:
        who = facts.service_user
        if may_open(node, who):
            found += ok(f"the service's user {who.name} may open it")
        elif node.acl:
            found += warn(f"the mode keeps the service's user {who.name} out; the ACL may not", f"getfacl {node.path}")
        else:
            fix = f"sudo usermod -aG {node.group} {who.name}" if node.mode & 0o060 == 0o060 else RULE
            found += fail(f"the service's user {who.name} may not open it: {whose}", fix)
    if node.accessible:
        return [*found, *ok(f"this user ({facts.user.name}) may open it")]
    fix = f"sudo usermod -aG {node.group} {facts.user.name}, then log in again"
    text = f"this user ({facts.user.name}) may not open it: {whose}"
    return [*found, *(warn(text, fix) if found or facts.service else fail(text, fix))]


def holders(facts: Facts) -> list[Finding]:
    """Nobody but the service has it open."""
    if facts.node is None:
        return []
    found = []
    for holder in facts.holders:
        if not holder.ours:
            fix = f"sudo systemctl stop {holder.unit}" if holder.unit else f"sudo kill {holder.pid}"
            text = f"{holder.name} (pid {holder.pid}{f', {holder.unit}' if holder.unit else ''}) has the port open"
            found += fail(f"{text}: what it writes goes past every check of failstop", fix)
    if found:
        return found
    ours = sum(holder.ours for holder in facts.holders)
    who = f"only the service has it open ({ours} processes)" if ours else "nobody has it open"
    if facts.unseen_processes:
        text = f"nobody else is seen with it, but {facts.unseen_processes} processes hide their files from this user"
        return warn(text, "sudo failstop doctor")
    return ok(who)


def grabbers(facts: Facts) -> list[Finding]:
    """No program that opens serial ports by itself is near."""
    found = []
    names = {holder.name: holder for holder in facts.grabbers}
    ignored = facts.node.modem_ignored if facts.node else None
    if "ModemManager" in names and not ignored and not (facts.node and facts.node.pseudo):
        text = "ModemManager runs and is not told to leave the port alone: it opens it and writes to the board"
        found += fail(text, RULE)
    if "brltty" in names:
        found += warn("brltty runs: it takes serial adapters of 1a86 for itself", "sudo apt purge brltty")
    if found:
        return found
    if "ModemManager" in names:
        return ok("ModemManager runs and is told to leave this port alone")
    return ok("neither ModemManager nor brltty runs")
