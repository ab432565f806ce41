"""Shared: what the bridge's two threads know of each other; each field has one writer, who replaces it whole."""

from __future__ import annotations

import dataclasses

from failstop.api.state import State
from failstop.ros2.mirrors import RobotSettings


@dataclasses.dataclass
class Shared:
    """Written by the thread that publishes: state, problem, settings, run, failed; by the one that listens: the
    rest."""

    state: State | None = None
    problem: str = "the bridge is starting"
    """Why there is no state."""
    settings: RobotSettings | None = None
    """The settings of the present run. None: not known yet."""
    run: int = 0
    """The run of the service: the pid of its supervisor; 0: none was seen yet."""
    publishers: tuple[str, ...] = ()
    sees: tuple[str, ...] = ()
    wrong: tuple[str, ...] = ()
    lacks: tuple[str, ...] = ()
    """Services that are not offered, and why."""
    asked: int = 0
    """How often something was asked of the service that changes its state."""
    failed: BaseException | None = None
    """The error that has ended the thread that publishes."""
    ending: bool = False
