"""The state of a process: every cell of the table of what changes it."""

from __future__ import annotations

import pytest

from failstop.policy.processes import PROCESSES
from failstop.procs.loop import Loop
from failstop.procs.world import World
from failstop.supervisor import children
from failstop.supervisor.children import (
    DEAD,
    DOWN,
    EVENTS,
    FENCED,
    HUNG,
    NEXT,
    RUNNING,
    STARTING,
    WAITING,
    Child,
    Restarts,
)

STATES = (WAITING, DOWN, STARTING, RUNNING, HUNG, FENCED, DEAD)
SHORT = {"WA": WAITING, "DO": DOWN, "ST": STARTING, "RU": RUNNING, "HU": HUNG, "FE": FENCED, "DE": DEAD}
CELLS = """
    ST  -   -   -   -   -   -   DO  -
    ST  -   -   -   -   -   -   -   WA
    -   RU  ST  ST  FE  DE  -   -   -
    -   -   HU  RU  FE  DE  -   -   -
    -   -   HU  RU  FE  DE  -   -   -
    -   -   -   FE  -   DE  -   -   -
    -   -   -   DE  -   -   WA  -   -
"""
"""A row a state, a column an event, as they are declared; what cannot happen is a dash: nobody is started who has a
process, nobody runs or beats who has none, nobody dies twice, and only the dead are reaped, and later given up."""


def child(state: str) -> Child:
    world = World()
    made = Child(world, PROCESSES[0], None, Restarts(5, 10**10, 10**8), Loop(world).timer())  # type: ignore[arg-type]
    made.state = state
    return made


def cells() -> list[tuple[str, int, str]]:
    rows = [line.split() for line in CELLS.strip().splitlines()]
    assert len(rows) == len(STATES)
    assert {len(row) for row in rows} == {len(EVENTS)}
    return [
        (state, event, cell)
        for state, row in zip(STATES, rows, strict=True)
        for event, cell in zip(EVENTS, row, strict=True)
    ]


@pytest.mark.parametrize(("state", "event", "cell"), cells())
def test_every_cell(state: str, event: int, cell: str) -> None:
    found = child(state)
    found.on(event)
    assert (event in NEXT[state]) is (cell != "-")
    assert found.state == SHORT.get(cell, state), "what cannot happen changes nothing"


def test_no_state_and_no_event_is_left_out() -> None:
    declared = [text for name, text in vars(children).items() if name.isupper() and isinstance(text, str)]
    assert set(NEXT) == set(STATES) == set(declared)
    assert {event for row in NEXT.values() for event in row} == set(EVENTS)


@pytest.mark.parametrize("state", STATES)
def test_whatever_it_is_it_can_come_to_run(state: str) -> None:
    reached = {state}
    while more := {after for at in reached for after in NEXT[at].values()} - reached:
        reached |= more
    assert RUNNING in reached
