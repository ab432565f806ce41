"""Kills: every process of the service, at random moments while driving."""

from __future__ import annotations

import contextlib
import os
import random
import tempfile
from collections.abc import Callable, Iterator

from bench import floor, stats
from bench.carriers import Carriers
from failstop.messages import layout
from failstop_lab.sim.client import SimBoard
from failstop_lab.trial import Stopped, Trial

WIRE_MS = 0.59


BALLAST_MB = 100
# Every process imports ctypes, so this one in its place gives each of them the memory of a large program.
BALLAST = f"""
import sys
sys.ballast = b"x" * ({BALLAST_MB} << 20)  # this module is gone with its import of the real one
_path = sys.path  # which a process hands on to those that it starts
sys.path = [path for path in _path if path != __file__.rsplit("/", 1)[0]]
del sys.modules["ctypes"]
import ctypes
sys.path = _path
"""


@contextlib.contextmanager
def heavy() -> Iterator[None]:
    """Services that are started inside have processes of BALLAST_MB more."""
    before = os.environ.get("PYTHONPATH")
    with tempfile.TemporaryDirectory(prefix="failstop-ballast-") as directory:
        with open(os.path.join(directory, "ctypes.py"), "w", encoding="utf-8") as file:
            file.write(BALLAST)
        os.environ["PYTHONPATH"] = os.pathsep.join([directory, *([before] if before else [])])
        try:
            yield
        finally:
            os.environ.pop("PYTHONPATH")
            if before is not None:
                os.environ["PYTHONPATH"] = before


def measure(
    trial: Trial, kills: int, seed: int, progress: Callable[[str], None], carriers: Carriers, *, ballast_mb: int = 0
) -> list[stats.Row]:
    """Kill each process `kills` times, floor samples beside each round; returns the rows. `ballast_mb`: what each of
    the trial's processes was given."""
    chance = random.Random(seed)
    pidfds: list[int] = []
    floors: list[int] = []
    found: dict[str, list[Stopped]] = {process: [] for process in layout.PROCESS_NAMES}
    with SimBoard(trial.link + "-floor", imu_hz=0) as bare, floor.Floor(bare) as least:
        for turn in range(kills):
            progress(f"kills, round {turn + 1} of {kills}")
            if not ballast_mb:
                pidfds.append(floor.pidfd_sample(bare))
            for process in layout.PROCESS_NAMES:
                carriers.first()
                floors.append(least.sample())
                trial.enable()
                pid = trial.service.pids()[process]
                found[process].append(trial.kill(process, chance.uniform(0.1, 0.2)))
                trial.recover(process, pid)
    return rows_of(pidfds, floors, found, f", of {ballast_mb} MB" if ballast_mb else "")


def rows_of(pidfds: list[int], floors: list[int], found: dict[str, list[Stopped]], what: str) -> list[stats.Row]:
    """Rows of the kills of each process, with what the machine itself takes; `what`: words about the service."""
    least = stats.percentiles(floors)
    rows = []
    if pidfds:
        rows.append(stats.timing("idle Python process killed -> pidfd -> 59 bytes", pidfds, p50_ms=None, p99_ms=None))
    measure = f"floor{what and ' beside those'}{what}: idle C process killed -> robust mutex -> 59 bytes"
    rows.append(stats.timing(measure, floors, p50_ms=None, p99_ms=None))
    every = [stopped for row in found.values() for stopped in row]
    for process, row in found.items():
        times = [stopped.stop_ns for stopped in row if stopped.stop_ns is not None]
        rows.append(stats.over_floor(f"kill {process}{what} -> stop frame", times, least, p50=1.5, p99=2.0))
    missed = sum(stopped.stop_ns is None for stopped in every)
    rows.append(stats.count(f"stops missed{what}", missed, len(every)))
    moved = sum(stopped.motion_after for stopped in every)
    rows.append(stats.count(f"motion frames after the stop{what}", moved, len(every)))
    resting = sum(not stopped.was_turning for stopped in every)
    rows.append(stats.count(f"kills that found the wheels at rest{what}", resting, len(every)))
    if pidfds:
        wire = [s.executed_ns - s.stop_ns for s in every if s.executed_ns is not None and s.stop_ns is not None]
        added = f"the wire, added to each ({WIRE_MS} ms when it is idle)"
        rows.append(stats.timing(added, wire, p50_ms=None, p99_ms=None))
    return rows
