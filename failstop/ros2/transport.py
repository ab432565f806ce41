"""Transport: which way Fast DDS takes, by the environment of the bridge's process. Pure."""

from __future__ import annotations

from pathlib import Path

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping, MutableMapping

PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
IMPLEMENTATIONS = ("", "rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp")
"""The RMW_IMPLEMENTATION that reads these profiles."""


LOCALHOST_ONLY = "ROS_LOCALHOST_ONLY"
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
"""Since Jazzy; LOCALHOST_ONLY is deprecated there, and wins where it is 1."""
PEERS = "ROS_STATIC_PEERS"
"""Hosts that a node looks for beyond RANGE."""


def own_profile(environment: Mapping[str, str]) -> bool:
    """Whether the user has a profile of their own, which may use shared memory."""
    return any(map(environment.get, PROFILES))


def udp_alone(environment: MutableMapping[str, str]) -> None:
    """Make Fast DDS use UDP without its shared memory, unless the user has a profile of their own.

    By shared memory, after a kill, the next bridge may listen at a port whose file the other nodes have just replaced,
    and then it hears none of them.

    For localhost and further hosts (PEERS) nothing is changed: no profile says both, and ROS's own way of it brings the
    shared memory along, which `failstop doctor` then sees."""
    if environment.get("RMW_IMPLEMENTATION", "") not in IMPLEMENTATIONS or own_profile(environment):
        return
    only = environment.get(LOCALHOST_ONLY) == "1"
    localhost = only or environment.get(RANGE) == "LOCALHOST"
    if localhost and not only and environment.get(PEERS):
        return
    if localhost:
        # ROS's own variables for it would bring the shared memory back: the profile does the same.
        environment.pop(RANGE, None)
    environment.pop(LOCALHOST_ONLY, None)
    profile = Path(__file__).resolve().parent / f"udp_only{'_localhost' if localhost else ''}.xml"
    environment.update(dict.fromkeys(PROFILES, str(profile)))
