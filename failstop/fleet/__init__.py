"""Fleet: robots seen and stopped from afar: metrics, the robot's state on a broker, and a stop of the whole fleet.

Nothing here is on the stop path, and nothing here is a deadman: a broker tells of a lost robot after seconds.
"""

from __future__ import annotations

from failstop.api.errors import FailstopError


class FleetError(FailstopError):
    """A setting of the fleet, a key or a broker is not as it should be; the message names the remedy."""
