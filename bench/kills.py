"""Kills: every process of the service, at random moments while driving."""

from __future__ import annotations

import random
from collections.abc import Callable

from bench import floor, stats
from failstop.board.sim.client import SimBoard
from failstop.shm import layout
from failstop.trial import Stopped, Trial

WIRE_MS = 0.59


def measure(trial: Trial, kills: int, seed: int, progress: Callable[[str], None]) -> list[stats.Row]:
    """Kill each process `kills` times, a floor sample beside each round; returns the rows."""
    chance = random.Random(seed)
    floors: list[int] = []
    found: dict[str, list[Stopped]] = {process: [] for process in layout.PROCESSES}
    with SimBoard(trial.link + "-floor", imu_hz=0) as bare:
        for turn in range(kills):
            progress(f"kills, round {turn + 1} of {kills}")
            floors.append(floor.sample(bare))
            for process in layout.PROCESSES:
                trial.enable()
                pid = trial.service.pids()[process]
                found[process].append(trial.kill(process, chance.uniform(0.1, 0.2)))
                trial.recover(process, pid)
    return _rows(floors, found)


def _rows(floors: list[int], found: dict[str, list[Stopped]]) -> list[stats.Row]:
    floor_ms, _, _ = stats.percentiles(floors)
    rows = [stats.timing("floor: idle Python process killed -> pidfd -> 59 bytes", floors, p50_ms=None, p99_ms=None)]
    every = [stopped for row in found.values() for stopped in row]
    for process, row in found.items():
        times = [stopped.stop_ns for stopped in row if stopped.stop_ns is not None]
        rows.append(
            stats.timing(f"kill {process} -> stop frame", times, p50_ms=2.0, p99_ms=5.0, floor_ms=floor_ms),
        )
    rows.append(stats.count("stops missed", sum(stopped.stop_ns is None for stopped in every), len(every)))
    moved = sum(stopped.motion_after for stopped in every)
    rows.append(stats.count("motion frames after the stop", moved, len(every)))
    rows.append(stats.count("kills that found the wheels at rest", sum(not s.was_moving for s in every), len(every)))
    wire = [s.executed_ns - s.stop_ns for s in every if s.executed_ns is not None and s.stop_ns is not None]
    rows.append(stats.timing(f"the wire, added to each ({WIRE_MS} ms when it is idle)", wire, p50_ms=None, p99_ms=None))
    return rows
