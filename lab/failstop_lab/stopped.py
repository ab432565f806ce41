"""Stopped: what the board saw of a stop after a fault."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from failstop_lab.sim.client import Event
    from failstop_lab.sim.model import Frame


@dataclasses.dataclass(frozen=True)
class Stopped:
    """The board's view of a fault. Times in ns from the fault; None: it never came."""

    fault_ns: int
    stop_ns: int | None
    """To the arrival of the last byte of the first stop frame that the board executed."""
    executed_ns: int | None
    """To its execution: the arrival and the wire's time."""
    still_ns: int | None
    """To the last wheel at zero."""
    motion_after: int
    """Motor frames executed after that stop that moved a wheel."""
    was_turning: bool


def judge(events: Sequence[Event | Frame], fault_ns: int, was_turning: bool) -> Stopped:
    """Judge a fault at `fault_ns` by the board's events."""
    after = [event for event in events if event.is_motor and event.arrival_ns >= fault_ns]
    stop = next((event for event in after if event.is_stop), None)
    if stop is None:
        return Stopped(fault_ns, None, None, None, sum(event.is_motion for event in after), was_turning)
    still = next((event for event in after if not any(event.speeds)), None)
    return Stopped(
        fault_ns,
        stop.arrival_ns - fault_ns,
        stop.executed_ns - fault_ns,
        None if still is None else still.executed_ns - fault_ns,
        sum(event.is_motion for event in after if event.index > stop.index),
        was_turning,
    )
