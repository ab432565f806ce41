"""Fleet: lets you watch and stop robots from another computer. It has the metrics for Prometheus, each robot's state on
an MQTT broker, and a stop of the whole fleet.

No stop of a robot depends on the fleet, and the fleet does not stop a robot that loses its connection. Such a stop
would come too late, because a broker notices a lost robot only after seconds.
"""

from __future__ import annotations

from failstop.api.errors import FailstopError


class FleetError(FailstopError):
    """A setting of the fleet, its key or the broker does not work. The message says what to do."""
