"""Verdict: in a word what the wheels do, what holds them, the next command to type; and what the events of a run tell
that its state does not. Pure; events are given oldest first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from failstop.api import host, words
from failstop.api.events import Event
from failstop.api.snapshot import State
from failstop.policy import causes
from failstop.shm import blocks
from failstop.shm.layout import GATE

DRIVING = "DRIVING"
STANDING = "STANDING"
STOPPED = "STOPPED"
MAY_TURN = "MAY TURN"
"""A stop that is not known to reach the wheels is none: nobody must rely on it."""
STALE_S = 0.5
"""A decision of the gate older than this is no news of the wheels: it publishes every 80 ms."""
LEFT_OFF = {"driver_silent": "fell silent while it drove", "driver_gone": "ended while it drove"}
"""Kinds that tell of a driver that left the wheels turning, and what it did."""
SINCE = frozenset((*LEFT_OFF, "driver_ended", "enabled", "disabled", "reset", "stop", "stop_again"))


def doubt(state: State) -> str:
    """Why the wheels may turn though they were told to stop; empty when there is no reason to think so."""
    if state.device.state != "open":
        return f"the port {state.device.path or ''} is {state.device.state}, so no stop reaches the board"
    if state.device.link == "deaf":
        return "the board does not answer, so a stop may not reach the wheels"
    if state.cause and state.cause.kind is causes.UNSTILL:
        return "the IMU sees the robot shake on"
    return ""


def word(state: State) -> str:
    """What the wheels do."""
    if doubt(state):
        return MAY_TURN
    if state.moving:
        return DRIVING
    return STOPPED if state.blocked else STANDING


def headline(state: State, blocked: str | None = None) -> str:
    """What the wheels do and why, in a line; `blocked`: the same block in other words."""
    if blocked and state.blocked:
        return f"blocked: {blocked}"
    if state.cause:
        return f"stop latched: {state.cause}"
    if state.block:
        return f"blocked: {state.block.value}"
    return words.velocity(*state.body_vel) or "zero is commanded"


def down(state: State) -> list[str]:
    """Processes that died too often and are down."""
    return [name for name, process in state.processes.items() if process.state == "down"]


def until(name: str) -> str:
    """How long a process that died too often is away: the gate is the one that hears a reset."""
    return "down for a minute" if name == GATE else "down until a reset"


def steps(state: State) -> list[str]:
    """What to do, in order, for the wheels to move; commands in backquotes. Empty while they move."""
    drive = "`failstop drive 0.1 0 0`, or commands by your program"
    if state.blocked is None:
        return [] if state.moving else [words.named(drive, state.name)]
    if any(process.state == "dead" for process in state.processes.values()):
        return [host.start(state.name, state.device.path), words.named("`failstop enable`", state.name)]
    found = []
    if state.device.state != "open":
        found.append(f"plug the board in ({state.device.path})")
    elif doubt(state):
        found.append("turn the robot's POWER SWITCH off and on")
    elif GATE in down(state):
        found.append(f"wait for {GATE}")
    elif state.waiting_for and not down(state):
        found.append(f"wait for {state.waiting_for}")
    if state.estop:
        found.append("`failstop reset`")
    if not state.enabled:
        found += ["have somebody attend (`failstop attend`, or the page)"] if state.attended_by == () else []
        found.append("`failstop enable`")
    elif state.blocked == blocks.NO_SCAN:
        found.append("start the obstacle sensor and the program that calls robot.sensed()")
    elif state.blocked == blocks.NO_COMMAND:
        found.append(drive)
    return [words.named(step, state.name) for step in found]


def next_step(state: State) -> str:
    """The steps as one line."""
    return ", then ".join(steps(state))


# What events tell.


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
