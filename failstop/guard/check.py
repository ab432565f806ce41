"""The checks of `failstop doctor` about the guard port."""

from __future__ import annotations

from failstop.doctor.look import Finding, Look, ok, warn
from failstop.guard.said import GUARD, path_in


def check(look: Look) -> list[Finding]:
    """Check which program has the guard port open. Warn if a program at this port can't move the wheels because no
    program reports an obstacle sensor."""
    clients = look.state.clients if look.state else ()
    found = [(path_in(client.sees), client) for client in clients if path_in(client.sees)]
    if not found:
        return ok("no guard port is open; you need one only to keep a driver that was written for the bare board")
    path, client = found[0]
    if look.active_settings.on("scan.gate") and look.state and look.state.scan_age_s is None:
        return warn(
            f"no program reports an obstacle sensor, and scan.gate is on, so a driver at {path} can't move the wheels",
            "",
            'set scan.gate = "off" and restart the service, or have a program call Robot.sensed()',
        )
    if client.name == GUARD:
        return ok(f"the guard port is {path}; no driver has it open")
    return ok(f"{client.name} (pid {client.pid}) uses the guard port {path}")
