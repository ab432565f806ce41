"""`python -m bench.soak`: drive for a long time and see that nothing wears out: ticks in time, no IMU frame lost,
memory flat, no stop that nobody asked for. With --load on a busy machine, with --no-realtime without SCHED_FIFO.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import os
import random
import sys
import time
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import psutil

from bench import conditions, report, stalls, stats, ticks
from failstop.api.client import attach
from failstop.api.errors import FailstopError
from failstop.messages import layout, records
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.policy.settings import Settings
from failstop.setup.ending import interruptible
from failstop.shm.cell import LatestReader
from failstop_lab.sim.client import Event
from failstop_lab.trial import Trial, wait_for

LATE_MS = 10.0
GROWTH_MB_H = 1.0
SPEED_MPS = 0.2
TURN_BACK_MPS = 0.14
"""The direction changes here, so that the ramp never ends."""
COMMAND_S = (0.015, 0.025)
FETCH_S = 5.0
SAMPLE_S = 20.0
WARM_S = 60.0
LEAST_S = 60.0
"""A slope over less than this says nothing."""
RECOVER_S = 10.0
LOOK_BACK_NS = 300_000_000
"""The cause of a stop lies at most this far back: the longest of the deadlines, and some."""
SILENCE = (causes.HANGS, causes.STARVED, causes.HELD_UP, causes.MUTE, causes.SILENT)
EXPLAINS_MS = 30.0
"""A stall of half the shortest deadline, beside a tick of a third of it and work that it held up, is a process that is
silent for too long."""


# The drive.


@dataclasses.dataclass
class Soak:
    """The findings of a drive."""

    seconds: float = 0.0
    commanded_ns: list[int] = dataclasses.field(default_factory=list)
    events: list[Event] = dataclasses.field(default_factory=list)
    stops: list[tuple[float, Cause]] = dataclasses.field(default_factory=list)
    """Stops that nobody asked for: seconds since the start, the reason."""
    caused_ns: list[int] = dataclasses.field(default_factory=list)
    """When the cause of each such stop was noticed (CLOCK_MONOTONIC)."""
    memory: list[dict[str, tuple[float, float]]] = dataclasses.field(default_factory=list)
    """At each sample, what _memory_mb() returned for each process."""
    sampled_s: list[float] = dataclasses.field(default_factory=list)
    cpu_percent: dict[str, float] = dataclasses.field(default_factory=dict)
    imu_sent: int = 0
    imu_decoded: int = 0
    worst_ms: dict[str, float] = dataclasses.field(default_factory=dict)
    restarts: int = 0


class Driver:
    """The client that drives and keeps the accounts."""

    def __init__(self, trial: Trial, seed: int) -> None:
        self._trial = trial
        self._chance = random.Random(seed)
        self._epoch = attach(trial.name, layout.SUPERVISOR).word("epoch")
        self._cause: LatestReader = attach(trial.name, layout.SUPERVISOR).latest_reader("latch")
        self._imu: LatestReader = attach(trial.name, layout.TELEMETRY).latest_reader("imu")
        self._known_epoch = 0
        self._start_s = 0.0
        self._direction = 1.0
        self.soak = Soak()

    def drive(self, seconds: float, progress: Callable[[str], None]) -> Soak:
        """Drive for so long. Raises FailstopError when the service cannot be enabled again after a false stop."""
        trial, soak = self._trial, self.soak
        trial.enable()
        self._known_epoch = self._epoch.get()
        trial.board.events()
        sent, decoded = self._imu_counts()
        cpu = self._cpu_s()
        self._start_s = now_s = time.monotonic()
        fetch_s = sample_s = self._start_s
        end_s = self._start_s + seconds
        while now_s < end_s:
            self._command()
            if self._epoch.get() != self._known_epoch:
                self._false_stop()
            if now_s >= fetch_s:
                fetch_s += FETCH_S
                soak.events += (event for event in trial.board.events() if event.is_motor)
                progress(f"driving, {(end_s - now_s) / 60:.1f} min to go, {len(soak.stops)} false stops")
            if now_s >= sample_s:
                sample_s += SAMPLE_S
                self._sample(now_s)
            time.sleep(self._chance.uniform(*COMMAND_S))
            now_s = time.monotonic()
        soak.seconds = now_s - self._start_s
        soak.events += (event for event in trial.board.events() if event.is_motor)
        self._sample(now_s)
        soak.cpu_percent = {name: 100 * (s - cpu.get(name, 0.0)) / soak.seconds for name, s in self._cpu_s().items()}
        self._end(sent, decoded)
        return soak

    def _end(self, sent: int, decoded: int) -> None:
        soak, trial = self.soak, self._trial
        trial.robot.disable()
        sent_now, decoded_now = self._imu_counts()
        soak.imu_sent, soak.imu_decoded = sent_now - sent, decoded_now - decoded
        processes = trial.robot.state.processes
        soak.worst_ms = {name: process.worst_s * 1e3 for name, process in processes.items()}
        soak.restarts = sum(process.restarts for process in processes.values())

    def _command(self) -> None:
        robot = self._trial.robot
        velocity_mps = robot.state.body_vel[0]
        if abs(velocity_mps) >= TURN_BACK_MPS:
            self._direction = -1.0 if velocity_mps > 0 else 1.0
        robot.sensed()
        robot.drive(self._direction * SPEED_MPS, 0.0, 0.0)
        self.soak.commanded_ns.append(time.monotonic_ns())

    def _false_stop(self) -> None:
        """Take down why, and go on as a person would."""
        robot = self._trial.robot
        t_s = time.monotonic() - self._start_s
        wait_for("the gate to latch", lambda: robot.state.cause is not None, RECOVER_S)
        entry = self._cause.read()
        self.soak.stops.append(
            (round(t_s, 3), causes.read(records.LATCH.unpack(entry[2])[3]) if entry else causes.UNKNOWN())
        )
        self.soak.caused_ns.append(records.LATCH.unpack(entry[2])[1] if entry else time.monotonic_ns())
        wait_for("a motion enable after a false stop", self._enabled, RECOVER_S)
        self._known_epoch = self._epoch.get()

    def _enabled(self) -> bool:
        with contextlib.suppress(FailstopError):
            self._trial.robot.drive(0.0, 0.0, 0.0)  # else the enable would hold what it commanded just now
            self._trial.enable()
            return True
        time.sleep(0.05)
        return False

    def _imu_counts(self) -> tuple[int, int]:
        """IMU frames that the board has sent, and that telemetry has decoded: with the IMU silent, so that none is on
        its way while they are counted."""
        board = self._trial.board
        board.imu(False)
        quiet, before = 0, -1
        while quiet < 20:
            entry = self._imu.read()
            seq = entry[0] if entry else 0
            quiet, before = (quiet + 1 if seq == before else 0), seq
            time.sleep(0.002)
        counts = int(board.info()["imu_sent"]), before
        board.imu(True)
        return counts

    def _sample(self, now_s: float) -> None:
        found = {}
        for name, pid in self._trial.service.pids().items():
            with contextlib.suppress(OSError):
                found[name] = _memory_mb(pid)
        self.soak.memory.append(found)
        self.soak.sampled_s.append(now_s - self._start_s)

    def _cpu_s(self) -> dict[str, float]:
        found = {}
        for name, pid in self._trial.service.pids().items():
            times = psutil.Process(pid).cpu_times()
            found[name] = times.user + times.system
        return found


def _memory_mb(pid: int) -> tuple[float, float]:
    """(PSS, its anonymous part) in MB: what a process allocates itself is in the latter."""
    found = {"Pss:": 0.0, "Pss_Anon:": 0.0}
    with open(f"/proc/{pid}/smaps_rollup", encoding="ascii") as file:
        for line in file:
            words = line.split()
            if words[0] in found:
                found[words[0]] = int(words[1]) * 1024 / 1e6
    return found["Pss:"], found["Pss_Anon:"]


# The table.


def tick_row(soak: Soak, judged: bool) -> stats.Row:
    """How late the gate's ticks were."""
    period_ns = Settings().ns("gate.period_s")
    found = ticks.stretches(soak.events, soak.commanded_ns)
    late = [late_ns for stretch in found for late_ns in ticks.lateness_ns(*stretch, period_ns)]
    samples_ms = np.array(late, dtype=float) / 1e6
    ranks = np.percentile(samples_ms, (50, 99, 99.9), method=stats.NEAREST) if late else (np.nan,) * 3
    p50, p99, p999 = (float(value) for value in ranks)
    most = max(late, default=0) / 1e6
    over = sum(ns > LATE_MS * 1e6 for ns in late)
    numbers = {"ticks": len(late), "p50_ms": p50, "p99_ms": p99, "p999_ms": p999, "max_ms": most, "over": over}
    times = f"p50 {p50:.2f}  p99 {p99:.2f}  p99.9 {p999:.2f}  max {most:.2f} ms"
    result = f"{times}, {over} of {len(late)} over {LATE_MS:g}"
    bar = f"none over {LATE_MS:g} ms" if judged else "-"
    return stats.Row("the gate's ticks, late by", result, bar, over == 0 and bool(late) if judged else None, numbers)


