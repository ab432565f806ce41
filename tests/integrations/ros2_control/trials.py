"""How soon the board stops after a fault of the stand-in's controller manager, which drives it through the plugin:
`python -m tests.integrations.ros2_control.trials --each 100`. Exit code 1 if a stop was missed, or if anything moved
again before an enable."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from failstop_lab.boards.traits import traits_of
from failstop_lab.controller_manager import HZ, Manager
from failstop_lab.faults import processes
from failstop_lab.trial import Trial

from .scene import drive, managed, settings, stopped, urdf

TIMEOUT_MS = 320.0
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
KIND = "arduino"


def one(release: str, trial: Trial, folder: Path, strike: Callable[[Manager], object]) -> tuple[float | None, int]:
    """To the board's first stop, ms (None: never), and the motor frames that moved a wheel after it."""
    with managed(release, urdf("diff", service=trial.name), folder) as manager:
        drive(manager, trial)
        trial.board.events()
        fault_ns = time.monotonic_ns()
        strike(manager)
        seen = stopped(trial, fault_ns)
    return None if seen.stop_ns is None else seen.stop_ns / 1e6, seen.motion_after


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--each", type=int, default=20, help="how often each fault (default: 20)")
    parser.add_argument("--release", default="lyrical", help="humble, jazzy, kilted or lyrical")
    parser.add_argument("--only", default="", help="faults whose name has this text")
    given = parser.parse_args()
    own_ms = traits_of(KIND).own_ns / 1e6
    print(f"{'fault':26}{'n':>5}{'missed':>8}{'moved':>7}{'p50':>9}{'most':>9}{'bar':>9}   (ms)")
    failed = False
    with tempfile.TemporaryDirectory(prefix="ros2-trials-") as place:
        folder = Path(place)
        with Trial(f"ros2-trials-{os.getpid()}", settings(folder, KIND), imu_hz=20.0, kind=KIND) as trial:
            for name, (strike, bar_ms) in FAULTS.items():
                if given.only not in name:
                    continue
                found = [one(given.release, trial, folder / "manager", strike) for _ in range(given.each)]
                times = sorted(ms for ms, _ in found if ms is not None)
                moved = sum(after for _, after in found)
                failed = failed or bool(moved) or len(times) < given.each
                half, most = (times[len(times) // 2], times[-1]) if times else (0.0, 0.0)
                late = sum(ms > bar_ms + own_ms for ms in times)
                print(
                    f"{name:26}{given.each:5}{given.each - len(times):8}{moved:7}{half:9.1f}{most:9.1f}"
                    f"{bar_ms + own_ms:9.1f}   {f'{late} late' if late else ''}",
                    flush=True,
                )
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
