"""`python -m bench`: measure everything in one run, print the table, write it as JSON.

With --beside REF: only what is measured of one living service, here and at another commit in turn.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from typing import Any

from bench import arm, beside, kills, oneway, peers, report, service, visit
from bench.carriers import Carriers
from bench.report import progress
from bench.stats import Row
from failstop.setup.ending import interruptible
from failstop_lab.faults import report as campaigns
from failstop_lab.trial import Trial


@interruptible()
def main() -> int:
    """Measure; exit code 1 when a bar is missed."""
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    parser.add_argument("--kills", type=int, default=200, help="of each process (default: 200)")
    parser.add_argument("--samples", type=int, default=200, help="of each latency (default: 200)")
    parser.add_argument("--hangs", type=int, default=20, help="of each process (default: 20)")
    parser.add_argument("--peer-kills", type=int, default=30, help="of each peer (default: 30)")
    parser.add_argument("--unit-kills", type=int, default=30, help="of the systemd unit, of each kind (default: 30)")
    parser.add_argument("--arm-faults", type=int, default=40, help="of each fault of the arm's (default: 40)")
    parser.add_argument("--messages", type=int, default=3000, help="through each channel (default: 3000)")
    parser.add_argument("--seconds", type=float, default=20, help="of driving for processor and memory (default: 20)")
    parser.add_argument("--seed", type=int, default=1, help="of the random moments")
    parser.add_argument("--out", help="where the JSON goes (default: bench/out/bench.json, or beside.json there)")
    parser.add_argument("--beside", metavar="REF", help="this tree beside another commit instead: what became slower?")
    parser.add_argument("--rounds", type=int, default=10, help="visits to each commit (default: 10)")
    parser.add_argument("--margin", type=float, default=0.1, help="what is slower by less is not (default: 0.1)")
    arguments = parser.parse_args()
    much = visit.Amounts(arguments.kills, arguments.hangs, arguments.samples, arguments.seconds, arguments.seed)
    if arguments.beside:
        out = arguments.out or "bench/out/beside.json"
        return beside.main(arguments.beside, much, arguments.rounds, arguments.margin, out)
    arguments.out = arguments.out or "bench/out/bench.json"
    os.makedirs(os.path.dirname(arguments.out) or ".", exist_ok=True)
    config = arguments.out + ".toml"
    with open(config, "w", encoding="utf-8") as file:
        file.write(visit.OPTIONS_TOML)
    rows: list[Row] = []
    # Of the beginning: somebody may commit while it runs.
    known: dict[str, Any] = {"commit": campaigns.commit(), "command": " ".join(("python -m bench", *sys.argv[1:]))}
    start_s, ticks = time.monotonic(), campaigns.processor_ticks()
    carriers = Carriers()
    with carriers, Trial(options=("--config", config)) as trial:
        realtime = all(process.realtime for process in trial.robot.state.processes.values())
        rows += visit.rows(trial, carriers, much, progress)

    def heavy() -> list[Row]:
        with carriers, kills.heavy(), Trial(options=("--config", config)) as trial:
            quarter = arguments.kills // 4
            return kills.measure(trial, quarter, arguments.seed, progress, carriers, ballast_mb=kills.BALLAST_MB)

    def arms() -> list[Row]:
        with carriers:
            return arm.measure(arguments.arm_faults, arguments.seconds, arguments.seed, carriers, progress)

    for part in (
        heavy,
        arms,
        lambda: service.measure(arguments.unit_kills, arguments.seed, progress),
        lambda: peers.measure(arguments.peer_kills, arguments.seed, progress),
        lambda: oneway.measure(arguments.messages, progress),
    ):
        rows += report.whole(part)
    known |= {"realtime": realtime, "pty carriers": carriers.priority, "took_s": round(time.monotonic() - start_s)}
    return report.end(rows, arguments.out, {**known, "steal": campaigns.stolen_share(ticks)})


if __name__ == "__main__":
    sys.exit(main())
