"""History: what the events of a run tell that its state does not. Pure; events are given oldest first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from failstop.api import words
from failstop.api.events import Event
from failstop.api.snapshot import State

LEFT_OFF = {"driver_silent": "fell silent while it drove", "driver_gone": "ended while it drove"}
"""Kinds that tell of a driver that left the wheels turning, and what it did."""
SINCE = frozenset((*LEFT_OFF, "driver_ended", "enabled", "disabled", "reset", "stop", "stop_again"))


class Earlier(NamedTuple):
    """The run before this one, which was not ended in order."""

    t: float
    """When: Unix time, s."""
    how: str
    incident: str
    """The incident that was saved of it."""

    def show(self, name: str) -> str:
        """The command that tells its story."""
        return words.named(f"`failstop incident show {self.incident}`", name)


def exits(events: Sequence[Event]) -> dict[str, str]:
    """How each process that hung ended last: what its exit status does not say is that the supervisor killed it."""
    silent_ms: dict[tuple[object, object], object] = {}
    found: dict[str, str] = {}
    for event in events:
        process, pid = event.fields.get("process"), event.fields.get("pid")
        if event.kind == "fenced":
            silent_ms[process, pid] = event.fields.get("silent_ms")
        elif event.kind == "died":
            found.pop(str(process), None)
            if (process, pid) in silent_ms:
                found[str(process)] = _hung(silent_ms[process, pid])
    return found


def _hung(silent_ms: object) -> str:
    known = f" (silent for {silent_ms:.0f} ms)" if isinstance(silent_ms, (int, float)) and silent_ms else ""
    return f"hung{known}, and was killed by the supervisor"


def last_exit(state: State, name: str, hung: dict[str, str]) -> str:
    """How the predecessor of a process ended, as a clause: "hung (...)", "was killed by SIGKILL"."""
    how = state.processes[name].last_exit or "was lost"
    return hung.get(name) or (f"was {how}" if how.startswith("killed") else how)


def left_off(events: Sequence[Event]) -> Event | None:
    """The driver that left the wheels turning, if nothing was told since that would be news of motion."""
    last = next((event for event in reversed(events) if event.kind in SINCE), None)
    return last if last and last.kind in LEFT_OFF else None


def leaving(event: Event) -> str:
    """Who left off, and how, as a clause."""
    return f"{event.fields.get('who', 'somebody')} {LEFT_OFF[event.kind]}"


def earlier(events: Sequence[Event]) -> Earlier | None:
    """The run before this one, if it was not ended in order and is not long ago: the first events are still there."""
    if not events or events[0].seq != 1:
        return None
    found = (event.fields for event in events if event.kind == "incident" and event.fields.get("run") == "before")
    return next((Earlier(float(it["at"]), str(it["reason"]), str(it["id"])) for it in found), None)
