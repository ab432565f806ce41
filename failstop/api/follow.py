"""Follow: reads the state of a service even if it ends and another run begins, and computes how much the robot
shakes."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from math import sqrt

from failstop.api.errors import FailstopError, NoService
from failstop.api.events import Event, EventLog
from failstop.api.state import State

KEPT = 256
CHECK_S = 0.5
"""Time between two looks for news."""
WINDOW = 10
"""Samples (one second's worth) that the vibration is computed from."""


class Follower:
    """Reads the state and the events of the run that exists now."""

    def __init__(self, name: str) -> None:
        """Raises NoService if no service is running at the beginning, and FailstopError."""
        from failstop.api.robot import Robot  # takes 8 ms, which `failstop status` can do without

        self.name = name
        self.note = ""
        """Why there is no state now; empty if there is one."""
        self.events: list[Event] = []
        """The last events of this run, the oldest first."""
        self._robot = Robot(name)
        self._log = EventLog(name)
        self._check_s = 0.0

    def read(self, now_s: float) -> State | None:
        """The state; None if there is none, and then `note` says why. `now_s`: time.monotonic()."""
        try:
            if now_s >= self._check_s:
                self._check_s = now_s + CHECK_S
                self._listen()
            return self._robot.state
        except FailstopError as error:
            gone = isinstance(error, NoService)
            self.note = f"no service named {self.name!r} is running" if gone else str(error)
            return None

    def _listen(self) -> None:
        try:
            told = self._log.read()
        except NoService:
            self._log, self.events = EventLog(self.name), []
            told = self._log.read()
        self.events = [*self.events, *told][-KEPT:]


class Vibration:
    """Computes how much the gyro's x and y vary, because turning wheels shake it."""

    def __init__(self) -> None:
        self._samples: deque[Sequence[float]] = deque(maxlen=WINDOW)

    def add(self, rate_radps: Sequence[float] | None) -> float | None:
        """Add a reading; returns the standard deviation in rad/s, or None while too little is known."""
        if rate_radps is None or (self._samples and rate_radps == self._samples[-1]):
            self._samples.clear()  # a sensor that repeats itself is dead
        if rate_radps is not None:
            self._samples.append(rate_radps)
        if len(self._samples) < WINDOW:
            return None
        x, y, _ = (_variance(values) for values in zip(*self._samples, strict=True))
        return sqrt((x + y) / 2)


def _variance(values: Sequence[float]) -> float:
    mean = sum(values) / len(values)
    return sum((value - mean) ** 2 for value in values) / (len(values) - 1)
