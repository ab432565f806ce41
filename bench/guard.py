"""`python -m bench.guard`: the guard port, with a driver in C that makes diffdrive_arduino's calls.

The floor of the guard's answers is the same driver, at the same time, at a pseudo-terminal that a C program with the
guard's priority answers (answers.c). On a busy machine both wait for the processor and for the kernel's own worker.

Times are taken on the board's side of the wire, up to the last byte of the zero that stops the wheels; what the board's
own line takes comes on top.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import signal
import tempfile
import time
from pathlib import Path

from bench import report, stats
from bench.guard_scene import GuardScene, Process, compiled, diffdrive
from failstop.guard.command import NICE
from failstop_lab.trial import TrialError, wait_for

PERIOD_MS = 10.0
FLOORS = 1.5
"""An answer is late when it takes longer than a period and than so many times the floor's latest."""
STOP_S = 2.0
TRIES = 5
"""How often a trial may begin again: on a busy machine the service may stop by itself before the driver is killed."""


class Measure:
    """A scene with one driver after the other."""

    def __init__(self, scene: GuardScene, program: str, seed: int) -> None:
        self._scene, self._program = scene, program
        self._chance = random.Random(seed)
        self.again: list[str] = []
        """Why trials began again."""

    def _drives(self, hertz: str = "30", *how: str) -> Process:
        """A driver whose wheels turn. Raises TrialError when that takes more than TRIES."""
        for left in reversed(range(TRIES)):
            self._scene.rest()
            self._scene.enable()
            driver = self._scene.driver(self._program, self._scene.path, "serial", "10", "10", hertz, *how)
            driver.line(60.0)
            try:
                self._scene.moves()
            except TrialError:
                if not left:
                    raise
                self.again.append(self._scene.trial.robot.state.estop or "motion was not enabled")
                self._scene.end_drivers()
            else:
                return driver
        raise AssertionError("TRIES is above 0")

    def _stops_ns(self, number: int, *how: str) -> int | None:
        """From the signal to a driver until the board has the zero; None: it never came."""
        driver = self._drives("30", *how)
        time.sleep(self._chance.uniform(0.1, 0.2))
        self._scene.trial.board.events()
        fault_ns = time.monotonic_ns()
        os.kill(driver.pid, number)
        try:
            wait_for("the wheels to stand", lambda: not self._scene.trial.turning(), STOP_S)
        except TrialError:
            return None
        finally:
            driver.kill()
            self._scene.end_drivers()
        zeros = (event for event in self._scene.trial.board.events() if event.arrival_ns >= fault_ns)
        return next((event.arrival_ns - fault_ns for event in zeros if not any(event.speeds)), None)

    def faults(self, what: str, number: int, times: int, bar_ms: float, *how: str) -> list[stats.Row]:
        """Rows of so many drivers that get this signal while they drive."""
        found = []
        for turn in range(times):
            report.progress(f"{what}, {turn + 1} of {times}")
            found.append(self._stops_ns(number, *how))
        times_ns = [each for each in found if each is not None]
        missed = stats.count(f"{what}: wheels that turned on", found.count(None), times)
        return [missed, stats.timing(f"{what} -> zero at the board", times_ns, p50_ms=None, p99_ms=bar_ms)]

    def answers(self, seconds: float, hertz: int) -> list[stats.Row]:
        """Rows of a driver that asks and commands so often."""
        report.progress(f"a driver at {hertz} Hz for {seconds:g} s")
        driver = self._drives(str(hertz))
        floor = self._floor(hertz)
        until_s = time.monotonic() + seconds
        took_ms: list[float] = []
        floor_ms: list[float] = []
        lost = 0
        while time.monotonic() < until_s:
            counts, answer, first, second = driver.line().split("|")
            took_ms += [float(first), float(second)]
            lost += (len(counts.split()) != 2) + (answer != "OK")
            floor_ms += [float(each) for each in floor.line().split("|")[2:]]
        driver.kill()
        floor.kill()
        self._scene.end_drivers()
        bar_ms = max(PERIOD_MS, FLOORS * max(floor_ms))
        late = sum(each > bar_ms for each in took_ms)
        what = f"a driver at {hertz} Hz for {seconds:g} s"
        least = sum(each > PERIOD_MS for each in floor_ms)
        _, floor_p99_ms, _ = stats.percentiles([round(each * 1e6) for each in floor_ms])
        beside = f"{sum(each > PERIOD_MS for each in took_ms)} later than {PERIOD_MS:g} ms, of the floor's {least}"
        row = stats.count(f"{what}: answers later than {PERIOD_MS:g} ms and {FLOORS:g} x floor", late, len(took_ms))
        row.result += f"  ({beside})"
        return [
            self._timing(f"{what}: its answers", took_ms, 1.0, max(3.0, FLOORS * floor_p99_ms)),
            self._timing(f"{what}: the floor, a C program that answers", floor_ms, None, None),
            stats.count(f"{what}: lines without their answer", lost, len(took_ms)),
            row,
        ]

    @staticmethod
    def _timing(what: str, took_ms: list[float], p50_ms: float | None, p99_ms: float | None) -> stats.Row:
        return stats.timing(what, [round(each * 1e6) for each in took_ms], p50_ms=p50_ms, p99_ms=p99_ms)

    def _floor(self, hertz: int) -> Process:
        """The same driver at the C program."""
        answers = self._scene.driver(compiled(self._scene.folder, "answers"))
        with contextlib.suppress(OSError):  # as the guard, which does without
            os.setpriority(os.PRIO_PROCESS, answers.pid, NICE)
        floor = self._scene.driver(self._program, answers.line(), "serial", "0", "0", str(hertz))
        floor.line()
        return floor

    def disabled(self, lines: int) -> stats.Row:
        """The row of a driver that writes as fast as it can while motion is disabled."""
        self._scene.rest()
        self._scene.trial.robot.disable()
        self._scene.trial.board.events()
        driver = self._scene.driver(self._program, self._scene.path, "serial", "300", "-300", "1e6")
        for turn in range(lines):
            if turn % 1000 == 0:
                report.progress(f"lines while motion is disabled, {turn} of {lines}")
            driver.line()
        moved = len(self._scene.motion())
        driver.kill()
        self._scene.end_drivers()
        return stats.count("motion frames at the board while motion is disabled, of a driver's lines", moved, lines)


