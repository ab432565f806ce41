"""Shared: what the bridge's two threads tell each other. Every field is replaced as a whole."""

from __future__ import annotations

import dataclasses

from failstop.api.errors import FailstopError
from failstop.api.state import State
from failstop.ros2.mirrors import RobotSettings


@dataclasses.dataclass
class Shared:
    """The thread that publishes writes state, problem, settings, run and failed. Both threads write ending. The thread
    that spins the node writes the other fields."""

    state: State | None = None
    problem: FailstopError = dataclasses.field(default_factory=lambda: FailstopError("the bridge is starting"))
    """Why there is no state."""
    settings: RobotSettings | None = None
    """The settings of the present run. None if they are not known yet."""
    run: str = ""
    """The present run of the service (State.run). Empty before the first run."""
    publishers: tuple[str, ...] = ()
    sees: tuple[str, ...] = ()
    wrong: tuple[str, ...] = ()
    lacks: tuple[str, ...] = ()
    """Services and actions that are not offered, each with the reason."""
    asked: int = 0
    """How many requests that change the service's state were granted."""
    failed: BaseException | None = None
    """The error that has ended the thread that publishes."""
    ending: bool = False
