"""Words: the service's answers in those of the driver before it, to the letter, which tools compare. Pure."""

from __future__ import annotations

import re

from failstop.ros2.contract import CLIENT
from failstop.shm.records import REQUESTED

TOPIC_CAUSE = "estop topic"
SERVICE_CAUSE = "stop service"
NO_ANSWER = "no answer from the gate in 0.5 s: wheels stopped"
ENABLED = "enabled"
DISABLED = "disabled"
HELD = "wheels held: no LiDAR scan for {:.1f} s while commanded"
RELEASED = "LiDAR scan back: wheels released"
_OWN = re.compile(rf"{REQUESTED}: (.*) \({re.escape(CLIENT)}, pid \d+\)")
NOTHING_LATCHED = "no e-stop is latched"


def plain(text: str) -> str:
    """A reason of the bridge's own without what the service adds to every request."""
    return _OWN.sub(r"\1", text)


def refused(text: str) -> str:
    """The answer to what the service did not do."""
    return f"refused: {plain(text)}"


def reset(text: str) -> str:
    """The answer to a reset that was done."""
    if text == NOTHING_LATCHED:
        return "e-stop cleared (was: None); motion still disabled"
    return plain(text)


def velocity(linear_x: float, linear_y: float, angular_z: float) -> str:
    """A command as people read it."""
    return f"{linear_x:g} m/s forward, {linear_y:g} m/s left, {angular_z:g} rad/s"
