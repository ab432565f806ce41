"""What the facts of the port mean. Pure."""

from __future__ import annotations

from failstop.discovery import BOARD_PID, BOARD_VID
from failstop.doctor.facts import NAMED, Facts, Holder, Node, User, again
from failstop.doctor.finding import Finding, fail, ok, skip, warn

BOARD_USB = f"{BOARD_VID:04x}:{BOARD_PID:04x}"
RULE = ("sudo failstop install", "it brings a rule for udev that sees to it")
SERIAL_BY_NAME = ("ls -l /dev/serial/by-id", "the board is one of these: set device.path to it")


def present(facts: Facts) -> list[Finding]:
    """The device's file is there."""
    node = facts.node
    if node is None:
        there = ", ".join(f"{path} ({what})" for path, what in facts.candidates)
        boards = [path for path, what in facts.candidates if BOARD_USB in what]
        text = f"no device {facts.device} ({facts.device_origin}); "
        if boards:
            fix = f"failstop doctor --device {boards[0]}"
            return fail(f"{text}here there is {there}", fix, f"then set device.path to {boards[0]}")
        advice = "plug the board in, and see whether the kernel saw it come"
        text += f"here there is {there}" if there else "there is no USB serial device at all"
        return fail(text, "sudo dmesg | tail", advice)
    if not node.character:
        return fail(f"{facts.device} is no serial port", *SERIAL_BY_NAME)
    if node.link and facts.device_origin != NAMED:
        text = f"{facts.device} ({facts.device_origin}) is the board now; after a replug that number may be another's"
        advice = f"set device.path to {node.link}, which is the same board and stays it, and restart the service"
        return warn(text, "", advice)
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
        text = f"{node.path} is no USB device; the board's port is one of {BOARD_USB}"
        if facts.device_origin == NAMED:
            return skip(text, "", "the stop path says whether the board is behind it")
        return warn(text, f"failstop doctor --device {node.path}", "if it is the board: naming it allows the test")
    if node.usb_id != BOARD_USB:
        text = f"{node.path} is USB {node.usb_id} {node.product}; the board is {BOARD_USB}"
        return fail(text, *SERIAL_BY_NAME)
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
            remedy = _let_in(node, who, "restart the service")
            found += fail(f"the service's user {who.name} may not open it: {whose}", *remedy)
    if node.accessible:
        return [*found, *ok(f"this user ({facts.user.name}) may open it")]
    text = f"this user ({facts.user.name}) may not open it"
    if facts.service and not facts.service.problem:
        return [*found, *skip(f"{text}, and need not: the service has it")]
    return [*found, *(warn if found else fail)(f"{text}: {whose}", *_let_in(node, facts.user, "log in again"))]


def _let_in(node: Node, who: User, then: str) -> tuple[str, str]:
    """How somebody comes to open it; root's group gives more than that."""
    if node.mode & 0o060 == 0o060 and node.gid:
        return f"sudo usermod -aG {node.group} {who.name}", f"then {then}"
    if node.usb_id == BOARD_USB:
        return RULE
    return "", "no group may: it takes a rule for udev that gives it the group dialout and the mode 0660"


def holders(facts: Facts) -> list[Finding]:
    """Nobody but the service has it open."""
    found = [finding for holder in facts.unplugged for finding in _unplugged(holder)]
    if facts.node is None:
        return found
    for name in dict.fromkeys(holder.instance for holder in facts.holders if holder.instance and not holder.ours):
        text = f"the service {name!r} has the port open, and two services can't share a board"
        found += fail(text, f"failstop doctor --name {name}", "this one may be meant; or end it")
    for holder in facts.holders:
        if not (holder.ours or holder.instance):
            text = f"{_who(holder)} has the port open: what it writes goes past every check of failstop"
            found += fail(text, _end(holder))
    if found:
        return found
    ours = sum(holder.ours for holder in facts.holders)
    who = f"only the service has it open ({ours} processes)" if ours else "nobody has it open"
    if facts.unseen_processes:
        text = f"nobody else is seen with it, but {facts.unseen_processes} processes hide their files from this user"
        return warn(text, f"sudo {again(facts)}", "root sees them")
    return ok(who)


def _unplugged(holder: Holder) -> list[Finding]:
    text = f"{_who(holder)} has {holder.gone} open from before an unplug: the board comes back by another number"
    return warn(text, _end(holder))


def _who(holder: Holder) -> str:
    return f"{holder.name} (pid {holder.pid}{f', {holder.unit}' if holder.unit else ''})"


def _end(holder: Holder) -> str:
    return f"sudo systemctl stop {holder.unit}" if holder.unit else f"sudo kill {holder.pid}"


def grabbers(facts: Facts) -> list[Finding]:
    """No program that opens serial ports by itself is near."""
    found = []
    names = {holder.name: holder for holder in facts.grabbers}
    ignored = facts.node.modem_ignored if facts.node else None
    if "ModemManager" in names and not ignored and not (facts.node and facts.node.pseudo):
        text = "ModemManager runs and is not told to leave the port alone: it opens it and writes to the board"
        found += fail(text, *RULE)
    if "brltty" in names:
        found += warn("brltty runs: it takes serial adapters of 1a86 for itself", "sudo apt purge brltty")
    if found:
        return found
    if "ModemManager" in names:
        return ok("ModemManager runs and is told to leave this port alone")
    return ok("neither ModemManager nor brltty runs")