def imu_row(soak: Soak) -> stats.Row:
    """IMU frames that did not become a sample."""
    return stats.count("IMU frames lost between board and state", soak.imu_sent - soak.imu_decoded, soak.imu_sent)


def memory_rows(soak: Soak) -> list[stats.Row]:
    """PSS at the start and the end, and the slope of its anonymous part: of the rest each process has a share that
    changes whenever another program starts or ends that maps the same files (47 MB/h in two minutes, measured)."""
    pss, own = ([sum(pair[which] for pair in one.values()) for one in soak.memory] for which in (0, 1))
    parts = ", ".join(
        f"{name} {pair[0]:.1f} to {soak.memory[-1][name][0]:.1f}"
        for name, pair in soak.memory[0].items()
        if name in soak.memory[-1]
    )
    result = f"{pss[0]:.1f} MB at the start, {pss[-1]:.1f} at the end  ({parts})"
    sizes = stats.Row("memory of the whole service (PSS)", result, "-", None, {"start": pss[0], "end": pss[-1]})
    late = [i for i, t_s in enumerate(soak.sampled_s) if t_s >= WARM_S]
    measure = "growth of memory (anonymous) after the first minute"
    if len(late) < 3 or soak.sampled_s[late[-1]] - soak.sampled_s[late[0]] < LEAST_S - 1:
        return [sizes, stats.Row(measure, "too short a run to say", "-", None, {})]
    times_h = np.array([soak.sampled_s[i] for i in late]) / 3600
    slopes = [float(np.polyfit(times_h, np.array([of[i] for i in late]), 1)[0]) for of in (own, pss)]
    row = stats.Row(
        measure,
        f"{slopes[0]:.2f} MB/h  (PSS {slopes[1]:.2f} MB/h)",
        f"< {GROWTH_MB_H:g} MB/h",
        slopes[0] < GROWTH_MB_H,
        {"anonymous_mb_h": slopes[0], "pss_mb_h": slopes[1], "samples": len(late)},
    )
    return [sizes, row]


