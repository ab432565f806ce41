"""Fleet: lets you watch and stop robots from another computer. It has the metrics for Prometheus, each robot's state on
an MQTT broker, and a stop of the whole fleet.

A robot's own stops do not depend on the fleet. The fleet does not stop a robot whose connection is lost. A stop for
that reason would come too late, because a broker notices a lost connection only after seconds.
"""

from __future__ import annotations

from failstop.api.errors import FailstopError


class FleetError(FailstopError):
    """Something that the fleet needs does not work: a setting, the fleet's key, or the broker. The message says what to
    do."""
