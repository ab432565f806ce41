"""`python -m bench`: measure everything in one run, print the table, write it as JSON."""

from __future__ import annotations

import argparse
import os
import sys
import time

from bench import cost, hangs, kills, latency, oneway, peers, report, service
from bench.carriers import Carriers
from bench.report import progress
from bench.stats import Row
from failstop.trial import Trial

OPTIONS_TOML = "[restart]\ndeaths = 100000\nbackoff_s = 0.001\n"
"""So many kills are no crash loop here."""


def main() -> int:
    """Measure; exit code 1 when a bar is missed."""
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    parser.add_argument("--kills", type=int, default=200, help="of each process (default: 200)")
    parser.add_argument("--samples", type=int, default=200, help="of each latency (default: 200)")
    parser.add_argument("--hangs", type=int, default=20, help="of each process (default: 20)")
    parser.add_argument("--peer-kills", type=int, default=30, help="of each peer (default: 30)")
    parser.add_argument("--unit-kills", type=int, default=30, help="of the systemd unit, of each kind (default: 30)")
    parser.add_argument("--messages", type=int, default=3000, help="through each channel (default: 3000)")
    parser.add_argument("--seconds", type=float, default=20, help="of driving for processor and memory (default: 20)")
    parser.add_argument("--seed", type=int, default=1, help="of the random moments")
    parser.add_argument("--out", default="bench/out/bench.json", help="where the JSON goes")
    arguments = parser.parse_args()
    os.makedirs(os.path.dirname(arguments.out) or ".", exist_ok=True)
    config = arguments.out + ".toml"
    with open(config, "w", encoding="utf-8") as file:
        file.write(OPTIONS_TOML)
    rows: list[Row] = []
    start_s = time.monotonic()
    carriers = Carriers()
    with carriers, Trial(options=("--config", config)) as trial:
        realtime = all(process.realtime for process in trial.robot.state.processes.values())
        rows += cost.measure(trial, arguments.seconds, progress)
        rows.append(latency.stop_requests(trial, arguments.samples, arguments.seed, progress))
        rows.append(latency.first_commands(trial, arguments.samples, arguments.seed, progress))
        rows.append(latency.direction_changes(trial, arguments.samples, arguments.seed, progress))
        rows.append(latency.command_timeouts(trial, max(3, arguments.samples // 4), arguments.seed, progress))
        rows += kills.measure(trial, arguments.kills, arguments.seed, progress, carriers)
        rows += hangs.measure(trial, arguments.hangs, arguments.seed, progress)
        rows.append(hangs.replugs(trial, arguments.kills // 2, arguments.seed, progress))
        rows.append(latency.starts(trial, max(3, arguments.samples // 10), progress))
    with carriers, kills.heavy(), Trial(options=("--config", config)) as trial:
        quarter = arguments.kills // 4
        rows += kills.measure(trial, quarter, arguments.seed, progress, carriers, ballast_mb=kills.BALLAST_MB)
    rows += service.measure(arguments.unit_kills, arguments.seed, progress)
    rows += peers.measure(arguments.peer_kills, arguments.seed, progress)
    rows += oneway.measure(arguments.messages, progress)
    machine = {"realtime": realtime, "pty carriers": carriers.priority, "took_s": round(time.monotonic() - start_s)}
    return report.end(rows, arguments.out, machine)


if __name__ == "__main__":
    sys.exit(main())
