"""`python -m bench.c_client`: the C client, judged at the board, in one run of some six minutes.

A C program is killed while it drives, again and again, as a small one and as one of 500 MB, whose memory the kernel
takes long to free. The next one commands at once, as a program does that is started again. After that, the time from
drive() to the first motor frame on the wire, by C and by Python in turn. The workers that carry a pty's bytes have the
priority of interrupt threads meanwhile (bench/carriers.py): at an ordinary one they wait for the end of a program of
500 MB, which no USB port does.
"""

from __future__ import annotations

import argparse
import mmap
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from types import TracebackType

from bench import BenchError, floor, report, stats
from bench.carriers import Carriers
from bench.report import progress
from failstop.policy.settings import FIRST_SOURCE
from failstop_lab.faults.crowd import c_program, c_unfit
from failstop_lab.faults.processes import AT_ONCE_MS
from failstop_lab.sim.client import Event, SimBoard
from failstop_lab.stopped import Stopped, judge
from failstop_lab.trial import Trial, write_settings

TIMEOUT_S = 0.1
"""How long a command counts here, so that the wheels are soon at rest again."""
REST_S = TIMEOUT_S + 0.05, TIMEOUT_S + 0.1
SMALL_MB, LARGE_MB = 2, 500
SPEED_MPS = 0.1
AGAIN_S = 0.08
"""How long the next program commands before it is given motion."""
SPREAD = 1.25
"""By how much the p99 of 300 samples, which its slowest three decide, may differ between two equal clients."""


