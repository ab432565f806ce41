"""Injectors: what the machine is out of, and what happens to its time."""

from __future__ import annotations

import contextlib
import glob
import itertools
import os
import resource
import shutil
import signal
import subprocess
import time
from collections.abc import Callable

from failstop.messages.layout import GATE, TELEMETRY
from failstop_lab.faults.crowd import Helper, spin_for_ever
from failstop_lab.faults.fault import Fault
from failstop_lab.faults.inject import AskedMeanwhile, Injector
from failstop_lab.faults.scene import Scene
from failstop_lab.trial import TrialError

FROZEN_S = 0.3
HOUR_S = 3600.0
STEP_VARIABLE = "FAILSTOP_STEP_CLOCK"
SLEEP_VARIABLE = "FAILSTOP_SUSPEND"
DISK_S = 4.0
"""The battery is reported once a second, and logged as often."""
UNWRITTEN = "can't be written"
WRITTEN_AGAIN = "is written again"


class NoProcessor(AskedMeanwhile):
    """Two endless loops for every core."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault)
        self._hogs: list[Helper] = []

    def trouble(self, scene: Scene) -> None:
        self._hogs = [Helper(spin_for_ever) for _ in range(2 * (os.cpu_count() or 1))]

    def heal(self, scene: Scene) -> None:
        for hog in self._hogs:
            hog.end()


class _Limits:
    """A resource limit lowered to what each process uses now, and put back."""

    def __init__(self, kind: int, used: Callable[[int], int]) -> None:
        self._kind = kind
        self._used = used
        self._before: dict[int, tuple[int, int]] = {}

    def lower(self, pids: dict[str, int]) -> None:
        for pid in pids.values():
            hard = resource.prlimit(pid, self._kind)[1]
            self._before[pid] = resource.prlimit(pid, self._kind, (self._used(pid), hard))

    def restore(self) -> None:
        for pid, limits in self._before.items():
            try:
                resource.prlimit(pid, self._kind, limits)
            except ProcessLookupError:
                continue


def _descriptors(pid: int) -> int:
    """The lowest number that is free: no file can be opened under it."""
    used = set(map(int, os.listdir(f"/proc/{pid}/fd")))
    return next(fd for fd in itertools.count() if fd not in used)


def _address_space(pid: int) -> int:
    with open(f"/proc/{pid}/statm", encoding="utf-8") as file:
        return int(file.read().split()[0]) * resource.getpagesize()


class _NoMore(AskedMeanwhile):
    """Every process at its limit."""

    kind = 0

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault)
        self._limits = _Limits(self.kind, self.used)

    @staticmethod
    def used(pid: int) -> int:
        """The resource that it uses."""
        raise NotImplementedError

    def trouble(self, scene: Scene) -> None:
        self._limits.lower(scene.service.pids())

    def heal(self, scene: Scene) -> None:
        self._limits.restore()


class NoDescriptors(_NoMore):
    """RLIMIT_NOFILE."""

    kind = resource.RLIMIT_NOFILE
    used = staticmethod(_descriptors)


class NoMemory(_NoMore):
    """RLIMIT_AS."""

    kind = resource.RLIMIT_AS
    used = staticmethod(_address_space)


class NoDescriptorsKill(NoDescriptors):
    """The gate dies when it can't be started again at once."""

    def strike(self, scene: Scene) -> int:
        self.trouble(scene)
        now_ns = time.monotonic_ns()
        os.kill(scene.service.pids()[GATE], signal.SIGKILL)
        return now_ns


class NoDisk(_NoMore):
    """RLIMIT_FSIZE of the process that keeps the state files: none of them can grow, as on a full disk."""

    kind = resource.RLIMIT_FSIZE

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault)
        self._mark = 0

    @staticmethod
    def used(pid: int) -> int:
        return 0

    def trouble(self, scene: Scene) -> None:
        self._mark = scene.service.written()
        self._limits.lower({TELEMETRY: scene.service.pids()[TELEMETRY]})

    def last(self, scene: Scene) -> None:
        _wait_for_a_line(scene, UNWRITTEN, self._mark)

    def heal(self, scene: Scene) -> None:
        mark = scene.service.written()
        super().heal(scene)
        # It tells of the same trouble again only when there has been a line without it.
        _wait_for_a_line(scene, WRITTEN_AGAIN, mark)


def _wait_for_a_line(scene: Scene, text: str, mark: int) -> None:
    service = scene.service
    with contextlib.suppress(TrialError):
        scene.driver.until(f"a line with {text!r}", lambda: text in service.said(mark), DISK_S)


class Frozen(Injector):
    """SIGSTOP for all, SIGCONT for all."""

    def strike(self, scene: Scene) -> int:
        pids = list(scene.service.pids().values())
        scene.chance.shuffle(pids)
        for pid in pids:
            os.kill(pid, signal.SIGSTOP)
        scene.driver.run(FROZEN_S)
        scene.chance.shuffle(pids)
        thawed_ns = time.monotonic_ns()
        for pid in pids:
            os.kill(pid, signal.SIGCONT)
        return thawed_ns


class NamesRemoved(Injector):
    """As logind does when the service's user logs out. Whoever has a segment attached goes on with it."""

    def prepare(self, scene: Scene) -> None:
        scene.service.pids()

    def strike(self, scene: Scene) -> int:
        now_ns = time.monotonic_ns()
        for path in glob.glob(f"/dev/shm/failstop.{scene.trial.name}.*"):
            os.unlink(path)
        return now_ns


class Suspended(Injector):
    """rtcwake puts the machine to sleep for three seconds."""

    def unfit(self) -> str:
        if SLEEP_VARIABLE not in os.environ:
            return f"puts the machine to sleep: set {SLEEP_VARIABLE}=1 to allow it"
        return "" if shutil.which("rtcwake") else "no rtcwake on this machine"

    def strike(self, scene: Scene) -> int:
        subprocess.run(["rtcwake", "-m", "mem", "-s", "3"], check=True, stdout=subprocess.DEVNULL)
        return time.monotonic_ns()


class ClockStepped(Injector):
    """An hour on, and back."""

    def unfit(self) -> str:
        if STEP_VARIABLE not in os.environ:
            return f"steps the machine's clock: set {STEP_VARIABLE}=1 to allow it"
        return "" if os.getuid() == 0 else "only root may set the clock"

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault)
        self._stepped_s = 0.0

    def _step(self, seconds: float) -> None:
        time.clock_settime(time.CLOCK_REALTIME, time.time() + seconds)
        self._stepped_s += seconds

    def strike(self, scene: Scene) -> int:
        now_ns = time.monotonic_ns()
        self._step(HOUR_S)
        scene.driver.run(0.2)
        self._step(-2 * HOUR_S)
        return now_ns

    def heal(self, scene: Scene) -> None:
        if self._stepped_s:
            self._step(-self._stepped_s)


INJECTORS: dict[str, Callable[[Fault], Injector]] = {
    "no-processor": NoProcessor,
    "no-descriptors": NoDescriptors,
    "no-descriptors-kill": NoDescriptorsKill,
    "no-memory": NoMemory,
    "no-disk": NoDisk,
    "names-removed": NamesRemoved,
    "frozen": Frozen,
    "suspended": Suspended,
    "clock-stepped": ClockStepped,
}
