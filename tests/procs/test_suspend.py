"""A machine that slept is noticed by the clock that went on; being held up is no sleep."""

from __future__ import annotations

from typing import Any

import pytest

from failstop.procs.suspend import SLEPT_NS, SuspendWatch
from tests.support.stage import MS, PortMachine


@pytest.fixture
def machine() -> PortMachine:
    return PortMachine()


def told(machine: PortMachine, watch: Any, *slept_ms: float) -> list[float]:
    """Answers at one look after the other; the machine has slept for so long in all by each."""
    found = []
    for ms in slept_ms:
        machine.machine.slept_ns = round(ms * MS)
        found.append(watch.slept_ns() / MS)
    return found


def watch(machine: PortMachine) -> Any:
    return machine.load("failstop.procs.suspend").SuspendWatch()


@pytest.mark.parametrize(
    ("before_ms", "slept_ms", "told_ms"),
    [
        (7, (7, 3007, 3007), [0, 3000, 0]),
        (0, (60, 120), [60, 60]),
        (0, (3, 0, (SLEPT_NS - 1) / MS), [0, 0, 0]),
    ],
    ids=["once", "two as two", "jitter is none"],
)
def test_a_watch_tells_a_sleep_with_its_length(
    machine: PortMachine, before_ms: int, slept_ms: tuple[float, ...], told_ms: list[float]
) -> None:
    machine.machine.slept_ns = before_ms * MS
    assert told(machine, watch(machine), *slept_ms) == told_ms


def test_a_watch_takes_the_best_of_its_first_three_looks(machine: PortMachine) -> None:
    """Two of them are held up between the clocks."""
    held_up_ns = iter((0, 0, 60 * MS, 0, 0, 60 * MS))
    look = machine.system["time"].monotonic_ns

    def held_up() -> int:
        machine.machine.now_ns += next(held_up_ns, 0)
        return int(look())

    machine.system["time"].monotonic_ns = held_up
    assert told(machine, watch(machine), 0, 0) == [0, 0]
    assert list(held_up_ns) == []


def test_a_start_that_was_held_up_does_not_look_like_a_sleep_for_ever(machine: PortMachine) -> None:
    machine.machine.look_ns = 40 * MS
    made = watch(machine)
    machine.machine.look_ns = 0
    assert told(machine, made, 0, 45) == [0, 0]


def test_being_held_up_between_the_clocks_makes_the_reading_smaller(machine: PortMachine) -> None:
    machine.machine.look_ns = 900 * MS
    assert machine.load("failstop.procs.suspend").gained_ns() == -900 * MS


def test_this_machine_does_not_sleep_now() -> None:
    watched = SuspendWatch()
    assert [watched.slept_ns() for _ in range(1000)] == [0] * 1000
