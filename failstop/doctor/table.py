"""The table of all checks. Each has a name and a function."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from failstop.doctor import machine, port, protection, service, stop_path
from failstop.doctor.look import LEVELS, Finding, Look

Check = Callable[[Look], list[Finding]]


def _of(home: str) -> Check:
    """The function failstop.HOME.check.check. Its package is imported only when the check runs."""
    return lambda look: list(import_module(f"failstop.{home}").check(look))


CHECKS: dict[str, Check] = {
    "port": port.present,
    "identity": port.identity,
    "permission": port.permission,
    "holders": port.held,
    "grabbers": port.grabbers,
    "console": port.console,
    "commanders": port.commanders,
    "settings": service.settings,
    "protection": protection.protection,
    "service": service.running,
    "scale": service.wheels_scale,
    "clients": service.clients,
    "ROS 2": _of("ros2.check"),
    "guard": _of("guard.check"),
    "unit": service.unit,
    "fleet": _of("fleet.check"),
    "rights": machine.rights,
    "deaths": machine.early_news,
    "shared memory": machine.shared_memory,
    "RemoveIPC": service.remove_ipc,
    "state directory": service.state_directory,
    "processor": machine.processor,
    "ticks": machine.ticks,
    "board": stop_path.board,
    "stop path": stop_path.stop_path,
}
"""All checks in the order in which they run. A check may return no finding, one, or several."""


def examine(look: Look) -> list[tuple[str, Finding]]:
    """Run all checks. Returns (name of the check, finding), the most serious first, and otherwise in the table's order.
    Everything except `ticks` and the test of the stop path takes less than two seconds."""
    found = [(name, finding) for name, check in CHECKS.items() for finding in check(look)]
    return sorted(found, key=lambda row: -LEVELS.index(row[1].level))
