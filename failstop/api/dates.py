"""Dates: after the wall clock was set, the times of day of older stops and events are wrong. A small computer without a
battery for its clock boots with an old date, for example, until it gets the time from the network. The time since boot
(CLOCK_MONOTONIC) shows when they really happened. Pure, except for now()."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from typing import NamedTuple

from failstop.api import words
from failstop.api.events import Event
from failstop.api.snapshot import State


class Now(NamedTuple):
    """This computer's clocks at one moment."""

    unix_s: float
    """The wall clock (Unix time, s)."""
    ns: int
    """CLOCK_MONOTONIC, ns."""
    slept_s: float = 0.0
    """How long the computer has slept since it was booted, s. CLOCK_MONOTONIC does not count while it sleeps."""


def now() -> Now:
    """Read the clocks."""
    ns = time.monotonic_ns()
    return Now(time.time(), ns, (time.clock_gettime_ns(time.CLOCK_BOOTTIME) - ns) / 1e9)


def date(t: float, ns: int, at: Now) -> float:
    """When something happened, by the present wall clock (Unix time, s). `t` and `ns`: when it happened, by the wall
    clock of that time and by CLOCK_MONOTONIC since the same boot. Returns `t` unless the clock was set since. If the
    clock went forward by no more than the computer has slept, it was not set."""
    age_s = (at.ns - ns) / 1e9
    jumped_s = words.clock_jump(at.unix_s - t, age_s)
    if not jumped_s or 0 < jumped_s <= at.slept_s + words.JUMP_S:
        return t
    return round(at.unix_s - age_s, 1)


def dated(state: State, events: Sequence[Event], at: Now) -> tuple[State, list[Event]]:
    """Return the state and the events of a running service, with the times of the last stop and of the events by the
    present wall clock."""
    if stop := state.last_stop:
        state = dataclasses.replace(state, last_stop=dataclasses.replace(stop, t=date(stop.t, stop.noticed_ns, at)))
    return state, [dataclasses.replace(event, t=date(event.t, event.ns, at)) for event in events]
