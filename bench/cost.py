"""Cost of the service: processor and memory, driving with the IMU at 110 Hz."""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from collections.abc import Callable

import psutil

from bench import stats
from failstop.lab.trial import Trial

FLOOR = "import argparse, dataclasses, json, msgpack"
LOOKS = 15
"""Commands of each kind, in turns."""


def measure(trial: Trial, seconds: float, progress: Callable[[str], None]) -> list[stats.Row]:
    """Drive at 50 Hz for `seconds`; returns the rows."""
    progress(f"driving for {seconds:g} s")
    processes = {name: psutil.Process(pid) for name, pid in trial.service.pids().items()}
    trial.enable()
    trial.drive(1.0)
    before = {name: process.cpu_times() for name, process in processes.items()}
    start_s = time.monotonic()
    trial.drive(seconds)
    took_s = time.monotonic() - start_s
    after = {name: process.cpu_times() for name, process in processes.items()}
    share = {
        name: 100 * (after[name].user + after[name].system - was.user - was.system) / took_s
        for name, was in before.items()
    }
    pss = {name: process.memory_full_info().pss / 1e6 for name, process in processes.items()}
    worst = {name: process.worst_s * 1e3 for name, process in trial.robot.state.processes.items()}
    trial.robot.disable()
    rows = [
        _status(trial),
        stats.limit("processor, driving, IMU at 110 Hz", sum(share.values()), 6, "% of a core", _parts(share)),
        stats.limit("memory of the whole service (PSS)", sum(pss.values()), 60, "MB", _parts(pss)),
    ]
    detail = _parts(worst)
    rows.append(stats.Row("longest turn of each loop since its start", detail + " ms", "-", None, dict(worst)))
    return rows


def _status(trial: Trial) -> stats.Row:
    """`failstop status`, against a Python that imports what any such command needs; the least of many."""
    words = {"floor": ("-c", FLOOR), "status": ("-m", "failstop", "status", "--name", trial.name)}
    times: dict[str, list[float]] = {name: [] for name in words}
    for _ in range(LOOKS):
        for name, given in words.items():
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            subprocess.run((sys.executable, *given), stdout=subprocess.DEVNULL, timeout=60, check=True)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            times[name].append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    least = {name: min(found) * 1e3 for name, found in times.items()}
    share = least["status"] / least["floor"]
    return stats.limit("processor of `failstop status`", share, 3, "x a Python with its libraries", _parts(least))


def _parts(values: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.1f}" for name, value in values.items())
