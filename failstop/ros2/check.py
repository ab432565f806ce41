"""The doctor's check of the ROS 2 bridge."""

from __future__ import annotations

from failstop.doctor.look import Finding, Look, ok, skip, warn
from failstop.doctor.system import SHM
from failstop.ros2.contract import CLIENT

FAST_DDS = ("fastrtps_", "fastdds_")
"""How the names of Fast DDS's files in /dev/shm begin, for its versions 2 and 3. Each process that uses its shared
memory makes such files, and they belong to the process's user (SHM_MANAGER_DOMAIN of SharedMemTransport.cpp)."""

ADVICE = (
    "or start it without a Fast DDS profile of your own, and without ROS_STATIC_PEERS where "
    "ROS_AUTOMATIC_DISCOVERY_RANGE is LOCALHOST: it uses UDP alone then"
)
ROOT = "root can read them"


def check(look: Look) -> list[Finding]:
    """Check whether the bridge can hear the robot's nodes. Two users can't exchange data by Fast DDS's shared memory,
    so the check looks for it in the bridge's memory maps."""
    system = look.system
    pid = next((client.pid for client in look.state.clients if client.name == CLIENT), 0) if look.state else 0
    if not pid:
        return ok("no bridge to ROS 2 is connected")
    user = system.owner(f"/proc/{pid}")
    where = f"the bridge to ROS 2 is connected (pid {pid}{f', user {user}' if user else ''})"
    maps = system.read(f"/proc/{pid}/maps")
    if not maps:
        return skip(
            f"{where}; its memory maps can't be read, so nobody knows whether it uses shared memory", advice=ROOT
        )
    if not any(f"{SHM}/{begin}" in maps for begin in FAST_DDS):
        return ok(f"{where}, without Fast DDS's shared memory")
    owners = {system.owner(f"{SHM}/{name}") for name in system.names(SHM) if name.startswith(FAST_DDS)}
    if others := sorted(owners - {user, ""}):
        text = f"{where}, and Fast DDS of {', '.join(others)} is here: nodes of two users exchange no data"
        units = f"disable --now failstop-ros2@{user} && sudo systemctl enable --now failstop-ros2@{others[0]}"
        return warn(text, f"sudo systemctl {units}", ADVICE)
    return ok(f"{where}, by Fast DDS's shared memory")
