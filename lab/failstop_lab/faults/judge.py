"""The judge: what the board's own events say of a fault. It asks the code under test nothing."""

from __future__ import annotations

from failstop_lab.faults.fault import BY_ITSELF, Fault
from failstop_lab.sim.client import Event
from failstop_lab.trial import Stopped, judge


def verdict(fault: Fault, events: list[Event], fault_ns: int, was_turning: bool) -> tuple[Stopped, list[str]]:
    """The verdict: the stop, and everything that must not have happened. `events` reach from before the fault up to the
    next enable (for a fault that clears by itself: up to its end), the clients commanding all the while."""
    stopped = judge(events, fault_ns, was_turning)
    wrong = []
    if not was_turning:
        wrong.append("the wheels were not turning before the fault")
    if fault.limit_ms is None:
        if stopped.stop_ns is not None:
            wrong.append(f"stopped after {stopped.stop_ns / 1e6:.1f} ms, and nothing was to stop")
    elif stopped.stop_ns is None:
        wrong.append("NO STOP")
    else:
        if stopped.stop_ns > fault.limit_ms * 1e6:
            wrong.append(f"stopped after {stopped.stop_ns / 1e6:.1f} ms, the limit is {fault.limit_ms:.0f} ms")
        if stopped.motion_after:
            until = "the fault's end" if fault.cleared == BY_ITSELF else "any enable"
            wrong.append(f"{stopped.motion_after} motion frames after the stop and before {until}")
    if wild := sum(len(event.wild) for event in events):
        wrong.append(f"{wild} writes outside the board's motor table")
    return stopped, wrong
