"""The table of checks: each a name, and a function that looks and judges."""

from __future__ import annotations

from collections.abc import Callable

from failstop.doctor import fleet, machine, port, service, stop_path
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
    "unit": service.unit,
    "fleet": fleet.fleet,
    "rights": machine.rights,
    "deaths": machine.early_news,
    "shared memory": machine.shared_memory,
    "RemoveIPC": service.remove_ipc,
    "processor": machine.processor,
    "ticks": machine.ticks,
    "stop path": stop_path.stop_path,
}
"""A check may find nothing, one thing, or several."""


def examine(look: Look) -> list[tuple[str, Finding]]:
    """Every finding with its check's name, the most serious first, those of one level in the table's order. All but the
    two self-tests takes less than two seconds."""
    found = [(name, finding) for name, check in CHECKS.items() for finding in check(look)]
    return sorted(found, key=lambda row: -LEVELS.index(row[1].level))
