"""Left: explains why the wheels are stopped, if the service's last run died. The answer comes from the shared memory
that the dead run left."""

from __future__ import annotations

import dataclasses
import os

from failstop.api import dates, host, words
from failstop.api.errors import NoService
from failstop.api.events import Event, unpack
from failstop.api.why import Why
from failstop.incidents import memory
from failstop.messages import layout, segments

SAVED_LATER = "its last minute is still in memory, and is saved as an incident when the service is started again"
NOT_SAVED = 'its last minute is still in memory, but is not saved, because incidents.save is "off"'


def left(name: str) -> tuple[Why, list[Event]] | None:
    """Explain why the wheels are stopped, from the memory of a run that did not end cleanly. Returns the answer and the
    run's events, with times by the present wall clock. The memory exists until the service or the computer is started
    again.

    Returns None if the service is running, or if no such memory can be read, for example because another user owns it.
    """
    dead = segments.dead_runs(name)
    fds = segments.open_all(dead[-1]) if dead else {}
    try:
        if len(fds) < len(layout.PROCESS_NAMES):
            return None
        _, found = memory.copy(fds, name)
    except (segments.AttachError, OSError):
        return None
    finally:
        for fd in fds.values():
            os.close(fd)
    cause_ns, _, cause = memory.left_cause(found)
    stop = memory.left_stop(found, cause_ns)
    supervisor = found[layout.SUPERVISOR]
    pid = supervisor["words"]["beat_pid"]
    at = dates.now()
    ended_s = dates.date((cause_ns + memory.unix_offset_ns(found)) / 1e9, cause_ns, at)
    what = f"no service named {name!r} is running: {cause} (pid {pid}; {words.ago(ended_s, at.unix_s)})"
    steps = [host.start(name), words.named("`failstop incident show last`, for what came before it", name)]
    if stop:
        proof = f"the {stop['written_by']} wrote the stop {words.took(stop['written_us'] / 1e6)} later"
    else:
        what = f"THE WHEELS MAY TURN; if they do, use the POWER SWITCH: {what}"
        proof = "no stop is known to have been written"
        steps.insert(0, f"{host.stop(name)} if the wheels turn")
    settings = memory.as_map(supervisor["latest"].get("settings", (0, 0, b""))[2])
    also = (NOT_SAVED if settings.get("incidents.save") == "off" else SAVED_LATER,)
    events = [event for seq, _, payload in supervisor["rings"]["events"] if (event := unpack(seq, payload))]
    return Why(what, proof, tuple(steps), also, ended_s), [
        dataclasses.replace(event, t=dates.date(event.t, event.ns, at)) for event in events
    ]


def refusal(name: str, error: NoService) -> NoService:
    """Add help to an error about a service that is not running: why its last run died, or how to start its unit.
    Returns `error` itself if neither is known."""
    if found := left(name):
        return NoService(f"{found[0].what}; {found[0].proof}; next: {', then '.join(found[0].do)}")
    if host.unit(name):
        told = f"its log is in {host.journal(name)}"
        return NoService(f"no service named {name!r} is running: start it with {host.start(name)}; {told}")
    return error
