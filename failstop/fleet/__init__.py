"""Fleet: lets you watch and stop robots from another computer. It has the metrics for Prometheus, each robot's state on
an MQTT broker, and a stop of the whole fleet.

A robot's own stops do not depend on the fleet. The fleet does not stop a robot that loses its connection, because a
broker notices a lost connection only after seconds.
"""

from __future__ import annotations

from failstop.api.errors import FailstopError


class FleetError(FailstopError):
    """The fleet can't work: a setting, the fleet's key or the broker is wrong or missing. The message says what to
    do."""
