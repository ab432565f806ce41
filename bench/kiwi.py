"""A policy of LeRobot's that drives by the plugin: `python -m bench.kiwi`. With `--python` that of an environment with
the real LeRobot (`make lerobot` makes one), else with the tests' stand-in.

The simulated board says when wheels and joints stand.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from bench import BenchError, report, stats
from bench.carriers import Carriers
from bench.report import progress
from bench.stats import Row
from failstop.lab.faults.arm import ArmTrial, judge
from failstop.lab.faults.arm_table import ARM_FAULT_BY_NAME, BY_ITSELF_MS, GOAL_MS, STOP_MS
from failstop.lab.stopped import judge as stopped_by
from failstop.lab.trial import wait_for

ROOT = Path(__file__).resolve().parents[1]
PROGRAM = Path(__file__).with_name("kiwi_policy.py")
SETTINGS: dict[str, object] = {"scan.gate": "off", "arm.auto_tuck": "off"}
PERIOD_MS = 1000 / 30
JITTER_MS = 5.0
COMMAND_MS = 300.0
"""Age at which a command of the base counts no more (sources.cmd_vel.timeout_s)."""


class Bench:
    """The robot, and the interpreter of the policies."""

    def __init__(self, trial: ArmTrial, python: str, home: str, seed: int) -> None:
        self.trial = trial
        self.random = random.Random(seed)
        path = [ROOT, ROOT / "integrations/lerobot"] + ([] if python else [ROOT / "tests/kiwi/standin"])
        self._words = [python or sys.executable, str(PROGRAM), trial.name]
        self._environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(map(str, path)),
            "HF_LEROBOT_HOME": home,
            "HF_HUB_OFFLINE": "1",
        }

    def policy(self, *words: str) -> subprocess.Popen[str]:
        """A policy that streams."""
        process = subprocess.Popen(
            [*self._words, *words], env=self._environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        assert process.stdout
        if process.stdout.readline() != "streams\n":
            process.kill()
            raise BenchError("the policy's program has ended: no LeRobot in that environment?")
        return process

    def ready(self) -> None:
        """Disabled, nothing latched, the arm in its drive pose and read."""
        self.trial.settle()
        self.trial.drive_pose()
        self.trial.robot.arm.read()

    def struck(self, part: str, fault: signal.Signals) -> int:
        """Send a streaming policy this signal at a moment of chance; the time of it. The program is ended."""
        with self.policy(part) as process:
            if part == "wheels":
                self.trial.board.wait_wheels(turning=True, timeout_s=10.0)
            else:
                wait_for("the arm to move", lambda: (arm := self.trial.robot.state.arm) and arm.moving)
            time.sleep(self.random.uniform(0.2, 0.5))
            at_ns = time.monotonic_ns()
            process.send_signal(fault)
            time.sleep(0.7)
            process.kill()
        return at_ns


def off(turns: list[list[int]]) -> list[int]:
    """How far from the period the turns began, ns."""
    begun = [turn[0] for turn in turns]
    return [abs(after - before - round(PERIOD_MS * 1e6)) for before, after in itertools.pairwise(begun)]


def streaming(bench: Bench, seconds: float) -> Iterator[Row]:
    """Thirty turns a second with everything read back, while the arm moves; beside it a loop that does nothing."""
    progress("streaming")
    bench.ready()
    with bench.policy("arm", str(seconds)) as process, bench.policy("nothing", str(seconds)) as idle:
        assert process.stdout
        assert idle.stdout
        turns, bare = json.loads(process.stdout.read()), json.loads(idle.stdout.read())
    yield stats.timing("30 Hz, all read back: a turn's period off by", off(turns), p50_ms=None, p99_ms=JITTER_MS)
    yield stats.timing("of it a loop beside it that does nothing", off(bare), p50_ms=None, p99_ms=None)
    for name, index in (("get_observation()", 1), ("send_action()", 2)):
        yield stats.timing(f"{name} of nine numbers", [turn[index] for turn in turns], p50_ms=None, p99_ms=None)


def wheels(bench: Bench, fault: signal.Signals, count: int, bar_ms: float) -> Row:
    """The policy is struck while the base drives."""
    found: list[int] = []
    wrong: list[str] = []
    for turn in range(count):
        progress(f"{fault.name} while driving, {turn + 1} of {count}")
        bench.ready()
        bench.trial.robot.enable()
        mark = bench.trial.board.info()["executed"]
        at_ns = bench.struck("wheels", fault)
        stopped = stopped_by(bench.trial.board.events(mark), at_ns, was_turning=True)
        if stopped.stop_ns is None or stopped.motion_after:
            wrong.append(f"{stopped.motion_after} motion frames after the stop" if stopped.stop_ns else "no stop")
        found += [stopped.stop_ns] if stopped.stop_ns is not None else []
    timed = stats.timing(f"{fault.name} of the policy while driving -> wheels zero", found, p50_ms=None, p99_ms=bar_ms)
    return judged(timed, wrong)


def judged(timed: Row, wrong: list[str]) -> Row:
    """The row, with what went wrong beside the times."""
    timed.result += f"  {wrong}" if wrong else ""
    timed.met = timed.met and not wrong
    return timed


def arm(bench: Bench, fault: signal.Signals, count: int, bar_ms: float) -> Row:
    """The policy is struck while the arm moves."""
    row = ARM_FAULT_BY_NAME["arm-client-killed" if fault is signal.SIGKILL else "arm-client-hung"]
    found, wrong = [], []
    for turn in range(count):
        progress(f"{fault.name} while the arm moves, {turn + 1} of {count}")
        bench.ready()
        board = bench.trial.board
        legs, mark = board.joint_legs(), board.info()["executed"]
        at_ns = bench.struck("arm", fault)
        rested = judge(row, at_ns, board.events(mark), board.joint_track(legs), bench.trial.robot.state.cause)
        found.append(round((rested.rest_ms or 0) * 1e6))
        wrong += [*rested.wrong, *(["a servo is limp"] if board.limp() else [])]
    timed = stats.timing(f"{fault.name} of the policy -> every joint stands", found, p50_ms=None, p99_ms=bar_ms)
    return judged(timed, wrong)


def main() -> int:
    """Measure; exit code 1 when a bar is missed."""
    parser = argparse.ArgumentParser(prog="python -m bench.kiwi", description=__doc__)
    parser.add_argument("--python", default="", help="of an environment with LeRobot (default: the stand-in)")
    parser.add_argument("--seconds", type=float, default=60.0, help="of streaming (default: 60)")
    parser.add_argument("--kills", type=int, default=40, help="SIGKILLs of each kind (default: 40)")
    parser.add_argument("--hangs", type=int, default=8, help="SIGSTOPs of each kind (default: 8)")
    parser.add_argument("--seed", type=int, default=1, help="of the random moments")
    parser.add_argument("--out", default="bench/out/kiwi.json", help="where the JSON goes")
    arguments = parser.parse_args()
    with Carriers() as carriers, tempfile.TemporaryDirectory() as home, ArmTrial("bench-kiwi", SETTINGS) as trial:
        bench = Bench(trial, arguments.python, home, arguments.seed)
        rows = list(streaming(bench, arguments.seconds))
        for fault, count, late_ms, held_ms in (
            (signal.SIGKILL, arguments.kills, STOP_MS, BY_ITSELF_MS + STOP_MS),
            (signal.SIGSTOP, arguments.hangs, COMMAND_MS + 20.0, BY_ITSELF_MS + GOAL_MS),
        ):
            rows += [wheels(bench, fault, count, late_ms), arm(bench, fault, count, held_ms)] if count else []
        machine = {"pty carriers": carriers.priority, "LeRobot": arguments.python or "the stand-in"}
    return report.end(rows, arguments.out, machine)


if __name__ == "__main__":
    sys.exit(main())
