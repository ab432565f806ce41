"""Words: gives the service's answers exactly the wording of an earlier driver, because tools compare these texts."""

from __future__ import annotations

import os
from collections import deque

from failstop.api.errors import FailstopError, Refused
from failstop.messages import records
from failstop.messages.records import CAUSE, FOR_THE_LATCH
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.ros2.commanders import reason
from failstop.ros2.contract import ARM_ACTION, CLIENT

LATCHED = f"e-stop latched ({CAUSE})"
TOPIC_CAUSE = "estop topic"
SERVICE_CAUSE = "stop service"
NO_ANSWER = reason(causes.ROS_NO_ANSWER, "0.5 s")
ENABLED = "enabled"
DISABLED = "disabled"
HELD = "wheels held: no LiDAR scan for {:.1f} s while commanded"
RELEASED = "LiDAR scan back: wheels released"
_ASKED: deque[Cause] = deque(maxlen=64)


def asked(given: str, row: str = "") -> None:
    """Remember a stop that this bridge requests. `given`: the text of the request. `row`: the kind of its cause. Only
    this memory shows whether the bridge requested a stop, because anyone can use the bridge's name."""
    _ASKED.append(causes.requested(records.asking(given, CLIENT, os.getpid(), row).rstrip()))


def plain(cause: Cause | None) -> str:
    """A cause in words, or "" for None. A stop that this bridge requested has only the earlier driver's words."""
    if cause and cause in _ASKED:
        return causes.bare(cause)
    return str(cause or "")


def refused(error: FailstopError) -> str:
    """The answer to a request that was refused or has failed."""
    if not isinstance(error, Refused):
        return f"refused: {error}"
    template = LATCHED if error.refused_for == FOR_THE_LATCH else error.template
    return f"refused: {template.replace(CAUSE, plain(error.cause))}"


def reset(was: Cause | None) -> str:
    """The answer to a reset. `was`: the cause of the stop that was reset."""
    return f"e-stop cleared (was: {plain(was) or None}); motion still disabled"


def waited(waited_s: float) -> str:
    """Why a message that waited too long for its callback is refused."""
    return f"it waited {waited_s:.3f} s here; is the machine overloaded?"


def ask_again(waited_s: float) -> str:
    """Why a service request is refused that may have waited while the bridge did not run."""
    return f"it may have waited for {waited_s:.3f} s, because the bridge did not run: ask again"


def repaired(late_s: float) -> str:
    """Why a message that took longer than others to arrive is refused."""
    return f"it came {late_s:.3f} s later than others of its publisher; is the network overloaded?"


def unwatched(takes_s: float, most_s: float) -> str:
    """Why a goal from the topic arm/goal is refused because it takes too long."""
    return (
        f"it takes {takes_s:g} s, and nobody can see whether its sender lives: {most_s:g} s at most "
        f"(arm.unwatched_s), or send it to {ARM_ACTION.name}"
    )


def velocity(linear_x: float, linear_y: float, angular_z: float) -> str:
    """A velocity in words."""
    return f"{linear_x:g} m/s forward, {linear_y:g} m/s left, {angular_z:g} rad/s"


def still_commands(who: str, commanded: tuple[float, float, float], timeout_s: float) -> str:
    """Why a reset is refused while a node commands motion, and what to do."""
    return f"{who} commands {velocity(*commanded)}: let it send zero or nothing for {timeout_s:g} s, then reset again"
