"""`python -m bench.visit AMOUNTS`: one visit to one commit, for bench/beside.py; prints what it measured as JSON.

The commit is the one whose tree this runs in: service, simulated board and measures are its own. A commit that has no
such file gets this one, so it uses nothing but what the benches have long had.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import sys
import tempfile
from collections.abc import Callable, Iterator
from typing import Any

from bench import cost, hangs, kills, latency, report, stats
from bench.carriers import Carriers
from failstop.setup.ending import interruptible
from failstop_lab.trial import Trial

OPTIONS_TOML = "[restart]\ndeaths = 100000\nbackoff_s = 0.001\n"
"""So many kills are no crash loop here."""


@dataclasses.dataclass(frozen=True)
class Amounts:
    """How much of each is measured, and the seed of the random moments."""

    kills: int
    hangs: int
    samples: int
    seconds: float
    seed: int


def rows(trial: Trial, carriers: Carriers, much: Amounts, progress: Callable[[str], None]) -> list[stats.Row]:
    """The measures of a living service."""
    return [
        *cost.measure(trial, much.seconds, progress),
        latency.stop_requests(trial, much.samples, much.seed, progress),
        latency.first_commands(trial, much.samples, much.seed, progress),
        latency.direction_changes(trial, much.samples, much.seed, progress),
        latency.command_timeouts(trial, -(-much.samples // 4), much.seed, progress),
        *kills.measure(trial, much.kills, much.seed, progress, carriers),
        *hangs.measure(trial, much.hangs, much.seed, progress),
        hangs.replugs(trial, -(-much.kills // 2), much.seed, progress),
        latency.starts(trial, -(-much.samples // 10), progress),
    ]


@contextlib.contextmanager
def samples() -> Iterator[dict[str, list[float]]]:
    """The samples in ms of every row of times that is made inside, by its measure."""
    heard: dict[str, list[float]] = {}
    made = stats.timing

    def timing(measure: str, samples_ns: list[int], **bars: float | None) -> stats.Row:
        heard.setdefault(measure, []).extend(ns / 1e6 for ns in samples_ns)
        return made(measure, samples_ns, **bars)

    stats.timing = timing
    try:
        yield heard
    finally:
        stats.timing = made


def as_record(found: list[stats.Row], times: dict[str, list[float]]) -> dict[str, Any]:
    """The samples of a visit: measure -> samples in the row's unit, and measure -> (found, of) for what is counted."""
    values = {row.measure: ([row.numbers["value"]], row.numbers["unit"]) for row in found if "unit" in row.numbers}
    counts = {row.measure: (row.numbers["found"], row.numbers["of"]) for row in found if "found" in row.numbers}
    return {"values": {**values, **{measure: (ms, "ms") for measure, ms in times.items()}}, "counts": counts}


@interruptible()
def main() -> int:
    """Measure once, in a service of its own."""
    much = Amounts(**json.loads(sys.argv[1]))
    carriers = Carriers()
    with tempfile.NamedTemporaryFile("w", suffix=".toml") as config:
        config.write(OPTIONS_TOML)
        config.flush()
        with samples() as times, carriers, Trial(options=("--config", config.name)) as trial:
            found = rows(trial, carriers, much, report.progress)
    print(json.dumps(as_record(found, times)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
