"""The C client beside Python's, in one run on one service: `python -m bench.c_client`. From drive() after a pause to
the first motor frame on the wire, in turn by one and the other."""

from __future__ import annotations

import argparse
import json
import mmap
import os
import random
import subprocess
import sys
import tempfile
import time
from types import TracebackType

from bench import BenchError, stats
from bench.report import progress
from failstop_lab.faults.crowd import c_program, c_unfit
from failstop_lab.trial import Trial


class CClient:
    """The program of clients/c/tests/driver.c, which notes in a shared word when it calls fs_drive()."""

    def __init__(self, name: str) -> None:
        with tempfile.NamedTemporaryFile() as clock:
            clock.truncate(8)
            self._clock = mmap.mmap(clock.fileno(), 8)
            self._process = subprocess.Popen(
                (c_program(), "0"), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
            if [self.ask(line) for line in (f"open {name} 0", "connect", f"clock {clock.name}")] != ["0"] * 3:
                raise BenchError("the C client could not connect")

    def __enter__(self) -> CClient:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.ask("close")
        self._process.kill()
        self._process.communicate()

    def ask(self, line: str) -> str:
        assert self._process.stdin
        assert self._process.stdout
        self._process.stdin.write(f"{line}\n")
        self._process.stdin.flush()
        return self._process.stdout.readline().strip()

    def drive_once(self) -> int:
        """Command once; returns when it called fs_drive() (CLOCK_MONOTONIC ns)."""
        self.ask("for 0.02 0.1")
        return int.from_bytes(self._clock[:8], "little")


def measured(trial: Trial, client: CClient, samples: int, seed: int) -> dict[str, list[int]]:
    """The latencies of both, in ns."""
    chance = random.Random(seed)
    found: dict[str, list[int]] = {"C": [], "Python": []}
    trial.enable()
    for turn in range(2 * samples):
        who = ("C", "Python")[turn % 2]
        progress(f"drive() to frame, {turn + 1} of {2 * samples}")
        time.sleep(chance.uniform(0.36, 0.40))
        trial.board.events()
        if who == "C":
            called_ns = client.drive_once()
        else:
            trial.robot.sensed()
            called_ns = time.monotonic_ns()
            trial.robot.drive(0.1, 0.0, 0.0, wait_s=0)
        # Both have called by now, so a frame may be among what the board has told already.
        event = trial.board.wait_for(lambda found, since=called_ns: found.arrival_ns >= since and found.is_motion, 5.0)  # type: ignore[misc]
        found[who].append(event.arrival_ns - called_ns)
    return found


def main() -> int:
    """Print both; exit code 1 if C is slower."""
    parser = argparse.ArgumentParser(description="The C client beside Python's.")
    parser.add_argument("--samples", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    if why := c_unfit():
        print(f"failstop: {why}", file=sys.stderr)
        return 1
    with Trial(f"c-client-{os.getpid()}") as trial, CClient(trial.name) as client:
        found = measured(trial, client, arguments.samples, arguments.seed)
    rows = {
        who: stats.timing(f"drive() -> motor frame, by {who}", given, p50_ms=None, p99_ms=None)
        for who, given in found.items()
    }
    for row in rows.values():
        print(f"{row.measure}: {row.result}")
    print(json.dumps({who: row.numbers for who, row in rows.items()}))
    return int(rows["C"].numbers["p50_ms"] > rows["Python"].numbers["p50_ms"])


if __name__ == "__main__":
    sys.exit(main())
