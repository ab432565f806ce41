"""How late the gate's ticks are, from the arrivals of motor frames at the board. Pure.

The commanded direction changes before the ramp has got to the end, so that every tick of the gate writes a frame. The
arrivals, folded at the tick's period, heap up at the tick's phase, and a tick is late by how much the first frame at or
after its place comes later than that. Commands are sent at random distances: their frames have no phase, and one in the
place of a late tick shows that the gate has turned by then, which makes the tick too.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from failstop_lab.sim.client import Event

COMMANDED_NS = 250_000_000
"""For so long after a command every tick has to move; less than the command timeout."""
EARLY_NS = 1_500_000
"""A frame that comes so much before the tick's place is the tick's: the place is an estimate, and one that is too late
must not make a tick that was in time look missing."""
ALIGN_NS = 1_000_000_000

Stretch = tuple[int, list[int]]
"""(end_ns, arrivals): a time in which every tick had to write a frame, from the first arrival to the end."""


def stretches(events: Sequence[Event], commanded_ns: Sequence[int]) -> list[Stretch]:
    """From each first motor frame that moves a wheel to the frame that stops them, or to a pause of the commands."""
    pauses = [(one + COMMANDED_NS, other) for one, other in pairwise(commanded_ns) if other - one > COMMANDED_NS]
    times = [(event.arrival_ns, event.is_motion) for event in events if event.is_motion or event.is_stop]
    # Motion in a pause is neither counted nor a beginning: it is made into a stop.
    times = [(t_ns, moves and not any(begin <= t_ns < end for begin, end in pauses)) for t_ns, moves in times]
    times += [(begin, False) for begin, _ in pauses]
    times += [(commanded_ns[-1], False)] if commanded_ns else []
    found: list[Stretch] = []
    arrivals: list[int] = []
    for t_ns, moves in sorted(times):
        if moves:
            arrivals.append(t_ns)
        elif arrivals:
            found.append((t_ns, arrivals))
            arrivals = []
    return found


def phase_ns(arrivals: Sequence[int], period_ns: int) -> int | None:
    """Where in the period most of the frames arrive; None when they have no phase that stands out."""
    folded = np.array(arrivals, dtype=np.int64) % period_ns
    width_ns = period_ns // 100
    heaps, _ = np.histogram(folded, bins=100, range=(0, period_ns))
    heaps = heaps + np.roll(heaps, -1)
    most = int(np.argmax(heaps))
    if heaps[most] < len(arrivals) / 4:
        return None
    heap = (folded - most * width_ns) % period_ns
    return (most * width_ns + int(np.median(heap[heap < 2 * width_ns]))) % period_ns


def _first_phase_ns(end_ns: int, arrivals: Sequence[int], period_ns: int) -> int | None:
    """The phase of the first time of ALIGN_NS that shows one: where the machine was busy, frames come at any time."""
    for begin_ns in range(arrivals[0], end_ns - ALIGN_NS + 1, ALIGN_NS):
        window = arrivals[bisect_left(arrivals, begin_ns) : bisect_left(arrivals, begin_ns + ALIGN_NS)]
        if window and (found := phase_ns(window, period_ns)) is not None:
            return found
    return None


def lateness_ns(end_ns: int, arrivals: Sequence[int], period_ns: int) -> list[int]:
    """How late each tick of a stretch was; one that never came counts up to the stretch's end. Empty for a stretch that
    is too short to see a phase in.

    A tick later than half a period moves all that follow it: the gate leaves out what it has missed.
    """
    first = _first_phase_ns(end_ns, arrivals, period_ns)
    if first is None:
        return []
    late: list[int] = []
    place_ns = steady_ns = arrivals[0] + (first - arrivals[0]) % period_ns
    while place_ns < end_ns:
        index = bisect_left(arrivals, place_ns - EARLY_NS)
        came_ns = arrivals[index] if index < len(arrivals) else end_ns
        late.append(max(0, came_ns - place_ns))
        place_ns += period_ns
        if late[-1] > period_ns // 2:
            steady_ns = place_ns = max(place_ns, came_ns + period_ns // 2)
        elif place_ns - steady_ns >= ALIGN_NS:
            seen = phase_ns(arrivals[bisect_left(arrivals, steady_ns) : index], period_ns)
            steady_ns = place_ns
            if seen is not None:
                place_ns += (seen - place_ns + period_ns // 2) % period_ns - period_ns // 2
    return late
