"""Stopping: a stop that the page asks for, through the stop pipe that every local user may write."""

from __future__ import annotations

import asyncio
import contextlib
import time

from failstop.api.client import attach, send_stop
from failstop.api.errors import FailstopError
from failstop.shm import layout

WRITTEN_S = 0.3
"""How long a request is watched; the page repeats one that was not written by then."""
LOOK_S = 0.001
MOST_IDS = 64
MOST_OF_AN_ID = 32
REASON = "STOP on the page"


class Asked:
    """The requests of late, by the id that the page gives each: one may come by two ways, and is one stop."""

    def __init__(self) -> None:
        self._ids: dict[str, int] = {}

    def ask(self, name: str, who: str, identity: object) -> int:
        """Ask for a stop, unless that was done for this id; returns when it was (CLOCK_MONOTONIC ns). Raises NoService,
        FailstopError, and then it was not."""
        known = str(identity)[:MOST_OF_AN_ID] if identity else ""
        if known in self._ids:
            return self._ids[known]
        asked_ns = time.monotonic_ns()
        send_stop(name, REASON, who)
        if known:
            self._ids[known] = asked_ns
            if len(self._ids) > MOST_IDS:
                del self._ids[next(iter(self._ids))]
        return asked_ns


async def written(name: str, asked_ns: int) -> bool:
    """Wait for a stop that was asked for then; True once one is written to the board, by the word of the port owner.
    While there is no board there is none."""
    try:
        found = attach(name, layout.PORT_OWNER)
    except FailstopError:
        return False
    with contextlib.closing(found):
        word = found.word("written_ns")
        until_s = time.monotonic() + WRITTEN_S
        while word.get() < asked_ns:
            if time.monotonic() >= until_s:
                return False
            await asyncio.sleep(LOOK_S)
    return True