def stop_row(soak: Soak, realtime: bool) -> stats.Row:
    """Stops that nobody asked for; their bar is zero where the service has real-time rights."""
    told = [(t_s, str(cause)) for t_s, cause in soak.stops]
    reasons = sorted({text for _, text in told})
    result = f"{len(soak.stops)} in {soak.seconds / 60:.1f} min" + (f": {'; '.join(reasons)}" if reasons else "")
    numbers = {"found": len(soak.stops), "per_hour": len(soak.stops) * 3600 / soak.seconds, "stops": told}
    met = not soak.stops if realtime else None
    return stats.Row("stops that nobody asked for", result, "0" if realtime else "-", met, numbers)


def explained(soak: Soak, control: stalls.Control) -> list[float]:
    """For each stop that nobody asked for, the longest stall of the control while its cause lasted, ms. 0 if the cause
    was not a silence, because a stall explains nothing else."""
    return [
        control.longest_ms(ns - LOOK_BACK_NS, ns) if cause.kind in SILENCE else 0.0
        for (_, cause), ns in zip(soak.stops, soak.caused_ns, strict=True)
    ]


def stall_rows(soak: Soak, control: stalls.Control) -> list[stats.Row]:
    """The time that the machine withheld from a bare loop above the service, and the stops that this does not
    explain."""
    within_s = sum(one.ms / 1e3 + LOOK_BACK_NS / 1e9 for one in control.stalls if one.ms >= EXPLAINS_MS)
    by_core = []
    for core in sorted({one.core for one in control.stalls}):
        found = [one for one in control.stalls if one.core == core]
        over = sum(one.ms >= EXPLAINS_MS for one in found)
        longest = max(one.ms for one in found)
        by_core.append(f"core {core}: {len(found)}, {over} over {EXPLAINS_MS:g} ms, longest {longest:.1f} ms")
    result = "; ".join(by_core) or "none"
    kept = {"stalls": [dataclasses.astuple(one) for one in control.stalls]}
    beside = explained(soak, control)
    alone = [(t_s, str(cause)) for (t_s, cause), ms in zip(soak.stops, beside, strict=True) if ms < EXPLAINS_MS]
    numbers = {"found": len(alone), "of": len(beside), "stops": alone, "stall_ms": beside}
    return [
        stats.Row(f"stalls over {stalls.LONG_NS / 1e6:g} ms of the control", result, "-", None, kept),
        stats.Row(
            f"stops that nobody asked for, and no stall over {EXPLAINS_MS:g} ms explains",
            f"{len(alone)} of {len(beside)}  (within reach of such a stall: {within_s / soak.seconds:.2%} of the time)",
            "0",
            not alone,
            numbers,
        ),
    ]