def main() -> int:
    """Measure; exit code 1 when a bar is missed."""
    parser = argparse.ArgumentParser(prog="python -m bench.guard", description=__doc__)
    parser.add_argument("--kills", type=int, default=100, help="of each kind (default: 100)")
    parser.add_argument("--seconds", type=float, default=60, help="of the driver at 100 Hz (default: 60; the bar: 600)")
    parser.add_argument("--lines", type=int, default=10_000, help="while disabled (default: 10000; the bar: 100000)")
    parser.add_argument("--seed", type=int, default=1, help="of the random moments")
    parser.add_argument("--out", help="where the JSON goes")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="failstop-guard-bench-") as folder:
        place = Path(folder)
        program = diffdrive(place)
        with GuardScene(place, "arduino") as scene:
            measure = Measure(scene, program, arguments.seed)
            kills = arguments.kills
            rows = measure.faults("a driver is killed", signal.SIGKILL, kills, 10.0)
            rows += measure.faults("a driver of 500 MB is killed", signal.SIGKILL, max(1, kills // 5), 60.0, "big")
            rows += measure.faults("a driver is suspended", signal.SIGSTOP, max(1, kills // 5), 320.0)
            rows += measure.answers(arguments.seconds, 100)
            rows.append(measure.disabled(arguments.lines))
            why = ", ".join(sorted(set(measure.again))) or "-"
            rows.append(stats.Row("trials that began again", f"{len(measure.again)}: {why}", "-", None, {}))
    return report.end(rows, arguments.out)


if __name__ == "__main__":
    raise SystemExit(main())
