"""Stopping: requests stops through the service's stop pipe. Every local user may write to that pipe."""

from __future__ import annotations

import asyncio
import contextlib
import os
import time

from failstop.api.client import attach, run, send_stop
from failstop.api.errors import FailstopError
from failstop.data import Data
from failstop.files import instance
from failstop.messages import layout, records
from failstop.shm import bell

WRITTEN_S = 0.3
"""How long to wait until a stop is written, s. If the stop is not written in time, the page sends its request again."""
LOOK_S = 0.001
MOST_IDS = 64
MOST_OF_AN_ID = 32
KNOWN_NS = 60_000_000_000
"""How long the id of a stop is known, in ns. A program that gives each of its stops the same id is obeyed again after
this time."""
REASON = "STOP on the page"


class Request(Data):
    """A stop that was requested, or the error that prevented it."""

    unix_s: float
    asked_ns: int = 0
    error: FailstopError | None = None


class Pipe:
    """The stop pipe of the running service, kept open because opening it takes longer than requesting a stop."""

    def __init__(self, name: str) -> None:
        """`name`: the name of the service."""
        self._name = name
        self._path = ""
        self._fd = -1
        self._same: os.stat_result | None = None

    def prepare(self) -> None:
        """Open the stop pipe of the running service, unless it is open already."""
        if self._is_held():
            return
        self.close()
        with contextlib.suppress(instance.NoService, instance.InstanceError):
            folder, self._fd = instance.open_stop(self._name)
            self._path, self._same = instance.stop_path(folder), os.fstat(self._fd)

    def _is_held(self) -> bool:
        try:
            return self._same is not None and os.path.samestat(os.stat(self._path), self._same)
        except OSError:
            return False

    def send(self, who: str) -> None:
        """Request a stop. Raises NoService, FailstopError."""
        if self._is_held():
            with contextlib.suppress(OSError):
                bell.send(self._fd, records.asking(REASON, who, os.getpid()))
                return
        send_stop(self._name, REASON, who)

    def close(self) -> None:
        """Close the pipe."""
        if self._same is not None:
            os.close(self._fd)
            self._same = None


class Asked:
    """Requests the stops that pages ask for, for each known id only once. A page may send one stop both by websocket
    and as an HTTP request, with the same id."""

    def __init__(self, pipe: Pipe) -> None:
        """`pipe`: the stop pipe of the service."""
        self._pipe = pipe
        self._ids: dict[str, int] = {}
        self._presses: dict[str, int] = {}

    def ask(self, who: str, identity: object) -> Request:
        """Request a stop at once, unless this id is known (KNOWN_NS). A page asks for one touch again and again,
        with ids that differ only after a dash. Their requests have the time of the first that was sent to the service,
        because the page compares this time with that of the stop."""
        known = str(identity)[:MOST_OF_AN_ID] if identity else ""
        try:
            asked_ns = self._ask(who, known)
        except FailstopError as error:
            return Request(time.time(), error=error)
        press = known.partition("-")[0]
        first_ns = _used_ns(self._presses, press, asked_ns)
        if first_ns is None:
            first_ns = _use(self._presses, press, asked_ns)
        return Request(time.time() - (time.monotonic_ns() - first_ns) / 1e9, asked_ns)

    def _ask(self, who: str, known: str) -> int:
        """Request a stop, unless this id is known (KNOWN_NS). Returns the time of the first request with it
        (CLOCK_MONOTONIC, ns). Raises NoService, FailstopError."""
        asked_ns = time.monotonic_ns()
        before_ns = _used_ns(self._ids, known, asked_ns)
        if before_ns is not None:
            return before_ns
        self._pipe.send(who)
        return _use(self._ids, known, asked_ns)


def _used_ns(ids: dict[str, int], identity: str, now_ns: int) -> int | None:
    """Return when this id was first used in the last KNOWN_NS, or None if it was not."""
    first_ns = ids.get(identity)
    return None if first_ns is None or now_ns - first_ns >= KNOWN_NS else first_ns


def _use(ids: dict[str, int], identity: str, now_ns: int) -> int:
    """Note that this id, unless it is empty, is used for the first time now. Keeps the newest MOST_IDS. Returns
    `now_ns`."""
    if identity:
        ids.pop(identity, None)
        ids[identity] = now_ns
        if len(ids) > MOST_IDS:
            del ids[next(iter(ids))]
    return now_ns


async def written(name: str, asked_ns: int) -> bool:
    """Wait until a stop is written at `asked_ns` or later (CLOCK_MONOTONIC, ns). Usually the port owner writes and
    reports it. If no port owner can, the supervisor does. Returns False if no stop was written within WRITTEN_S, or if
    no service is running."""
    with contextlib.ExitStack() as opened:
        try:
            found = run(name)
            parts = [
                opened.enter_context(contextlib.closing(attach(name, each, found)))
                for each in (layout.PORT_OWNER, layout.SUPERVISOR)
            ]
        except FailstopError:
            return False
        words = [part.word("written_ns") for part in parts]
        until_s = time.monotonic() + WRITTEN_S
        while max(word.get() for word in words) < asked_ns:
            if time.monotonic() >= until_s:
                return False
            await asyncio.sleep(LOOK_S)
    return True
