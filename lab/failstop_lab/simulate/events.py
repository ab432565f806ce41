"""Events: the kinds of events that a run may draw, and their measures. Each group of kinds is on in some runs."""

from __future__ import annotations

import itertools

from failstop_lab.machine.buffers import EARLY, LATE, REST_OF_PLACE, SAME_PLACE
from failstop_lab.machine.robot import MS
from failstop_lab.simulate.faults import REPORT_FAULTS
from failstop_lab.simulate.witness import SERVICE_PROCESSES

MEASURES = 16
SHORT_NS = [round(1_000 * 10 ** (step * 4 / (MEASURES - 1))) for step in range(MEASURES)]
"""How long a thread pauses: 1 us to 10 ms."""
SEEN_NS = [round(300_000 * 80 ** (step / (MEASURES - 1))) for step in range(MEASURES)]
"""How long it pauses when memory is seen in another order: 0.3 to 24 ms, a tick of every process that looks without a
bell."""
HELD_FOR_NS = [round(20 * MS * 75 ** (step / (MEASURES - 1))) for step in range(MEASURES)]
"""How long a process is held up, or a board gone: 20 ms to 1.5 s."""
PAUSES = "a thread pauses"
LATER = dict(
    zip(
        LATE,
        (
            f"{PAUSES}, its stores are late",
            f"{PAUSES}, its last store is late",
            f"{PAUSES}, its stores but the last are late",
            f"{PAUSES}, the first half of its last store is late",
            f"{PAUSES}, the second half of its last store is late",
            f"{PAUSES}, the first half of its store before the last is late",
            f"{PAUSES}, the second half of its store before the last is late",
        ),
        strict=True,
    )
)
EARLIER = dict(
    zip(
        EARLY,
        (
            f"{PAUSES}, its next loads are older",
            f"{PAUSES}, its next load is older",
            f"{PAUSES}, its next loads but the first are older",
            f"{PAUSES}, the first half of its next load is older",
            f"{PAUSES}, the second half of its next load is older",
            f"{PAUSES}, its next loads of where it looked last are older",
            f"{PAUSES}, its next load and those of that place are older but for the first word",
        ),
        strict=True,
    )
)
RACES = {
    early: f"its store waits until another looks there{text.removeprefix(PAUSES)}"
    for early, text in EARLIER.items()
    if early != SAME_PLACE
}
TORN = EARLIER[REST_OF_PLACE]
LOWERED = "a thread runs behind all others"
REFUSES, KEEPS, BOARD_DEAF, PULLED = (
    "the port refuses",
    "the board takes no bytes",
    "the board hears nothing",
    "the plug is pulled",
)
BESIDE = [f"{name} dies beside{hears}" for name in SERVICE_PROCESSES for hears in ("", ", and a thread hears")]
GROUPS: dict[str, tuple[str, ...]] = {
    "pauses": (PAUSES,),
    "memory": (*LATER.values(), *(each for each in EARLIER.values() if each != TORN)),
    "order": (LOWERED,),
    "held": ("held", "held in the write"),
    "starved": ("starved",),
    "dies": ("dies", "dies in mid-write"),
    "beside": tuple(BESIDE),
    "asked": ("somebody asks for a stop",),
    "sleeps": ("machine sleeps",),
    "cut": ("short write", "short write, while somebody asks for a stop"),
    "refused": ("EAGAIN", "EIO", "ENOSPC", "EMFILE"),
    "port": (REFUSES, KEEPS),
    "board": (BOARD_DEAF, PULLED),
    "races": tuple(RACES.values()),
    "torn": (TORN,),
    "reports": REPORT_FAULTS,
}
MEMORY = ("memory", "races", "torn")
LIGHT = ("pauses", "order", *MEMORY)
DRAWN_EVENTS = tuple(itertools.chain.from_iterable(GROUPS.values()))
"""Recorded decisions have their numbers, so a new kind comes last."""
GROUP_OF = {kind: group for group, kinds in GROUPS.items() for kind in kinds}
