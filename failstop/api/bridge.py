"""Bridge: the signs of the bridge to ROS 2 that others know: its name as a client, and the variables of Fast DDS."""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping

CLIENT = "ros2"
"""Its name among the clients."""
PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Variables that name a file with a profile of Fast DDS."""


def own_profile(environment: Mapping[str, str]) -> bool:
    """Whether the user has a profile of their own, which may use shared memory."""
    return any(map(environment.get, PROFILES))