def rows(soak: Soak, *, loaded: bool, realtime: bool, control: stalls.Control | None = None) -> list[stats.Row]:
    """The table; `control`: the loops that ran beside a service with real-time rights."""
    share = ", ".join(f"{name} {value:.1f}" for name, value in soak.cpu_percent.items())
    total = sum(soak.cpu_percent.values())
    worst = ", ".join(f"{name} {value:.1f}" for name, value in soak.worst_ms.items())
    pauses = sum(after - before > 300e6 for before, after in pairwise(soak.commanded_ns))
    numbers = {"pauses": pauses, "commands": len(soak.commanded_ns), "restarts": soak.restarts}
    return [
        tick_row(soak, judged=realtime and not loaded),
        stats.Row("longest turn of each loop, by its own account", f"{worst} ms", "-", None, dict(soak.worst_ms)),
        imu_row(soak),
        *memory_rows(soak),
        stats.Row("processor", f"{total:.1f} % of a core  ({share})", "-", None, dict(soak.cpu_percent)),
        stop_row(soak, realtime),
        *(stall_rows(soak, control) if control else []),
        stats.Row("pauses over 0.3 s of the bench's own commands", f"{pauses}", "-", None, numbers),
    ]


@interruptible()
def main() -> int:
    """Drive and print the table; exit code 1 when a bar is missed."""
    parser = argparse.ArgumentParser(prog="python -m bench.soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=10, help="of driving (default: 10)")
    parser.add_argument("--load", action="store_true", help="on a machine that is kept busy")
    parser.add_argument("--no-realtime", action="store_true", help="without SCHED_FIFO, to see what it is worth")
    parser.add_argument("--seed", type=int, default=1, help="of the commands' distances")
    parser.add_argument("--out", default="bench/out/soak.json", help="where the JSON goes")
    arguments = parser.parse_args()
    directory = os.path.dirname(arguments.out) or "."
    os.makedirs(directory, exist_ok=True)
    with contextlib.ExitStack() as stack:
        trial = Trial()
        stack.callback(trial.close)
        trial.board.start()  # the judge keeps its rights
        if arguments.no_realtime:
            conditions.renounce_realtime()
        trial.service.start()
        realtime = all(process.realtime for process in trial.robot.state.processes.values())
        if arguments.load:
            stack.enter_context(conditions.load(directory))
        control = stack.enter_context(stalls.control()) if realtime else None
        soak = Driver(trial, arguments.seed).drive(arguments.minutes * 60, report.progress)
    table = rows(soak, loaded=arguments.load, realtime=realtime, control=control)
    memory = [{"t_s": t_s, **one} for t_s, one in zip(soak.sampled_s, soak.memory, strict=True)]
    machine = {"realtime": realtime, "load": arguments.load}
    return report.end(table, arguments.out, machine, memory_mb=memory)


if __name__ == "__main__":
    sys.exit(main())
