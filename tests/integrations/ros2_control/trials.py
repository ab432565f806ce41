"""How soon the board stops after a fault of a controller manager: `python -m tests.integrations.ros2_control.trials
--each 100`. The stand-in's drives through the plugin. `--real failstop_ros2_control` and `--real diffdrive_arduino` (at
the guard port) try a real one, where FAILSTOP_ROS names the setup file of a ROS. Exit code 1 if a stop was missed, or
if anything moved again before an enable."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path

from failstop_lab.boards.traits import traits_of
from failstop_lab.controller_manager import HZ, Manager
from failstop_lab.faults import processes
from failstop_lab.trial import Trial

from .real import PLUGINS, Real, Ros, struck
from .scene import drive, managed, settings, stopped, urdf

TIMEOUT_MS = 320.0
Result = tuple[float | None, int]
"""To the board's first stop, ms (None: never), and the motor frames that moved a wheel after it."""
FAULTS: dict[str, tuple[Callable[[Manager], object], float]] = {
    "SIGKILL": (lambda manager: manager.signal(signal.SIGKILL), processes.AT_ONCE_MS),
    "a segmentation fault": (lambda manager: manager.send("segv"), 1e3 / HZ + processes.AT_ONCE_MS),
    "abort()": (lambda manager: manager.send("abort"), 1e3 / HZ + processes.AT_ONCE_MS),
    "exit() without a callback": (lambda manager: manager.send("exit"), 1e3 / HZ + processes.AT_ONCE_MS),
    "Ctrl-C": (lambda manager: manager.signal(signal.SIGINT), 2e3 / HZ + processes.AT_ONCE_MS),
    "SIGTERM": (lambda manager: manager.signal(signal.SIGTERM), 2e3 / HZ + processes.AT_ONCE_MS),
    "read() returns ERROR": (lambda manager: manager.send("fail"), 2e3 / HZ + processes.AT_ONCE_MS),
    "deactivated": (lambda manager: manager.send("to deactivate"), 2e3 / HZ + processes.AT_ONCE_MS),
    "SIGSTOP": (lambda manager: manager.signal(signal.SIGSTOP), TIMEOUT_MS),
    "an endless loop": (lambda manager: manager.send("spin"), 1e3 / HZ + TIMEOUT_MS),
}
"""What happens, and the bar in ms from then to the first stop on the wire. The loop acts a turn later, or two."""
REAL = {
    "SIGKILL": ("SIGKILL", processes.AT_ONCE_MS),
    "Ctrl-C": ("SIGINT", 2e3 / HZ + processes.AT_ONCE_MS),
    "SIGTERM": ("SIGTERM", 2e3 / HZ + processes.AT_ONCE_MS),
    "SIGSTOP": ("SIGSTOP", TIMEOUT_MS),
    "an endless loop in the loop": ("spin", 1e3 / HZ + TIMEOUT_MS),
    "a segmentation fault in the loop": ("segv", 1e3 / HZ + TIMEOUT_MS),
    "SIGSEGV": ("SIGSEGV", TIMEOUT_MS),
    "SIGABRT": ("SIGABRT", TIMEOUT_MS),
    "abort() in the loop": ("abort", 1e3 / HZ + TIMEOUT_MS),
    "exit() in the loop": ("exit", 1e3 / HZ + TIMEOUT_MS),
}
"""The same of a real one, by the words of real.struck()."""
ORDERLY = ("SIGINT", "SIGTERM")
"""At the guard port a driver may write zero after one of these. Then it has not died, and the next one may drive."""
KIND = "arduino"


def one(release: str, trial: Trial, folder: Path, strike: Callable[[Manager], object]) -> Result:
    """A fault of the stand-in's controller manager, which is started for it."""
    with managed(release, urdf("diff", service=trial.name), folder) as manager:
        drive(manager, trial)
        trial.board.events()
        fault_ns = time.monotonic_ns()
        strike(manager)
        seen = stopped(trial, fault_ns)
    return None if seen.stop_ns is None else seen.stop_ns / 1e6, seen.motion_after


def one_real(real: Real, fault: str) -> Result:
    """A fault of the real controller manager, which is started again afterwards and commands in vain."""
    active, pid = real.active(), real.drive()
    real.trial.board.events()
    seen = struck(real, fault)
    if real.pid() == pid:
        os.kill(pid, signal.SIGKILL)
    real.until_active(active + 1)
    time.sleep(1.0)
    later = real.trial.board.events()
    moved = seen.motion_after
    if real.plugin == PLUGINS[0] or fault not in ORDERLY:
        moved += sum(event.is_motion for event in later)
    return None if seen.stop_ns is None else seen.stop_ns / 1e6, moved


def shown(name: str, found: Iterable[Result], each: int, bar_ms: float) -> bool:
    """Print a row; True if no stop was missed and nothing moved."""
    results = list(found)
    times = sorted(ms for ms, _ in results if ms is not None)
    moved = sum(after for _, after in results)
    half, most = (times[len(times) // 2], times[-1]) if times else (0.0, 0.0)
    late = sum(ms > bar_ms for ms in times)
    missed = each - len(times)
    print(
        f"{name:34}{each:5}{missed:8}{moved:7}{half:9.1f}{most:9.1f}{bar_ms:9.1f}   {f'{late} late' if late else ''}",
        flush=True,
    )
    return not moved and not missed


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--each", type=int, default=20, help="how often each fault (default: 20)")
    parser.add_argument("--release", default="lyrical", help="of the stand-in: humble, jazzy, kilted or lyrical")
    parser.add_argument("--real", choices=PLUGINS, help="a real controller manager with this hardware interface")
    parser.add_argument("--only", default="", help="faults whose name has this text")
    given = parser.parse_args()
    own_ms = traits_of(KIND).own_ns / 1e6
    print(f"{'fault':34}{'n':>5}{'missed':>8}{'moved':>7}{'p50':>9}{'most':>9}{'bar':>9}   (ms)")
    good = True
    with tempfile.TemporaryDirectory(prefix="ros2-trials-") as place:
        folder = Path(place)
        if given.real:
            ros = Ros()
            if lacking := ros.lacks(given.real):
                parser.error(lacking)
            with Real(ros, given.real, folder) as real:
                real.until_active(1)
                for name, (fault, bar_ms) in REAL.items():
                    if given.only in name:
                        found = (one_real(real, fault) for _ in range(given.each))
                        good &= shown(name, found, given.each, bar_ms + own_ms)
            return int(not good)
        with Trial(f"ros2-trials-{os.getpid()}", settings(folder, KIND), imu_hz=20.0, kind=KIND) as trial:
            for name, (strike, bar_ms) in FAULTS.items():
                if given.only in name:
                    found = (one(given.release, trial, folder / "manager", strike) for _ in range(given.each))
                    good &= shown(name, found, given.each, bar_ms + own_ms)
    return int(not good)


if __name__ == "__main__":
    sys.exit(main())
