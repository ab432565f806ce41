"""Peers: the SIGKILL of the driving process to the stop frame, with failstop and with what a user would pick instead.

One kind of simulated board judges all of them. The peers run as users run them, without SCHED_FIFO; failstop takes it
where it is allowed to, as it does on a robot. Every peer is given its easiest case: the smallest driver there is, which
is killed alone, and the port at hand.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import signal
import sys
import tempfile
import time
from collections.abc import Callable

from bench import BenchError, report, stats
from bench.peer import ExitHandler, Peer, PeerMissing
from bench.peer_supervisord import BusySupervisord, Supervisord
from bench.peer_systemd import Systemd
from failstop.messages import layout
from failstop.setup.ending import interruptible
from failstop_lab.sim.client import SimBoard
from failstop_lab.trial import Stopped, Trial, judge

PEERS: tuple[type[Peer], ...] = (ExitHandler, Supervisord, BusySupervisord, Systemd)
OURS = (layout.GATE, layout.PORT_OWNER)
"""A driver's job is divided here: one process decides, the other has the port."""
TIMES_SOONER = 20.0
STOP_S = 15.0
OPTIONS_TOML = "[restart]\ndeaths = 100000\nbackoff_s = 0.001\n"
"""So many kills are no crash loop here."""


class PeerFailed(BenchError):
    """A peer did not do what it is there for; says what was seen."""


def measure(kills: int, seed: int, progress: Callable[[str], None]) -> list[stats.Row]:
    """Kill the driving process of failstop, and of each peer that can be had here, `kills` times."""
    chance = random.Random(seed)
    ours = _ours(kills, chance, progress)
    theirs, missing = _theirs(kills, chance, progress)
    return rows_of(ours, theirs, missing)


def _ours(kills: int, chance: random.Random, progress: Callable[[str], None]) -> dict[str, list[int]]:
    found: dict[str, list[int]] = {process: [] for process in OURS}
    with tempfile.NamedTemporaryFile("w", prefix="failstop-bench-", suffix=".toml") as config:
        config.write(OPTIONS_TOML)
        config.flush()
        with Trial(options=("--config", config.name)) as trial:
            for turn in range(kills):
                progress(f"failstop beside its peers, round {turn + 1} of {kills}")
                for process in OURS:
                    trial.enable()
                    pid = trial.service.pids()[process]
                    stopped = trial.kill(process, chance.uniform(0.1, 0.2))
                    found[process].append(checked_ns(f"failstop, {process} killed", stopped))
                    trial.recover(process, pid)
    return found


def _theirs(
    kills: int, chance: random.Random, progress: Callable[[str], None]
) -> tuple[dict[str, list[int]], dict[str, str]]:
    """The peers' samples, and the reason for each that cannot be had."""
    found: dict[str, list[int]] = {}
    missing: dict[str, str] = {}
    with contextlib.ExitStack() as stack:
        directory = stack.enter_context(tempfile.TemporaryDirectory(prefix="failstop-"))
        board = stack.enter_context(SimBoard(os.path.join(directory, "board")))
        peers: list[Peer] = []
        for make in PEERS:
            try:
                peer = make(board.link)
            except PeerMissing as reason:
                missing[make.label] = str(reason)
                continue
            stack.callback(peer.close)
            peers.append(peer)
        for turn in range(kills):
            for peer in peers:
                progress(f"peers, round {turn + 1} of {kills}: {peer.label}")
                found.setdefault(peer.label, []).append(sample(peer, board, chance.uniform(0.1, 0.2)))
    return found, missing


def sample(peer: Peer, board: SimBoard, drive_s: float) -> int:
    """Let a peer's driver turn the wheels for `drive_s`, kill it; returns ns to the first stop that was executed."""
    pid = peer.start()
    board.wait_wheels(True, STOP_S)
    time.sleep(drive_s)
    moving = any(board.wheels())
    board.events()
    killed_ns = time.monotonic_ns()
    os.kill(pid, signal.SIGKILL)
    try:
        board.wait_for(lambda event: event.is_stop and event.arrival_ns >= killed_ns, STOP_S)
    except TimeoutError as error:
        raise PeerFailed(f"{peer.label}: no stop within {STOP_S:g} s of the kill: {error}") from None
    peer.settle()
    return checked_ns(peer.label, judge(board.events(), killed_ns, moving))


def checked_ns(label: str, stopped: Stopped) -> int:
    """A sample counts only if the wheels turned before, and the stop came and held."""
    if stopped.stop_ns is None or stopped.motion_after or not stopped.was_turning:
        raise PeerFailed(f"{label}: this was no stop of turning wheels: {stopped}")
    return stopped.stop_ns


def rows_of(ours: dict[str, list[int]], theirs: dict[str, list[int]], missing: dict[str, str]) -> list[stats.Row]:
    """Rows of failstop, of each peer, of each that is missing, and the verdict."""
    rows = [
        stats.timing(f"failstop: kill {key} -> stop frame", row, p50_ms=None, p99_ms=None) for key, row in ours.items()
    ]
    peers = [stats.timing(f"{label} -> stop frame", row, p50_ms=None, p99_ms=None) for label, row in theirs.items()]
    skipped = [stats.Row(label, f"skipped: {why}", "-", None, {"skipped": why}) for label, why in missing.items()]
    return [*rows, *peers, *skipped, *_verdict(rows, peers)]


def _verdict(ours: list[stats.Row], peers: list[stats.Row]) -> list[stats.Row]:
    """failstop's slower p50 against the fastest peer's; nothing when there is no peer to compare with."""
    if not peers:
        return []
    best = min(peers, key=lambda row: float(row.numbers["p50_ms"]))
    times = best.numbers["p50_ms"] / max(row.numbers["p50_ms"] for row in ours)
    numbers = {"times": times, "best_peer": best.measure}
    result = f"{times:.0f} x sooner than: {best.measure}"
    bar = f">= {TIMES_SOONER:g} x sooner (p50)"
    return [stats.Row("failstop against the fastest peer", result, bar, times >= TIMES_SOONER, numbers)]


@interruptible()
def main() -> int:
    """Measure alone and print the rows; exit code 1 when the bar is missed."""
    parser = argparse.ArgumentParser(prog="python -m bench.peers", description=__doc__)
    parser.add_argument("--kills", type=int, default=20, help="of each process (default: 20)")
    parser.add_argument("--seed", type=int, default=1, help="of the random moments")
    arguments = parser.parse_args()
    rows = measure(arguments.kills, arguments.seed, report.progress)
    return report.end(rows)


if __name__ == "__main__":
    sys.exit(main())
