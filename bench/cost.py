"""Cost of the service: processor and memory, at rest and driving, with the IMU at 110 Hz."""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from collections.abc import Callable

import psutil

from bench import stats
from failstop_lab.trial import Trial

FLOOR = "import argparse, dataclasses, json, msgpack"
SETTLE_S = 4.0
"""By then nothing is waited for any more after the last stop."""
LOOKS = 15
"""Commands of each kind, in turns."""


def measure(trial: Trial, seconds: float, progress: Callable[[str], None]) -> list[stats.Row]:
    """Let it rest without a client for `seconds`, and drive at 50 Hz for as long; returns the rows."""
    progress(f"at rest, then driving, for {seconds:g} s each")
    processes = {name: psutil.Process(pid) for name, pid in trial.service.pids().items()}
    trial.leave()
    time.sleep(SETTLE_S)
    rest = _shares(processes, lambda: time.sleep(seconds))
    trial.enable()
    trial.drive(1.0)
    share = _shares(processes, lambda: trial.drive(seconds))
    pss = {name: process.memory_full_info().pss / 1e6 for name, process in processes.items()}
    worst = {name: process.worst_s * 1e3 for name, process in trial.robot.state.processes.items()}
    trial.robot.disable()
    rows = [
        _status(trial),
        _processor("driving", share, 4),
        _processor("at rest, no client", rest, 2),
        stats.limit("memory of the whole service (PSS)", sum(pss.values()), 60, "MB", _parts(pss)),
    ]
    detail = _parts(worst)
    rows.append(stats.Row("longest turn of each loop since its start", detail + " ms", "-", None, dict(worst)))
    return rows


def _shares(processes: dict[str, psutil.Process], act: Callable[[], None]) -> dict[str, tuple[float, float]]:
    """Per cent of a core, and wake-ups a second, of each while something is done."""

    def look() -> dict[str, tuple[float, int]]:
        return {
            name: (sum(process.cpu_times()[:2]), process.num_ctx_switches().voluntary)
            for name, process in processes.items()
        }

    before, start_s = look(), time.monotonic()
    act()
    after, took_s = look(), time.monotonic() - start_s
    return {
        name: (100 * (after[name][0] - cpu_s) / took_s, (after[name][1] - wakes) / took_s)
        for name, (cpu_s, wakes) in before.items()
    }


def _processor(when: str, found: dict[str, tuple[float, float]], most: float) -> stats.Row:
    parts = ", ".join(f"{name} {share:.1f} ({wakes:.0f}/s)" for name, (share, wakes) in found.items())
    total = sum(share for share, _ in found.values())
    return stats.limit(f"processor, {when}, IMU at 110 Hz", total, most, "% of a core", parts)


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
