"""One scenario in both worlds: the simulated machine and real processes tell of it in the same causes, the same order
and the same proofs, and move the wheels alike."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from failstop.api import events as real_events
from failstop_lab.boards.traits import HAS_DRIVERS
from failstop_lab.simulate.scenarios import SCENARIOS, Play
from failstop_lab.simulate.stage import NEEDS, Stage
from tests.lab.machine.processes import Processes
from tests.lab.machine.twins import TWINS
from tests.support.amounts import LONG

KINDS = (
    *("stop", "stop_again", "stop_also", "stop_outcome", "enabled", "disabled", "reset", "died", "fenced", "down"),
    *("device_lost", "device_back", "driver_gone", "unstill"),
)
HELD = (
    *("port_owner_and_supervisor_hang", "stopper_alone_runs", "port_owner_hangs_shortly"),
    *("port_owner_held_in_its_write", "port_owner_stays_down", "port_owner_hangs_and_stays_down"),
    "port_owner_starves_and_hangs",
)
ON_ONE_ALONE = {
    **dict.fromkeys(HELD, "processes are held at moments that a signal does not hit"),
    "supervisor_hangs": "a signal that silences it tells it so",
    "port_does_not_drain": "a pty never says that it holds bytes",
    "machine_sleeps": "this machine must not",
    "memory_is_damaged": "tests/e2e/test_hostile_clients.py damages it with real processes",
    "service_ends": "there is no run left to read from",
    **dict.fromkeys(("wheel_runs_away", "wheels_turn_unasked"), "this board reports no wheels"),
    **dict.fromkeys(("reports_lie", "reports_are_late"), "a simulated board on a pty reports what is true, at once"),
}
ON_ONE_ALONE |= {
    name: "a named pipe stands for the guard port there; tests/lab/faults has its rows with real processes"
    for name, play in SCENARIOS.items()
    if HAS_DRIVERS in NEEDS[play]
}
PLAYS = {name: play for name, play in SCENARIOS.items() if name not in ON_ONE_ALONE} | TWINS
pytestmark = pytest.mark.slow
NAMES = PLAYS if LONG else ("drive_and_stop", "port_owner_dies", "gate_hangs", "replug", "driver_dies")
TOLD_S = 2.6
"""The time from a stop until all is told of it."""


def told(event: Any) -> tuple[object, ...]:
    """An event without its times and numbers: the kind, its cause and process, and what is proved. Who notices a death
    first decides whether it is told of as one more stop, or as one more cause of the same."""
    fields = event.fields
    proofs = tuple(fields.get(key) is not None for key in ("acknowledged_us", "observed_ms"))
    kind = "stop_again" if event.kind == "stop_also" else event.kind
    return (kind, fields.get("cause"), fields.get("process"), proofs if event.kind == "stop_outcome" else ())


def turns(speeds: Sequence[tuple[float, ...]]) -> list[bool]:
    """The changes of the wheels: True where they turned from then on."""
    found = [False]
    for each in speeds:
        if any(each) != found[-1]:
            found.append(any(each))
    return found


def story(events: list[Any]) -> list[tuple[object, ...]]:
    """The part that is compared. The port owner may hear of a fenced process's death before it sees the epoch."""
    found = [told(event) for event in events if event.kind in KINDS]
    if any(kind == "fenced" for kind, *_ in found):
        found = [each for each in found if each[:2] != ("stop_again", "died")]
    return found


def simulated(play: Play) -> tuple[list[bool], list[tuple[object, ...]]]:
    stage = Stage(play)
    stage.play()
    events: list[Any] = []
    reader = stage.robot.program(
        "reader.py",
        lambda failstop: events.extend(
            read(stage.robot.loader.load("failstop.api.events"), failstop, "failstop", stage.time)
        ),
    )
    assert stage.machine.run(lambda: reader.dead, 30_000_000_000)
    frames = stage.robot.board.model.executed(0)
    return turns([frame.speeds for frame in frames]), story(events)


def real(play: Play, name: str, directory: Path) -> tuple[list[bool], list[tuple[object, ...]]]:
    with Processes(play, name, directory) as stage:
        stage.play()
        events = read(real_events, stage.failstop, name, stage.time)
        speeds = [event.speeds for event in stage.trial.board.events(0)]
    return turns(speeds), story(events)


def read(events: Any, failstop: Any, name: str, time: Any) -> list[Any]:
    """The events of the run that is there, once all of them are told."""
    until_s = time.monotonic() + TOLD_S
    while True:
        try:
            log = events.EventLog(name)
            found = log.read()
            while time.monotonic() < until_s:
                time.sleep(0.05)
                found += log.read()
        except failstop.FailstopError:
            time.sleep(0.05)
        else:
            return found


@pytest.mark.parametrize("name", NAMES)
def test_both_worlds_tell_the_same_story(name: str, tmp_path: Path) -> None:
    play = PLAYS[name]
    assert simulated(play) == real(play, f"twin-{os.getpid()}", tmp_path)
