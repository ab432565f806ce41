"""The arm: `python -m bench.arm`. The simulated board's servos say when they moved, and when they stand."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from itertools import pairwise

from bench import report, stats
from bench.report import progress
from bench.stats import Row
from failstop.api.errors import Refused
from failstop.board.framing import BUS_SERVO
from failstop.board.servos import MOVE
from failstop.lab.faults import arm
from failstop.lab.faults.arm import ArmTrial
from failstop.procs.gate.arm.joints import PULSES_PER_RAD

KILL_P99_MS = 2.0
"""Of the bench's kill rows: 2 x the floor, some 1 ms on a quiet machine."""
BUS_MS = 2.0
FOLLOW_RADPS = 0.3


def rests(trial: ArmTrial, count: int, say: Callable[[str], None]) -> list[Row]:
    """The arm's fault rows but for hangs, each `count` times: to the arm's stop, and until every joint stands."""
    rows = []
    for fault in arm.ROWS:
        if fault.what not in (arm.KILL, arm.CLIENT_KILL, arm.REQUEST, arm.HANG):
            continue
        times = count if fault.what != arm.HANG else max(1, count // 5)
        stops, stands, wrong = [], [], []
        for turn in range(times):
            say(f"{fault.name}, {turn + 1} of {times}")
            found = arm.strike(trial, fault)
            stands.append(round(found.rest_ms * 1e6))
            stops += [round(found.stop_ms * 1e6)] if found.stop_ms is not None else []
            wrong += [found.wrong] if found.wrong else []
        rest = stats.timing(f"{fault.cause} -> every joint stands", stands, p50_ms=None, p99_ms=fault.bar_ms)
        rows.append(rest)
        if fault.what == arm.KILL:
            bar_ms = KILL_P99_MS + BUS_MS
            rows.append(stats.timing(f"{fault.cause} -> the arm's stop", stops, p50_ms=None, p99_ms=bar_ms))
        rows.append(stats.count(f"{fault.cause}: not as the row says", len(wrong), times))
        rows[-1].result += f" {wrong}" if wrong else ""
    return rows


def stream(trial: ArmTrial, seconds: float, say: Callable[[str], None]) -> list[Row]:
    """Jitter of the stream with all six joints, and the speed that follow reaches."""
    say("the stream")
    trial.follow(0.5)
    mark = trial.board.info()["executed"]
    time.sleep(seconds)
    events = [event for event in trial.board.events(mark) if event.func == BUS_SERVO and event.data[0] == MOVE]
    times: dict[int, list[int]] = {}
    for event in events:
        times.setdefault(event.data[4], []).append(event.arrival_ns)
    off = [abs(b - a - 40_000_000) for found in times.values() for a, b in pairwise(found)]
    trial.settle()
    rows = [stats.timing("streaming jitter at 25 Hz, six joints: off the period", off, p50_ms=None, p99_ms=5.0)]
    say("follow")
    trial.robot.arm.move({"base": 0.8})
    begun = time.monotonic()
    legs = trial.board.joint_legs()
    while (t := time.monotonic() - begun) < 4.0:
        trial.robot.arm.follow({"base": 0.8 - FOLLOW_RADPS * t})
        time.sleep(0.02)
    track = [leg for leg in trial.board.joint_track(legs) if leg.servo == 1 and leg.end_ns > leg.begin_ns]
    first, last = track[len(track) // 4], track[-2]
    reached = (first.begin - last.begin) / PULSES_PER_RAD / ((last.begin_ns - first.begin_ns) * 1e-9)
    trial.settle()
    off_by = reached / FOLLOW_RADPS - 1
    told = f"{reached:.4f} rad/s ({off_by:+.1%})"
    return [
        *rows,
        Row("follow at 0.3 rad/s: reached speed", told, "within 2 %", abs(off_by) <= 0.02, {"radps": reached}),
    ]


def absent(name: str, say: Callable[[str], None]) -> Row:
    """An arm in the settings, and no servo answers: a refusal that says what to do, and wheels with the setting."""
    said = []
    for setting in ("refuse", "ignore"):
        say(f"absent, {setting}")
        with ArmTrial(f"{name}-{setting}", {"arm.absent": setting}) as trial:
            for servo in (1, 2, 3, 4, 5, 10):
                trial.board.servo(servo, silent=True)
            try:
                trial.robot.enable()
                trial.drive(0.3)
                said.append("wheels turn" if trial.moving() else "wheels stand")
            except Refused as error:
                said.append("refused" if "arm.absent" in str(error) else str(error))
    measure = "arm in the settings but absent: one refusal, then wheels with the setting"
    return Row(measure, ", ".join(said), "refused, wheels turn", said == ["refused", "wheels turn"], {"said": said})


def main() -> int:
    """Measure; exit code 1 when a bar is missed."""
    parser = argparse.ArgumentParser(prog="python -m bench.arm", description=__doc__)
    parser.add_argument("--count", type=int, default=40, help="of each fault; hangs a fifth of it (default: 40)")
    parser.add_argument("--seconds", type=float, default=20, help="of streaming (default: 20)")
    parser.add_argument("--out", default="bench/out/arm.json", help="where the JSON goes")
    arguments = parser.parse_args()
    start_s = time.monotonic()
    with ArmTrial("bench-arm") as trial:
        rows = stream(trial, arguments.seconds, progress)
        rows += rests(trial, arguments.count, progress)
    rows.append(absent("bench-arm-absent", progress))
    return report.end(rows, arguments.out, {"took_s": round(time.monotonic() - start_s)})


if __name__ == "__main__":
    sys.exit(main())
