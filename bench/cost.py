"""Cost of the service: processor and memory, driving with the IMU at 110 Hz."""

from __future__ import annotations

import time
from collections.abc import Callable

import psutil

from bench import stats
from failstop.lab.trial import Trial


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
        stats.limit("processor, driving, IMU at 110 Hz", sum(share.values()), 6, "% of a core", _parts(share)),
        stats.limit("memory of the whole service (PSS)", sum(pss.values()), 60, "MB", _parts(pss)),
    ]
    detail = _parts(worst)
    rows.append(stats.Row("longest turn of each loop since its start", detail + " ms", "-", None, dict(worst)))
    return rows


def _parts(values: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.1f}" for name, value in values.items())
