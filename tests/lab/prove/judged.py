"""A run of `failstop prove` without a stand, with whatever its test changes."""

from __future__ import annotations

import random
from types import SimpleNamespace

from failstop.board.interface import BY_ANSWER, BY_IMU
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop_lab.prove.means import UNMEASURED, Means
from failstop_lab.prove.run import PathRun
from failstop_lab.prove.table import BY_PATH, BY_TURNING
from tests.lab.prove.noise import DRIVE, SIMULATED, STILL, gyro
from tests.support.board_events import FAULT_NS, event
from tests.support.board_events import STILL as REST

MS = 1_000_000
LATCH = causes.PIPED("prove")
MEANS = Means(BY_ANSWER, BY_IMU, pad=True, speeds=UNMEASURED)
"""Of the first board."""


def run(path: str = "stop-request", latch: Cause | None = LATCH, **board: object) -> PathRun:
    """A run whose cause was at FAULT_NS: written after 1 ms, answered after 5, wheels at rest after 0.3 s."""
    samples = gyro((1.0, DRIVE), (0.3, DRIVE), (1.5, STILL), bias=0.0, start_ns=FAULT_NS - 1_000 * MS)
    watch = SimpleNamespace(
        samples=samples,
        written=[(FAULT_NS + MS, "port_owner")],
        zeros=[],
        answers=[(FAULT_NS + 2 * MS, FAULT_NS + 5 * MS)],
    )
    events = board.get("events", [event(0, 1.0, REST)])
    stand = SimpleNamespace(
        board=SimpleNamespace(events=lambda: events),
        watch=watch,
        means=MEANS,
        driver=SimpleNamespace(robot=SimpleNamespace(state=SimpleNamespace(cause=latch, estop=latch and str(latch)))),
        service=SimpleNamespace(process=SimpleNamespace(wait=lambda _: 3)),
    )
    made = PathRun(stand, SIMULATED, BY_PATH[path], BY_TURNING["0.2"], None, random.Random(1))  # type: ignore[arg-type]
    made.cause_ns = FAULT_NS
    return made


UNSEEN = "the wheels were not seen turning before the stop"
LATE = (UNSEEN, "written after", "acknowledged after", "at the board after", "at rest after", "no moment of rest")
"""Beginnings of faults that a machine which is held up brings about (test_starved_rows.py)."""


def firm(wrong: list[str]) -> list[str]:
    return [fault for fault in wrong if not fault.startswith(LATE)]


def wrong(made: PathRun) -> list[str]:
    made.judge()
    return made.result.wrong
