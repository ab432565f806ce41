"""Runs that a campaign counts and does not play: each is the same as one that it plays, call by call."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest

from failstop_lab.machine.kernel import STEP_NS
from failstop_lab.machine.process import Thread
from failstop_lab.simulate.equivalents import ASKS, IS_HELD, IS_STARVED, SLEEPS, Equivalents
from failstop_lab.simulate.faults import INTERNAL, faults
from failstop_lab.simulate.scenarios import DRIVEN, SCENARIOS
from failstop_lab.simulate.stage import Continuation, Stage

pytestmark = pytest.mark.slow
SCENARIO = "drive"
SAMPLES = 4
Calls = list[tuple[str, str, int]]


def pairs(fault: str) -> list[tuple[int, int]]:
    """The calls of an unfaulted run that are told equal, each with the one that it equals."""
    stage = Stage(SCENARIOS[SCENARIO])
    equivalents, found, number, last = Equivalents(stage), [], 0, 0

    def look(thread: Thread, call: str, about: tuple[Any, ...]) -> None:
        nonlocal number, last
        number += 1
        if stage.explored and fault in dict(faults(stage, thread, call, about)):
            if equivalents.tried(fault, thread):
                found.append((last, number))
            else:
                last = number

    stage.machine.at_seam = look
    stage.run()
    return found


def played(at: int, fault: str) -> tuple[Calls, list[str], int]:
    """Every call of the run with its time, what was wrong, and how often somebody asked why a process is silent."""
    stage, calls = Stage(SCENARIOS[SCENARIO]), Calls()

    def record(thread: Thread, call: str, about: tuple[Any, ...]) -> None:
        calls.append((thread.process.name, call, stage.machine.now_ns))
        if len(calls) == at:
            dict(faults(stage, thread, call, about))[fault]()

    stage.machine.at_seam = record
    stage.run()
    return calls, stage.witness.violations, stage.machine.starved_looks


@pytest.mark.parametrize("fault", [SLEEPS, ASKS])
def test_a_fault_that_nobody_can_have_noticed_since_is_the_same_fault(fault: str) -> None:
    told = pairs(fault)
    assert len(told) > 50
    for first, second in told[:: len(told) // SAMPLES]:
        assert played(first, fault) == played(second, fault)


def test_a_process_that_is_starved_is_one_that_is_held_where_nobody_asks_why() -> None:
    told = pairs(SLEEPS)
    asked = []
    for _, number in told[:: len(told) // SAMPLES]:
        held, starved = played(number, IS_HELD), played(number, IS_STARVED)
        asked.append(held[2] > 0)
        assert held == starved or asked[-1]
    assert not all(asked)


@pytest.mark.parametrize("fault", ["dies", IS_HELD])
def test_a_fault_at_a_call_that_nobody_sees_is_that_at_the_next_one(fault: str) -> None:
    """The two differ by that call and its time."""
    calls, stage = [], Stage(SCENARIOS[SCENARIO])
    stage.machine.at_seam = lambda thread, call, about: calls.append((thread.number, call, stage.explored))
    stage.run()
    told = [
        at
        for at, (each, then) in enumerate(pairwise(calls), 1)
        if each[0] == then[0] and each[1] in INTERNAL and then[1] not in INTERNAL and each[2]
    ]
    assert len(told) > SAMPLES
    for at in told[:: len(told) // SAMPLES]:
        (one, *judged), (other, *judged_too) = played(at, fault), played(at + 1, fault)
        assert judged == judged_too
        assert abs(len(one) - len(other)) <= 1
        assert abs(one[-1][2] - other[-1][2]) <= STEP_NS


def begin(name: str) -> Calls:
    """Every call of a scenario up to where it leaves what many begin with."""
    stage, calls, until = Stage(SCENARIOS[name]), Calls(), []

    def leave(rest: Continuation) -> Continuation:
        until.append(len(calls))
        return lambda stage, robot: None

    stage.branch = leave
    stage.machine.at_seam = lambda thread, call, about: calls.append((thread.process.name, call, stage.machine.now_ns))
    stage.play()
    return calls[: until[0]]


def test_the_scenarios_that_are_tried_as_one_begin_with_the_same_calls() -> None:
    first, *others = DRIVEN
    expected = begin(first)
    assert len(expected) > 500
    assert [name for name in others if begin(name) != expected] == []
