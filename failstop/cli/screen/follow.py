"""Follow: the state of a service that may end and come back as another run; what a run that died has left; how much the
robot shakes."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Sequence
from math import sqrt

from failstop.api import host, words
from failstop.api.errors import FailstopError, NoService
from failstop.api.events import Event, EventLog, unpack
from failstop.api.state import State
from failstop.api.why import Why
from failstop.incidents import memory
from failstop.messages import layout, records, segments

KEPT = 256
CHECK_S = 0.5
"""Time between two looks at what it has told."""
WINDOW = 10
"""Samples, a second of them, that a vibration is taken from."""


class Follower:
    """Reads the state of whatever run of the service is there, and what it tells."""

    def __init__(self, name: str) -> None:
        """Raises NoService, FailstopError: there must be one at first."""
        from failstop.api.robot import Robot  # 8 ms, which `failstop status` need not take

        self.name = name
        self.note = ""
        """Why there is no state now."""
        self.events: list[Event] = []
        """The last events of this run, oldest first."""
        self._robot = Robot(name)
        self._log = EventLog(name)
        self._check_s = 0.0

    def read(self, now_s: float) -> State | None:
        """The state; None while there is none, and then `note` says why. `now_s`: a monotonic clock."""
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
    """How much the gyro's x and y vary: wheels that turn shake it."""

    def __init__(self) -> None:
        self._samples: deque[Sequence[float]] = deque(maxlen=WINDOW)

    def add(self, rate_radps: Sequence[float] | None) -> float | None:
        """A new reading; returns the standard deviation in rad/s, None while too little is known."""
        if rate_radps is None or (self._samples and rate_radps == self._samples[-1]):
            self._samples.clear()  # a sensor that repeats itself is silent
        if rate_radps is not None:
            self._samples.append(rate_radps)
        if len(self._samples) < WINDOW:
            return None
        x, y, _ = (_variance(values) for values in zip(*self._samples, strict=True))
        return sqrt((x + y) / 2)


def _variance(values: Sequence[float]) -> float:
    mean = sum(values) / len(values)
    return sum((value - mean) ** 2 for value in values) / (len(values) - 1)


def left(name: str) -> tuple[Why, list[Event]] | None:
    """The memory left by a run that was not ended in order, until the service is started again, or the machine: the
    answer to "why do the wheels stand?", and what it told. None: it runs, was another user's, or left nothing."""
    dead = segments.dead_runs(name)
    fds = segments.open_all(dead[-1]) if dead else {}
    try:
        if len(fds) < len(layout.PROCESSES):
            return None
        _, found = memory.copy(fds, name)
    except (segments.AttachError, OSError):
        return None
    finally:
        for fd in fds.values():
            os.close(fd)
    cause_ns, _, cause = memory.left_cause(found)
    stop = memory.left_stop(found, cause_ns)
    port = found[layout.PORT_OWNER]["latest"].get("port")
    device = records.PORT.unpack(port[2])[3] if port else None
    supervisor = found[layout.SUPERVISOR]
    pid = supervisor["words"]["beat_pid"]
    now_s = time.time()
    ended_s = now_s - (time.monotonic_ns() - cause_ns) / 1e9
    what = f"no service named {name!r} is running: {cause} (pid {pid}; {words.ago(ended_s, now_s)})"
    steps = [host.start(name), words.named("`failstop incident show last`, for what came before it", name)]
    if stop:
        proof = f"the {stop['written_by']} wrote the stop {words.took(stop['written_us'] / 1e6)} later"
    else:
        what = f"THE WHEELS MAY TURN; if they do, use the POWER SWITCH: {what}"
        proof = "no stop is known to have been written"
        steps.insert(0, f"{host.stop(device)} if the wheels turn")
    also = ("its black box is in memory, and is saved as an incident when it is started again",)
    return Why(what, proof, tuple(steps), also, ended_s), [
        event for seq, _, payload in supervisor["rings"]["events"] if (event := unpack(seq, payload))
    ]


def refusal(name: str, error: NoService) -> NoService:
    """A better error for a service that does not run, where its last run left one."""
    if found := left(name):
        return NoService(f"{found[0].what}; {found[0].proof}; next: {', then '.join(found[0].do)}")
    if host.unit(name):
        told = f"what it told is in {host.journal(name)}"
        return NoService(f"no service named {name!r} is running: start it with {host.start(name)}; {told}")
    return error
