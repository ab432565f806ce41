"""A USB adapter that stalls from the moment of a kill, then passes on everything it kept in one lump. A board that
drops stops which touch must still get one that stands alone, from the processes that are left."""

from __future__ import annotations

import random

import pytest

from failstop.messages.layout import PROCESS_NAMES
from failstop.policy.layouts import BOARDS
from failstop_lab.boards.line import CROWD_BAR_NS
from tests.support.amounts import amount
from tests.support.simulated import FORWARD, MS, Simulated

pytestmark = pytest.mark.slow
LONGEST_MS = 300
GAP_MS = 60
"""Lone stops come this close together behind a stall, and a board's own feedback may take one of them."""


def lost(simulated: Simulated, rng: random.Random, name: str, stall_ms: float, *, seen: bool) -> bool:
    """Kill a process while the robot drives and its port stalls; True if the wheels are still told to turn afterwards.
    `seen`: the kernel knows that the bytes are held (TIOCOUTQ)."""
    simulated.enable()
    simulated.drive(0.1 + rng.random() / 20)
    assert simulated.turning()
    port, pid = simulated.lab.board.port, simulated.pids()[name]
    assert port
    if seen:
        port.drains = False
        simulated.lab.machine.at(simulated.now_ns() + round(stall_ms * MS), port.drain)
    else:
        port.stall(round(stall_ms * MS))
    simulated.die(name)
    simulated.drive((stall_ms + 2 * GAP_MS) / 1000 + CROWD_BAR_NS / 1e9, FORWARD)
    still_turning = simulated.turning()
    simulated.wait(0.6)
    simulated.recover(name, pid)
    return still_turning


@pytest.mark.claim("DEATH-1")
@pytest.mark.parametrize("seen", [False, True], ids=["in the adapter", "in the kernel"])
@pytest.mark.parametrize("kind", BOARDS)
def test_no_stop_is_lost_when_the_port_stalls_from_a_kill(kind: str, seen: bool) -> None:
    rng = random.Random(f"{kind} {seen}")
    simulated = Simulated({"restart.deaths": 100_000, "restart.window_s": 1.0}, kind=kind)
    found = [
        (name, round(stall_ms))
        for name in PROCESS_NAMES
        for stall_ms in sorted(rng.uniform(0, LONGEST_MS) for _ in range(amount(4, 60)))
        if lost(simulated, rng, name, stall_ms, seen=seen)
    ]
    assert found == []
