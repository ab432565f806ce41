"""Runs: the state of a service that may end and come back as another run, and what a run that died has left."""

from __future__ import annotations

import os
import time
from typing import Any

from failstop.api import host, words
from failstop.api.client import attach
from failstop.api.errors import FailstopError, NoService
from failstop.api.events import Event, EventLog, unpack
from failstop.api.state import State, StateReader
from failstop.api.why import Why
from failstop.incidents import copying
from failstop.shm import layout, records, segment

KEPT = 256
CHECK_S = 0.5
"""Time between two looks whether it is still the same run."""


class Follower:
    """Reads the state of whatever run of the service is there."""

    def __init__(self, name: str) -> None:
        """Raises NoService, FailstopError: there must be one at first."""
        self.name = name
        self.reader: StateReader | None = StateReader(name)
        self.note = ""
        """Why there is no state now."""
        self.events: list[Event] = []
        """What this run has told, oldest first, the last of it."""
        self._log = EventLog(name)
        self._check_s = 0.0

    def read(self, now_s: float) -> State | None:
        """The state; None while there is none, and then `note` says why. `now_s`: a monotonic clock."""
        if now_s >= self._check_s:
            self._check_s = now_s + CHECK_S
            self._check()
        try:
            return self.reader.read() if self.reader else None
        except FailstopError as error:
            self.note = str(error)
            return None

    def _check(self) -> None:
        try:
            run = attach(self.name, layout.SUPERVISOR).incarnation
            if self.reader is None or self.reader.incarnation != run:
                self.reader = StateReader(self.name)
                self._log, self.events = EventLog(self.name), []
            self.events = [*self.events, *self._log.read()][-KEPT:]
        except FailstopError as error:
            gone = isinstance(error, NoService)
            self.reader = None
            self.note = f"no service named {self.name!r} is running" if gone else str(error)


class Left:
    """A run that was not ended in order. Its memory is there until the service is started again, or the machine is."""

    def __init__(self, name: str, copies: dict[str, tuple[int, bytes]], now_s: float, now_ns: int) -> None:
        """`now_s`, `now_ns`: Unix time and CLOCK_MONOTONIC of one moment."""
        cause_ns, _, cause = copying.left_cause(copies)
        port = copying.whole(layout.PORT_OWNER, "port", *copies[layout.PORT_OWNER])
        told = copying.whole(layout.SUPERVISOR, "events", *copies[layout.SUPERVISOR])
        self.name = name
        self.t = now_s - (now_ns - cause_ns) / 1e9
        """Unix time of the end."""
        self.stop: dict[str, Any] | None = copying.left_stop(copies, cause_ns)
        """As of supervisor/stops.py; None: no stop is known to have been written."""
        self.events: list[Event] = [event for seq, _, payload in told if (event := unpack(seq, payload))]
        self._device: str | None = records.PORT.unpack(port[-1][2])[3] if port else None
        self._cause = cause
        self._pid = copying.words(layout.SUPERVISOR, copies[layout.SUPERVISOR][1])["beat_pid"]

    def why(self, now_s: float) -> Why:
        """The answer to "why do the wheels stand?"."""
        what = f"no service named {self.name!r} runs: {self._cause} (pid {self._pid}; {words.ago(self.t, now_s)})"
        doubt = "" if self.stop else "THE WHEELS MAY TURN; if they do, use the POWER SWITCH: "
        also = ["its black box is in memory, and is saved as an incident when it is started again"]
        if not host.unit(self.name):
            also.append("a configuration file that it had is not known here: name it with --config")
        show = words.named("`failstop incident show last`", self.name)
        steps = (*self._steps(), f"{show}, for what came before it")
        return Why(doubt + what, self._written(), steps, tuple(also), None, None, self.t)

    def line(self, now_s: float) -> str:
        """What happened and what to do, in one line."""
        what = f"{self._cause} ({words.ago(self.t, now_s)}); {self._written()}"
        return f"no service named {self.name!r} is running: {what}; next: {', then '.join(self._steps())}"

    def _steps(self) -> list[str]:
        """What to do, in order; commands in backquotes."""
        first = [] if self.stop else [f"{host.stop(self._device)} if the wheels turn"]
        return [*first, host.start(self.name, self._device)]

    def _written(self) -> str:
        """Whether a stop was written, as a clause."""
        if self.stop is None:
            return "no stop is known to have been written"
        return f"the {self.stop['written_by']} wrote the stop {words.took(self.stop['written_us'] / 1e6)} later"


def left(name: str) -> Left | None:
    """What is left of a service of this name that no longer runs, and was this user's; None when nothing is."""
    dead = segment.dead_runs(name)
    fds = segment.open_all(dead[-1]) if dead else {}
    try:
        copies = {which: segment.copy(fd, name, which) for which, fd in fds.items()}
        if len(copies) == len(layout.PROCESSES):
            return Left(name, copies, time.time(), time.monotonic_ns())
    except (segment.AttachError, OSError):
        pass
    finally:
        for fd in fds.values():
            os.close(fd)
    return None


def refusal(name: str, error: NoService) -> NoService:
    """What to tell whoever asks for a service that does not run, if it is more than the error says."""
    if found := left(name):
        return NoService(found.line(time.time()))
    if host.unit(name):
        told = f"what it told is in {host.journal(name)}"
        return NoService(f"no service named {name!r} is running: start it with {host.start(name)}; {told}")
    return error
