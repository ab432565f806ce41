"""The table of checks: each a name, and a function that looks and judges."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable

from failstop.doctor import machine, port, service, stop_path
from failstop.doctor.look import LEVELS, Finding, Look

CHECKS: dict[str, Callable[[Look], list[Finding]]] = {
    "port": port.present,
    "identity": port.identity,
    "permission": port.permission,
    "holders": port.held,
    "grabbers": port.grabbers,
    "settings": service.settings,
    "service": service.running,
    "clients": service.clients,
    "ROS 2": service.bridge,
    "version": service.version,
    "unit": service.unit,
    "realtime": machine.realtime,
    "memory lock": machine.memory_lock,
    "deaths": machine.early_news,
    "shared memory": machine.shared_memory,
    "leftovers": machine.left,
    "RemoveIPC": service.remove_ipc,
    "processor": machine.processor,
    "idle": machine.idle,
    "ticks": machine.ticks,
    "stop path": stop_path.stop_path,
}
"""A check may find nothing, one thing, or several."""
_OWN = re.compile(r"(?<![\w/.'@-])failstop (?=[a-z-]+)")


def examine(look: Look) -> list[tuple[str, Finding]]:
    """Every finding with its check's name, the most serious first, those of one level in the table's order; commands
    are such as the user who asks can paste. All but the two self-tests takes less than two seconds."""
    root = look.user.uid == 0
    found = [
        (name, dataclasses.replace(finding, fix=pasteable(finding.fix, look.command, root=root)))
        for name, check in CHECKS.items()
        for finding in check(look)
    ]
    return sorted(found, key=lambda row: -LEVELS.index(row[1].level))


def pasteable(fix: str, command: str, *, root: bool) -> str:
    """A command that says `failstop` and `sudo`, with the program called as it is here, and for root without sudo."""
    given = fix.replace("sudo ", "") if root else fix
    return _OWN.sub(f"{command} ", given)
