"""Follow: reads the state of a service, also across restarts of the service. It also computes how much the robot
vibrates."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from math import sqrt

from failstop.api.errors import FailstopError, NoService
from failstop.api.events import Event, EventLog
from failstop.api.snapshot import Imu
from failstop.api.state import State

KEPT = 256
CHECK_S = 0.5
"""How often to read new events, in seconds."""
SAMPLE_S = 0.08
"""The shortest time between two samples of the vibration, in seconds. A bit shorter than the time between two looks of
a program that looks ten times per second."""
SILENT_S = 1.0
"""An IMU that has not reported for this long is silent, in seconds."""
WINDOW = 10
"""The number of samples from which the vibration is computed. They cover one second."""


class Follower:
    """Reads the state and the events of a service. After a restart of the service, it reads those of the new run."""

    def __init__(self, name: str) -> None:
        """Raises NoService if no service is running, and FailstopError if it can't be read."""
        from failstop.api.robot import Robot  # takes 8 ms, and `failstop status` doesn't need it

        self.name = name
        self.note = ""
        """The reason for the latest failure of read(). It stays here even after read() has succeeded again. Empty if
        read() has never failed."""
        self.absent = False
        """True if the latest failure of read() was that no service is running. False if the service may be running, but
        can't be read, for example because it is of another version."""
        self.events: list[Event] = []
        """The newest events of the service's present run, at most 256, the oldest first."""
        self._robot = Robot(name)
        self._log = EventLog(name)
        self._check_s = 0.0
        self._run = ""

    def read(self, now_s: float) -> State | None:
        """The service's state. None if it can't be read; `note` then says why. `now_s`: time.monotonic()."""
        try:
            if now_s >= self._check_s:
                self._check_s = now_s + CHECK_S
                self._listen()
            state = self._robot.state
            if self._run != state.run:
                self._run = state.run
                self._listen()  # another run: the events of the last one would belie its state
            return state
        except FailstopError as error:
            self.absent = isinstance(error, NoService)
            self.note = f"no service named {self.name!r} is running" if self.absent else str(error)
            return None

    def _listen(self) -> None:
        try:
            told = self._log.read()
        except NoService:
            self._log, self.events = EventLog(self.name), []
            told = self._log.read()
        self.events = [*self.events, *told][-KEPT:]


class Vibration:
    """Computes how strongly the robot vibrates, from the gyro's x and y. This shows if the wheels turn, because turning
    wheels shake the gyro."""

    def __init__(self) -> None:
        self._samples: deque[Sequence[float]] = deque(maxlen=WINDOW)
        self._sample_s = float("-inf")
        self._sample_ns = 0
        self._newest: float | None = None

    def update(self, imu: Imu | None, now_s: float) -> float | None:
        """Add the newest sample of the IMU, unless it was added before or follows too soon. Returns the same as add().
        You may call this as often as you like. `now_s`: time.monotonic()."""
        if imu is None or now_s - imu.t_ns / 1e9 > SILENT_S:
            self._newest = self.add(None)
        elif imu.t_ns != self._sample_ns and now_s - self._sample_s >= SAMPLE_S:
            self._sample_s, self._sample_ns = now_s, imu.t_ns
            self._newest = self.add(imu.rate_radps)
        return self._newest

    def add(self, rate_radps: Sequence[float] | None) -> float | None:
        """Add a reading of the gyro. Returns the standard deviation in rad/s, or None while there are too few
        readings."""
        if rate_radps is None or (self._samples and rate_radps == self._samples[-1]):
            self._samples.clear()  # a sensor that repeats the same values is dead
        if rate_radps is not None:
            self._samples.append(rate_radps)
        if len(self._samples) < WINDOW:
            return None
        x, y, _ = (_variance(values) for values in zip(*self._samples, strict=True))
        return sqrt((x + y) / 2)


def _variance(values: Sequence[float]) -> float:
    mean = sum(values) / len(values)
    return sum((value - mean) ** 2 for value in values) / (len(values) - 1)
