"""One way: 64 bytes from one process to another at 1 kHz, with failstop's ring and bell and with its peers.

Every channel has a sender that is paced and a receiver that blocks, each on a core of its own and both under SCHED_FIFO
where that is allowed. The channels take turns every few messages, so that noise hits all alike.

Measured twice: on the machine as it is, where most of the time is that of waking a core that sleeps, and with the cores
kept awake, which leaves what the channel itself costs.
"""

from __future__ import annotations

import argparse
import array
import contextlib
import os
import select
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from types import TracebackType

import numpy as np

from bench import BenchError, report, stats
from bench.oneway_pair import COUNT_BYTES, MISSING, READY
from bench.oneway_peer import CHANNELS, FLOOR, OURS
from bench.peer import ROOT
from failstop.setup.ending import interruptible

LOT = 50
"""Messages that a channel sends in its turn."""
WARM_UP = 5
"""Messages before them that do not count: the channel's turn before was long ago."""
TIMES_PEER = 1.1
AWAKE = ", cores kept awake"
_SPIN = """
import os
os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
parent = os.getppid()
while os.getppid() == parent:
    sum(range(10000))
"""
ANSWER_S = 20.0


class PairFailed(BenchError):
    """A pair of processes did not measure; says what it said."""


class PairMissing(Exception):
    """The channel cannot be had here; says what it needs."""


class Pair:
    """A context manager: the two processes of a channel (oneway_pair.py). Raises PairMissing, PairFailed."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._process = subprocess.Popen(
            [sys.executable, "-m", "bench.oneway_pair", name],
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        try:
            self._read(len(READY))
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Pair:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def send(self, messages: int) -> list[int]:
        """Send a lot; returns the latencies in ns of all that arrived."""
        assert self._process.stdin is not None
        self._process.stdin.write(b"%d\n" % messages)
        self._process.stdin.flush()
        arrived = int.from_bytes(self._read(COUNT_BYTES), "little")
        return array.array("Q", self._read(8 * arrived)).tolist()

    def _read(self, size: int) -> bytes:
        """That many bytes of what it says."""
        assert self._process.stdout is not None
        out = self._process.stdout.fileno()
        until_s = time.monotonic() + ANSWER_S
        taken = b""
        while len(taken) < size:
            left_s = until_s - time.monotonic()
            if left_s <= 0 or not select.select((out,), (), (), left_s)[0]:
                raise PairFailed(f"{self.name}: no answer within {ANSWER_S:g} s")
            if not (data := os.read(out, size - len(taken))):
                self._failed()
            taken += data
        return taken

    def _failed(self) -> None:
        """It has ended: say why."""
        assert self._process.stderr is not None
        said = self._process.stderr.read().decode(errors="replace").strip()
        code = self._process.wait(ANSWER_S)
        if code == MISSING:
            raise PairMissing(said)
        raise PairFailed(f"{self.name}: exit code {code}: {said}")

    def close(self) -> None:
        """End both processes; the first takes away what the channel left."""
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        with contextlib.suppress(BrokenPipeError):
            process.stdin.close()
        try:
            process.wait(ANSWER_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()
        process.stderr.close()


@contextlib.contextmanager
def awake() -> Iterator[None]:
    """Keep every core from sleeping, with a process each that runs only when nothing else wants to."""
    with contextlib.ExitStack() as stack:
        for core in os.sched_getaffinity(0):
            spinner = subprocess.Popen([sys.executable, "-I", "-S", "-c", _SPIN], stdin=subprocess.DEVNULL)
            stack.callback(spinner.wait)
            stack.callback(spinner.kill)
            os.sched_setaffinity(spinner.pid, {core})
        yield


def measure(messages: int, progress: Callable[[str], None]) -> list[stats.Row]:
    """Send at least `messages` through every channel that can be had here, and as many with the cores awake."""
    lots = -(-messages // LOT)
    missing: dict[str, str] = {}
    with contextlib.ExitStack() as stack:
        pairs: list[Pair] = []
        for name in CHANNELS:
            progress(f"one way, start: {name}")
            try:
                pairs.append(stack.enter_context(Pair(name)))
            except PairMissing as reason:
                missing[name] = str(reason)
        asleep = _in_turns(pairs, lots, progress)
        with awake():
            kept_awake = _in_turns(pairs, lots, progress)
    rows = judged(asleep)
    rows += [row_of(name, samples, AWAKE) for name, samples in kept_awake.items()]
    return rows + [
        stats.Row(_measure(name), f"skipped: {why}", "-", None, {"skipped": why}) for name, why in missing.items()
    ]


def _in_turns(pairs: list[Pair], lots: int, progress: Callable[[str], None]) -> dict[str, list[int]]:
    """The latencies in ns of each pair."""
    taken: dict[str, list[int]] = {pair.name: [] for pair in pairs}
    for lot in range(lots):
        progress(f"one way, lot {lot + 1} of {lots}")
        for pair in pairs:
            taken[pair.name] += pair.send(WARM_UP + LOT)[WARM_UP:]
    return taken


def judged(taken: dict[str, list[int]]) -> list[stats.Row]:
    """The rows, failstop's with its bar."""
    rows = {name: row_of(name, samples) for name, samples in taken.items()}
    peers = {name: row.numbers["p50_us"] for name, row in rows.items() if name not in (OURS, FLOOR)}
    best = min(peers, key=lambda name: peers[name])
    ours = rows[OURS]
    times = ours.numbers["p50_us"] / peers[best]
    ours.result += f"  ({times:.2f} x {best})"
    ours.bar, ours.met = f"p50 <= {TIMES_PEER:g} x the fastest peer", times <= TIMES_PEER
    ours.numbers.update(times=times, best_peer=best)
    return list(rows.values())


def _measure(name: str, condition: str = "") -> str:
    return f"one way, 64 bytes at 1 kHz{condition}: {name}" + (" (the floor)" if name == FLOOR else "")


def row_of(name: str, samples: list[int], condition: str = "") -> stats.Row:
    """Row of one transport; `condition`: words about the receiver."""
    p50, p99 = (float(value) for value in np.percentile(np.array(samples) / 1e3, (50, 99), method=stats.NEAREST))
    numbers = {"p50_us": p50, "p99_us": p99, "max_us": max(samples) / 1e3, "samples": len(samples)}
    return stats.Row(_measure(name, condition), f"p50 {p50:.1f}  p99 {p99:.1f} us", "-", None, numbers)


@interruptible()
def main() -> int:
    """Measure alone and print the rows; exit code 1 when the bar is missed."""
    parser = argparse.ArgumentParser(prog="python -m bench.oneway", description=__doc__)
    parser.add_argument("--messages", type=int, default=3000, help="through each channel (default: 3000)")
    arguments = parser.parse_args()
    rows = measure(arguments.messages, report.progress)
    return report.end(rows)


if __name__ == "__main__":
    sys.exit(main())
