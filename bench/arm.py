"""The arm: `python -m bench.arm`. The simulated board's servos say when they moved, and when they stand."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable

from bench import arm_kills, arm_stream, report, stats
from bench.carriers import Carriers
from bench.report import progress
from bench.stats import Row
from failstop.api.errors import Refused
from failstop.setup.ending import interruptible
from failstop_lab.faults import arm
from failstop_lab.faults.arm import JOINTS, ArmTrial
from failstop_lab.faults.arm_table import CLIENT_KILL, KILL, ROWS, SERVO_FAULT, STOP_REQUEST

SELDOM = 5
"""Hangs take long: a share of the count."""


def rests(trial: ArmTrial, count: int, carriers: Carriers, say: Callable[[str], None]) -> list[Row]:
    """The arm's other fault rows: until every joint stands."""
    rows = []
    for fault in ROWS:
        if fault.what in (KILL, SERVO_FAULT):
            continue
        times = count if fault.what in (CLIENT_KILL, STOP_REQUEST) else max(1, count // SELDOM)
        stands, wrong = [], []
        for turn in range(times):
            say(f"{fault.name}, {turn + 1} of {times}")
            carriers.first()
            found = arm.strike(trial, fault)
            stands += [round(found.rest_ms * 1e6)] if found.rest_ms is not None else []
            wrong += [found.wrong] if found.wrong else []
        rows.append(stats.timing(f"{fault.cause} -> every joint stands", stands, p50_ms=None, p99_ms=fault.bar_ms))
        rows.append(stats.count(f"{fault.cause}: not as its row says", len(wrong), times))
        rows[-1].result += f" {wrong}" if wrong else ""
    return rows


def absent(name: str, say: Callable[[str], None]) -> Row:
    """An arm in the settings, and no servo answers: a refusal that says what to do, and wheels with the setting."""
    said = []
    for setting in ("refuse", "ignore"):
        say(f"absent, {setting}")
        with ArmTrial(f"{name}-{setting}", {"arm.absent": setting}) as trial:
            for servo, _, _ in JOINTS.values():
                trial.board.servo(servo, silent=True)
            try:
                trial.robot.enable()
                trial.drive(0.3)
                said.append("wheels turn" if trial.turning() else "wheels stand")
            except Refused as error:
                said.append("refused" if "arm.absent" in str(error) else str(error))
    measure = "arm in the settings but absent: one refusal, then wheels with the setting"
    return Row(measure, ", ".join(said), "refused, wheels turn", said == ["refused", "wheels turn"], {"said": said})


def measure(count: int, seconds: float, seed: int, carriers: Carriers, say: Callable[[str], None]) -> list[Row]:
    """Everything."""
    with ArmTrial("bench-arm") as trial:
        rows = arm_stream.measure(trial, seconds, carriers, say)
        rows += arm_kills.measure(trial, count, seed, carriers, say)
        rows += rests(trial, count, carriers, say)
    return [*rows, absent("bench-arm-absent", say)]


@interruptible()
def main() -> int:
    """Measure; exit code 1 when a bar is missed."""
    parser = argparse.ArgumentParser(prog="python -m bench.arm", description=__doc__)
    parser.add_argument("--count", type=int, default=40, help="of each fault; hangs a fifth of it (default: 40)")
    parser.add_argument("--seconds", type=float, default=20, help="of streaming (default: 20)")
    parser.add_argument("--seed", type=int, default=1, help="of the random moments")
    parser.add_argument("--out", default="bench/out/arm.json", help="where the JSON goes")
    arguments = parser.parse_args()
    start_s = time.monotonic()
    with Carriers() as carriers:
        rows = measure(arguments.count, arguments.seconds, arguments.seed, carriers, progress)
        machine = {"pty carriers": carriers.priority, "took_s": round(time.monotonic() - start_s)}
    return report.end(rows, arguments.out, machine)


if __name__ == "__main__":
    sys.exit(main())
