"""Pending: a stop whose file is not there yet - whoever asks for the last incident then means that one."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import closing
from typing import Any

import msgpack

from failstop.api.client import last_run
from failstop.api.errors import FailstopError
from failstop.incidents import store
from failstop.policy import causes
from failstop.shm import layout, segment

RECENT_S = 20.0
"""A stop that is older was saved, or never will be; a lost port is waited for less long (saver.py)."""
PATIENCE_S = 4.0
"""A stop's file is there 2.4 s after it."""
LOOK_S = 0.1


def unsaved(name: str, heads: list[dict[str, Any]], now_s: float) -> dict[str, Any] | None:
    """The service's last stop, as supervisor/stops.py publishes it, when it is recent and in none of the incidents."""
    try:
        memory, owner = last_run(name)
        with closing(segment.attach(memory, layout.SUPERVISOR, owner=owner)) as supervisor:
            entry = supervisor.latest_reader("stop").read()
        stop: dict[str, Any] = msgpack.unpackb(entry[2]) if entry else {}
        # What comes while a stop is latched belongs to that one's file.
        if not stop or stop["latched"] != stop["cause"] or not 0 <= now_s - stop["t"] < RECENT_S:
            return None
        run = f"{supervisor.incarnation:016x}"
        saved = any(head.get("run") == run and head["epoch"] >= stop["epoch"] for head in heads)
    except (FailstopError, segment.AttachError, ValueError, KeyError, TypeError, msgpack.UnpackException):
        return None
    return None if saved else {**stop, "reason": str(causes.read(stop["cause"]))}


def wait(name: str, environ: Mapping[str, str], patience_s: float = PATIENCE_S) -> dict[str, Any] | None:
    """Until the last stop is saved; returns it when it was not within `patience_s`."""
    until_s = time.monotonic() + patience_s
    while (stop := unsaved(name, store.heads(name, environ)[0], time.time())) and time.monotonic() < until_s:
        time.sleep(LOOK_S)
    return stop
