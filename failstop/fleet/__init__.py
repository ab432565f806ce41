"""Fleet: watch and stop robots from another computer. It has the metrics, each robot's state on a broker, and a stop of
the whole fleet.

Nothing here is on the stop path, and nothing here stops a robot that has lost its connection: a broker reports a lost
robot only after seconds.
"""

from __future__ import annotations

from failstop.api.errors import FailstopError


class FleetError(FailstopError):
    """A setting of the fleet, a key or the broker does not work; the message says what to do."""
