"""Check: what `failstop doctor` says of the bridge."""

from __future__ import annotations

from failstop.doctor.look import Finding, Look, ok, warn
from failstop.doctor.system import SHM
from failstop.ros2 import transport
from failstop.ros2.contract import CLIENT

FAST_DDS = "fastrtps_"
"""The begin of the files that each process with Fast DDS has in /dev/shm, of its user."""


def check(look: Look) -> list[Finding]:
    """The bridge to ROS 2, and whether it can hear the robot's nodes: with a Fast DDS profile of the user's own it may
    use shared memory, which the nodes of two users do not share."""
    system = look.system
    pid = next((client.pid for client in look.state.clients if client.name == CLIENT), 0) if look.state else 0
    if not pid:
        return ok("no bridge to ROS 2 is connected")
    user = system.owner(f"/proc/{pid}")
    where = f"the bridge to ROS 2 is connected (pid {pid}, user {user})"
    given = (system.read(f"/proc/{pid}/environ") or "").split("\0")
    if not transport.own_profile(dict(word.split("=", 1) for word in given if "=" in word)):
        return ok(f"{where}, by UDP alone")
    owners = {system.owner(f"{SHM}/{name}") for name in system.names(SHM) if name.startswith(FAST_DDS)}
    if others := sorted(owners - {user, ""}):
        text = f"{where}, and Fast DDS of {', '.join(others)} is here: nodes of two users exchange no data"
        units = f"disable --now failstop-ros2@{user} && sudo systemctl enable --now failstop-ros2@{others[0]}"
        return warn(text, f"sudo systemctl {units}", "or start it without a Fast DDS profile: it takes UDP alone then")
    return ok(where)
