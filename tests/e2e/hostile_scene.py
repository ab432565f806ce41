"""Hostile clients as processes, and rules that hold whatever they do."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

from failstop import FailstopError
from failstop.lab.sim.client import Event
from failstop.lab.sim.model import Frame
from failstop.lab.trial import Trial, wait_for
from tests.support.shared_trial import goes_on

ROOT = Path(__file__).resolve().parents[2]
LONGEST_S = 30.0
MAX_RPS = 0.2 / (0.08 * 3.141592653589793) * 1.001


class Hostile:
    """One running program of hostile.py."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        self.pid = process.pid

    def says(self) -> str:
        """The next line that it says."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line, "it has ended"
        return line.strip()

    def asks(self) -> str:
        """Send it a line, return its answer."""
        assert self.process.stdin is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        return self.says()

    def kill(self) -> None:
        """SIGKILL, and collect it."""
        self.process.kill()
        self.process.wait()


@contextlib.contextmanager
def hostile(trial: Trial, program: str, *words: object) -> Iterator[Hostile]:
    """A program of hostile.py that has begun; it is killed at the end."""
    command = [sys.executable, "-m", "tests.e2e.hostile", program, trial.name, *map(str, words)]
    with subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        # So that a test which waits for a line in vain fails.
        late = threading.Timer(LONGEST_S, process.kill)
        late.start()
        try:
            yield Hostile(process)
        finally:
            late.cancel()
            process.kill()


def within_limits(event: Event | Frame) -> bool:
    """No wheel faster than it may be, nothing written past the motor table."""
    return not event.wild and all(abs(speed) <= MAX_RPS for speed in event.speeds)


def forward_or_still(event: Event) -> bool:
    """Wheels that turn as vx > 0 alone turns them, or stand; a speed may differ in its last place
    (codec.motor_speeds)."""
    forward = [speed * sign for speed, sign in zip(event.speeds, (1, 1, -1, -1), strict=True)]
    return within_limits(event) and min(forward) >= 0 and max(forward) - min(forward) < 1e-5


class Watch:
    """Rules that hold whatever a client does: nobody of the service died, nor was killed for being late."""

    def __init__(self, trial: Trial) -> None:
        self._trial = trial
        self._pids = trial.service.pids()

    def holds(self) -> None:
        """Raises AssertionError."""
        assert self._trial.service.pids() == self._pids
        assert self._trial.robot.state.waiting_for is None

    def stop_arrives(self, asker: Hostile) -> None:
        """Check that another client's stop request reaches the board, while the trial's client drives."""
        self._trial.board.events()
        asked_ns = int(asker.asks())
        self._trial.board.wait_for(lambda one: one.is_stop and one.arrival_ns >= asked_ns, 10.0)
        wait_for("the latch", lambda: self._trial.robot.state.estop is not None)


def latched(trial: Trial) -> str:
    """Wait for a latch; returns its reason."""
    wait_for("the latch", lambda: trial.robot.state.estop is not None)
    return trial.robot.state.estop or ""


def drives_again(trial: Trial) -> None:
    """Reset, enable, and the wheels turn."""

    def enabled() -> bool:
        with contextlib.suppress(FailstopError):
            trial.enable()
            return True
        return False

    wait_for("a motion enable", enabled)
    goes_on(trial)
