"""The unit on a real systemd: the stop times where systemd has a part, and how soon the service is there.

The board is outside the container and judges as everywhere. Times include what the machine's own systemd takes: the
stop tool is started by it, and its timers may be late by a quarter of a second.
"""

from __future__ import annotations

import argparse
import random
import signal
import sys
from collections.abc import Callable, Sequence
from typing import NamedTuple

from bench import report, stats
from bench.container import ContainerMissing
from bench.service_scene import HARDY, UNIT, Scene
from failstop.setup.ending import interruptible
from failstop_lab.trial import Stopped

WATCHDOG_MS = 1000.0
"""The unit's WatchdogSec."""
HANG_S = 1.6
"""By then systemd has acted on a hang."""
ENABLE = "systemctl --quiet enable failstop.service\n"


class Fault(NamedTuple):
    """One kind of end: its row, its bar, what is done to the service, how long the board is watched."""

    label: str
    p99_ms: float
    cause: Callable[[Scene], Callable[[], object]]
    aftermath_s: float
    restarted: bool


FAULTS = (
    Fault("SIGKILL of the supervisor", 5.0, lambda scene: scene.kill("supervisor"), 0.25, True),
    Fault("SIGKILL of every process at once", 250.0, lambda scene: scene.kill_all, 0.4, True),
    Fault("`systemctl stop`", 50.0, lambda scene: lambda: scene.box.ctl("stop", UNIT), 0.25, False),
    Fault(
        "hang of the supervisor",
        100.0,
        lambda scene: scene.signal(signal.SIGSTOP, scene.pid("supervisor")),
        HANG_S,
        True,
    ),
)


class Samples:
    """The measurements of one kind of fault."""

    def __init__(self) -> None:
        self.stops: list[Stopped] = []
        self.started_ns: list[int] = []
        """From the fault to the exec of the next supervisor."""


def measure(
    kills: int, seed: int, progress: Callable[[str], None], faults: Sequence[Fault] = FAULTS
) -> list[stats.Row]:
    """Each fault `kills` times, a third as often where systemd waits for a second, as often the boot; or one row that
    says why nothing can be measured here."""
    chance = random.Random(seed)
    found = {fault: Samples() for fault in faults}
    try:
        with Scene(HARDY) as scene:
            for turn in range(kills):
                for fault in faults:
                    if fault.aftermath_s < 1 or turn % 3 == 0:
                        progress(f"systemd, round {turn + 1} of {kills}: {fault.label}")
                        _sample(scene, fault, found[fault], chance.uniform(0.1, 0.2))
        boots = [_boot(progress) for _ in range(max(1, kills // 3))]
    except ContainerMissing as missing:
        return [stats.Row("the unit on a real systemd", f"skipped: {missing}", "-", None, {"skipped": str(missing)})]
    return rows_of(found, boots)


def _sample(scene: Scene, fault: Fault, samples: Samples, drive_s: float) -> None:
    scene.start()
    try:
        stopped = scene.fault(fault.cause(scene), drive_s, fault.aftermath_s)
        samples.stops.append(stopped)
        if fault.restarted:
            scene.recover(1)
            started_us = scene.box.show(UNIT, "ExecMainStartTimestampMonotonic")["ExecMainStartTimestampMonotonic"]
            samples.started_ns.append(int(started_us) * 1000 - stopped.fault_ns)
    finally:
        scene.end()


def _boot(progress: Callable[[str], None]) -> int:
    """ns from the start of systemd to the service's READY."""
    progress("systemd, boot to ready")
    with Scene(setup=ENABLE) as scene:
        scene.wait_ready()
        began = scene.box.show("", "UserspaceTimestampMonotonic")["UserspaceTimestampMonotonic"]
        ready = scene.box.show(UNIT, "ActiveEnterTimestampMonotonic")["ActiveEnterTimestampMonotonic"]
    return (int(ready) - int(began)) * 1000


def rows_of(found: dict[Fault, Samples], boots: list[int]) -> list[stats.Row]:
    """The measurements of each fault, and the ns of each boot, as rows."""
    rows = []
    for fault, samples in found.items():
        times = [stopped.stop_ns for stopped in samples.stops if stopped.stop_ns is not None]
        rows.append(stats.timing(f"systemd: {fault.label} -> stop frame", times, p50_ms=None, p99_ms=fault.p99_ms))
        if samples.started_ns:
            bar = WATCHDOG_MS + 300 if fault.aftermath_s == HANG_S else None
            label = f"systemd: {fault.label} -> the service is restarted"
            rows.append(stats.timing(label, samples.started_ns, p50_ms=None, p99_ms=bar))
    rows.append(stats.timing("systemd: boot -> READY", boots, p50_ms=None, p99_ms=1000.0))
    every = [stopped for samples in found.values() for stopped in samples.stops]
    rows.append(stats.count("systemd: stops missed", sum(s.stop_ns is None for s in every), len(every)))
    rows.append(stats.count("systemd: motion frames after the stop", sum(s.motion_after for s in every), len(every)))
    rows.append(stats.count("systemd: wheels found at rest", sum(not s.was_turning for s in every), len(every)))
    return rows


@interruptible()
def main(words: Sequence[str] | None = None) -> int:
    """Measure alone and print the rows; exit code 1 when a bar is missed. `words`: others than the command line's."""
    parser = argparse.ArgumentParser(prog="python -m bench.service", description=__doc__)
    parser.add_argument("--kills", type=int, default=30, help="of each kind (default: 30)")
    parser.add_argument("--seed", type=int, default=1, help="of the random moments")
    parser.add_argument("--json", metavar="FILE", help="write the rows there too")
    arguments = parser.parse_args(words)
    rows = measure(arguments.kills, arguments.seed, report.progress)
    return report.end(rows, arguments.json)


if __name__ == "__main__":
    sys.exit(main())
