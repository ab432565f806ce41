"""Transport: which way Fast DDS takes, by the environment of the bridge's process. Pure."""

from __future__ import annotations

from pathlib import Path

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping, MutableMapping

PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
IMPLEMENTATIONS = ("", "rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp")
"""The RMW_IMPLEMENTATION that reads these profiles."""


def own_profile(environment: Mapping[str, str]) -> bool:
    """Whether the user has a profile of their own, which may use shared memory."""
    return any(map(environment.get, PROFILES))


def udp_alone(environment: MutableMapping[str, str]) -> None:
    """Have Fast DDS leave its shared memory out, unless there is a profile of the user's own: after a kill the next
    bridge may listen at a port whose file the other nodes have just replaced, and then it hears none of them."""
    if environment.get("RMW_IMPLEMENTATION", "") not in IMPLEMENTATIONS or own_profile(environment):
        return
    # ROS's own variable for it would bring the shared memory back.
    localhost = environment.pop("ROS_LOCALHOST_ONLY", "0") == "1"
    profile = Path(__file__).resolve().parent / f"udp_only{'_localhost' if localhost else ''}.xml"
    environment.update(dict.fromkeys(PROFILES, str(profile)))
