"""Facts of ROS 2: whose nodes run here, and whose the bridge is."""

from __future__ import annotations

import os

from failstop.doctor.facts import Ros2, Service
from failstop.doctor.system import System, user_name
from failstop.ros2 import transport

SHM = "/dev/shm"
BRIDGE = "ros2"
"""Its name among the clients."""
FILES = "fastrtps_"
"""What every process with Fast DDS has there, of the user that it runs as."""


def ros2(service: Service | None, system: System) -> Ros2:
    """What is seen of it; `service` tells of the bridge."""
    owners = set()
    for name in system.names(SHM):
        if name.startswith(FILES) and (uid := _owner(system.path(f"{SHM}/{name}"))) is not None:
            owners.add(user_name(uid))
    clients = service.state.clients if service and service.state else ()
    pid = next((client.pid for client in clients if client.name == BRIDGE), 0)
    uid = _owner(system.path(f"/proc/{pid}")) if pid else None
    given = (system.read(f"/proc/{pid}/environ") or "").split("\0") if pid else []
    own_profile = transport.own_profile(dict(word.split("=", 1) for word in given if "=" in word))
    return Ros2(tuple(sorted(owners)), pid, "" if uid is None else user_name(uid), own_profile)


def _owner(path: str) -> int | None:
    try:
        return os.stat(path).st_uid
    except OSError:
        return None
