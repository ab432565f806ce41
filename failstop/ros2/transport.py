"""Transport: chooses how Fast DDS sends data, through the environment of the bridge's process. Pure."""

from __future__ import annotations

from pathlib import Path

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping, MutableMapping

PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
IMPLEMENTATIONS = ("", "rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp")
"""The values of RMW_IMPLEMENTATION whose DDS reads these profiles. Empty means the default, which is Fast DDS."""


LOCALHOST_ONLY = "ROS_LOCALHOST_ONLY"
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
"""The variable that limits which computers a node finds, since Jazzy. There, LOCALHOST_ONLY is deprecated, but wins if
it is 1."""
PEERS = "ROS_STATIC_PEERS"
"""The variable with further hosts that a node looks for, besides those in RANGE."""


def own_profile(environment: Mapping[str, str]) -> bool:
    """True if the user has set a Fast DDS profile, which may use shared memory."""
    return any(map(environment.get, PROFILES))


def udp_alone(environment: MutableMapping[str, str]) -> None:
    """Make Fast DDS use UDP instead of its shared memory, unless the user has set a profile.

    Shared memory can make the bridge deaf. After a kill, the next bridge may listen at a port whose file the other
    nodes have just replaced. The bridge then hears none of these nodes.

    Nothing is changed if the user wants localhost and further hosts (PEERS), because no profile can say both. ROS then
    uses shared memory, and `failstop doctor` reports it.
    """
    if environment.get("RMW_IMPLEMENTATION", "") not in IMPLEMENTATIONS or own_profile(environment):
        return
    only = environment.get(LOCALHOST_ONLY) == "1"
    localhost = only or environment.get(RANGE) == "LOCALHOST"
    if localhost and not only and environment.get(PEERS):
        return
    if localhost:
        # ROS's own variables would bring the shared memory back. The profile limits it to localhost instead.
        environment.pop(RANGE, None)
    environment.pop(LOCALHOST_ONLY, None)
    profile = Path(__file__).resolve().parent / f"udp_only{'_localhost' if localhost else ''}.xml"
    environment.update(dict.fromkeys(PROFILES, str(profile)))
