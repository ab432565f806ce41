"""What the facts of ROS 2 mean. Pure."""

from __future__ import annotations

from failstop.doctor.facts import Facts
from failstop.doctor.finding import Finding, ok, skip, warn


def bridge(facts: Facts) -> list[Finding]:
    """The bridge, and whether it can hear the robot's nodes."""
    found = facts.ros2
    if not found.pid:
        if not found.users:
            return ok("no ROS 2 node runs here")
        text = f"ROS 2 nodes of {', '.join(found.users)} run here (or have left files), and no bridge is connected"
        return skip(text, "sudo failstop install --ros2-user NAME", "NAME: the user of the robot's nodes")
    where = f"the bridge is connected (pid {found.pid}, user {found.user})"
    others = [user for user in found.users if user != found.user]
    if others and found.own_profile:
        text = f"{where}, and Fast DDS of {', '.join(others)} is here: nodes of two users exchange no data"
        advice = "or start the bridge without a Fast DDS profile: then it takes UDP alone"
        return warn(text, f"sudo failstop install --ros2-user {others[0]}", advice)
    return ok(f"{where}{'' if found.own_profile else ', by UDP alone'}")