class CClient:
    """The program of clients/c/tests/driver.c, connected. It notes in a shared word when it calls fs_drive()."""

    def __init__(self, name: str, megabytes: int = 0) -> None:
        """Returns while it still starts. `megabytes`: memory of its own."""
        fd = os.memfd_create("clock")
        os.ftruncate(fd, mmap.PAGESIZE)
        self._fd, self._clock = fd, mmap.mmap(fd, mmap.PAGESIZE)
        self._process = subprocess.Popen(
            (c_program(), str(megabytes)), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.pid = self._process.pid
        self._starts: tuple[str, ...] = (f"open {name} 0", "connect", f"clock /proc/{os.getpid()}/fd/{fd}")
        self.send(*self._starts)

    def __enter__(self) -> CClient:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._process.kill()
        self._process.communicate()
        self._clock.close()
        os.close(self._fd)

    def send(self, *lines: str) -> None:
        assert self._process.stdin
        self._process.stdin.write("".join(f"{line}\n" for line in lines))
        self._process.stdin.flush()

    def answer(self) -> str:
        """The next one, after those of the start. Raises BenchError when it could not connect."""
        assert self._process.stdout
        for line in self._starts:
            if (answer := self._process.stdout.readline().strip()) != "0":
                raise BenchError(f"the C client could not start: {line!r} returned {answer!r}")
        self._starts = ()
        return self._process.stdout.readline().strip()

    def ask(self, line: str) -> str:
        self.send(line)
        return self.answer()

    def drive_once(self) -> int:
        """Command once; returns when it called fs_drive() (CLOCK_MONOTONIC ns)."""
        self.ask(f"for 0.02 {SPEED_MPS}")
        return int.from_bytes(self._clock[:8], "little")


def killed(trial: Trial, client: CClient, following: CClient, chance: random.Random) -> Stopped:
    """Have it drive, kill it, and have the following one command; returns the board's view."""
    # The gate hears this zero before it grants the enable, so that nothing is held.
    client.ask("drive 0 0 0")
    trial.enable()
    client.send(f"for -1 {SPEED_MPS}")
    trial.board.wait_wheels(turning=True, timeout_s=5.0)
    time.sleep(chance.uniform(0.0, 0.04))
    trial.board.events()
    fault_ns = time.monotonic_ns()
    os.kill(client.pid, signal.SIGKILL)
    following.ask(f"for {AGAIN_S} {SPEED_MPS}")
    return judge(trial.board.events(), fault_ns, was_turning=True)


def kills(trial: Trial, times: int, megabytes: int, seed: int, carriers: Carriers) -> list[stats.Row]:
    """Rows of so many kills, with as many samples of the floor in between."""
    what = f"a C client of {megabytes} MB is killed"
    chance = random.Random(seed)
    found: list[Stopped] = []
    floors: list[int] = []
    with SimBoard(trial.link + "-floor", imu_hz=0) as bare, floor.Floor(bare) as least:
        client = CClient(trial.name, megabytes)
        for turn in range(times):
            progress(f"{what}, {turn + 1} of {times}")
            following = CClient(trial.name, megabytes)
            carriers.first()
            if turn % 4 == 0:
                floors.append(least.sample())
            with client:
                found.append(killed(trial, client, following, chance))
            client = following
        with client:
            client.ask("close")
    stops = [stopped.stop_ns for stopped in found if stopped.stop_ns is not None]
    beside = stats.timing(f"{what}: the floor, an idle C process", floors, p50_ms=None, p99_ms=None)
    row = stats.timing(f"{what} -> stop frame", stops, p50_ms=None, p99_ms=None)
    late = sum(stop_ns > AT_ONCE_MS * 1e6 for stop_ns in stops)
    row.result += f"  (p50 {row.numbers['p50_ms'] / beside.numbers['p50_ms']:.2f} x floor)"
    return [
        beside,
        row,
        stats.count(f"{what}: stops missed", len(found) - len(stops), len(found)),
        stats.count(f"{what}: stops later than {AT_ONCE_MS:g} ms", late, len(found)),
        stats.count(f"{what}: motion frames after the stop", sum(each.motion_after for each in found), len(found)),
    ]


def first_motion(trial: Trial, since_ns: int) -> int:
    """When the first motor frame that moves a wheel arrived, from a time on."""
    event: Event = trial.board.wait_for(lambda event: event.arrival_ns >= since_ns and event.is_motion, 5.0)
    return event.arrival_ns


def latency(trial: Trial, samples: int, seed: int) -> list[stats.Row]:
    """Rows of drive() to the first motor frame, by C and by Python in turn."""
    chance = random.Random(seed)
    found: dict[str, list[int]] = {"C": [], "Python": []}
    with CClient(trial.name) as client:
        client.ask("drive 0 0 0")
        trial.enable()
        for turn in range(2 * samples):
            who = ("C", "Python")[turn % 2]
            progress(f"drive() to frame, {turn + 1} of {2 * samples}")
            time.sleep(chance.uniform(*REST_S))
            trial.board.events()
            if who == "C":
                called_ns = client.drive_once()
            else:
                trial.robot.sensed()
                called_ns = time.monotonic_ns()
                trial.robot.drive(SPEED_MPS, 0.0, 0.0, wait_s=0)
            # Both have called by now, so a frame may be among what the board has told already.
            found[who].append(first_motion(trial, called_ns) - called_ns)
        client.ask("close")
    rows = {
        who: stats.timing(f"drive() -> motor frame, by {who}", given, p50_ms=None, p99_ms=None)
        for who, given in found.items()
    }
    c, python = rows["C"], rows["Python"]
    c.bar = f"p50 no slower than Python's, p99 no slower than {SPREAD:g} x Python's"
    numbers, others = c.numbers, python.numbers
    c.met = numbers["p50_ms"] <= others["p50_ms"] and numbers["p99_ms"] <= SPREAD * others["p99_ms"]
    return [python, c]


def main() -> int:
    """Measure; exit code 1 when a bar is missed."""
    parser = argparse.ArgumentParser(prog="python -m bench.c_client", description=__doc__)
    parser.add_argument("--kills", type=int, default=800, help=f"of a client of {SMALL_MB} MB (default: 800)")
    parser.add_argument("--large-kills", type=int, default=200, help=f"of one of {LARGE_MB} MB (default: 200)")
    parser.add_argument("--samples", type=int, default=300, help="of each latency (default: 300)")
    parser.add_argument("--seed", type=int, default=1, help="of the random moments")
    parser.add_argument("--out", help="a file for the numbers as JSON")
    arguments = parser.parse_args()
    if why := c_unfit():
        print(f"failstop: {why}", file=sys.stderr)
        return 1
    began_s = time.monotonic()
    rows: list[stats.Row] = []
    with tempfile.TemporaryDirectory(prefix="failstop-c-client-") as folder:
        config = os.path.join(folder, "settings.toml")
        write_settings(config, {f"sources.{FIRST_SOURCE}.timeout_s": TIMEOUT_S})
        with Carriers() as carriers, Trial(f"c-client-{os.getpid()}", ("--config", config)) as trial:
            realtime = all(process.realtime for process in trial.robot.state.processes.values())
            for part in (
                lambda: kills(trial, arguments.kills, SMALL_MB, arguments.seed, carriers),
                lambda: kills(trial, arguments.large_kills, LARGE_MB, arguments.seed, carriers),
                lambda: latency(trial, arguments.samples, arguments.seed),
            ):
                rows += report.whole(part)
    took_s = round(time.monotonic() - began_s)
    machine = {"realtime": realtime, "pty carriers": carriers.priority, "took_s": took_s}
    return report.end(rows, arguments.out, machine)


if __name__ == "__main__":
    sys.exit(main())
