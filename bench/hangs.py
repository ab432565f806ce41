"""Hangs: every process stopped (SIGSTOP) while driving, and its deadline."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import time
from collections.abc import Callable

from bench import stats
from failstop.messages import layout
from failstop.policy.processes import PROCESS_BY_NAME
from failstop.policy.settings import Settings
from failstop_lab.trial import Stopped, Trial, judge, wait_for

MARGIN_MS = 10.0
AFTERMATH_S = 0.15


def deadlines_ms() -> dict[str, float]:
    """How long each process may be silent: by the process table, and by the port owner's leases, which are shorter."""
    lease_ms = Settings().ns("gate.lease_s") / 1e6
    found = {name: row.deadline_ns / 1e6 for name, row in PROCESS_BY_NAME.items()}
    return {**found, layout.GATE: lease_ms, layout.SUPERVISOR: lease_ms}


def measure(trial: Trial, count: int, seed: int, progress: Callable[[str], None]) -> list[stats.Row]:
    """Hang each process `count` times; the rows say how long the board waited for the stop."""
    chance = random.Random(seed)
    found: dict[str, list[Stopped]] = {process: [] for process in deadlines_ms()}
    for process, deadline_ms in deadlines_ms().items():
        for turn in range(count):
            progress(f"hangs of {process}, {turn + 1} of {count}")
            trial.enable()
            pid = trial.service.pids()[process]
            trial.board.events()
            trial.drive(chance.uniform(0.1, 0.2))
            was_turning = trial.turning()
            hung_ns = time.monotonic_ns()
            os.kill(pid, signal.SIGSTOP)
            trial.drive(deadline_ms / 1000 + AFTERMATH_S)
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)  # a process that was fenced is gone
            trial.drive(AFTERMATH_S)
            found[process].append(judge(trial.board.events(), hung_ns, was_turning))
            wait_for("the service to be whole again", trial.service.ready)
    return rows_of(found)


def rows_of(found: dict[str, list[Stopped]]) -> list[stats.Row]:
    """Rows of the hangs of each process: how long the board waited, and whether the stop came and held."""
    deadlines = deadlines_ms()
    rows = []
    for process, row in found.items():
        times = [stopped.stop_ns for stopped in row if stopped.stop_ns is not None]
        rows.append(row_of(process, deadlines[process], times))
    every = [stopped for row in found.values() for stopped in row]
    missed = sum(stopped.stop_ns is None or not stopped.was_turning for stopped in every)
    moved = sum(stopped.motion_after for stopped in every)
    return [
        *rows,
        stats.count("stops missed after a hang", missed, len(every)),
        stats.count("motion frames after it, the hung process continued", moved, len(every)),
    ]


def row_of(process: str, deadline_ms: float, times: list[int]) -> stats.Row:
    """Row of one process, with its deadline as the bar."""
    row = stats.timing(
        f"hang of {process} (deadline {deadline_ms:g} ms) -> stop frame", times, p50_ms=None, p99_ms=None
    )
    limit_ms = deadline_ms + MARGIN_MS
    row.bar, row.met = f"p99 < {limit_ms:g} ms", row.numbers["p99_ms"] < limit_ms
    return row


def replugs(trial: Trial, count: int, seed: int, progress: Callable[[str], None]) -> stats.Row:
    """The port gone for a while and back: from before the link is there again to the first stop frame, whose 59 bytes
    are the first on the wire."""
    chance = random.Random(seed)
    times = []
    for turn in range(count):
        progress(f"replugs, {turn + 1} of {count}")
        trial.enable()
        trial.drive(chance.uniform(0.05, 0.1))
        trial.board.unplug()
        wait_for("the loss to be noticed", lambda: trial.robot.state.device.state == "lost")
        time.sleep(chance.uniform(0.02, 0.06))
        trial.board.events()
        back_ns = time.monotonic_ns()
        trial.board.replug()
        event = trial.board.wait_for(lambda found, since=back_ns: found.arrival_ns >= since, 5.0)  # type: ignore[misc]
        assert event.is_stop, f"the first frame after a replug is {event}"
        times.append(event.arrival_ns - back_ns)
        wait_for("the service to be whole again", trial.service.ready)
    return stats.timing("replug -> first stop frame", times, p50_ms=None, p99_ms=10.0)
