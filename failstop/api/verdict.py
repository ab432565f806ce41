"""Verdict: in a word what the wheels do, what holds them, the next command to type; and what the events of a run tell
that its state does not. Pure; events are given oldest first."""

from __future__ import annotations

from collections.abc import Collection, Sequence

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
CHANGES = frozenset(("ready", "enabled", "disabled", "reset", "stop"))
"""Kinds of events that change whether motion is enabled."""
LEFT_OFF = frozenset(("driver_silent", "driver_gone"))
"""Those that tell of a driver that left the wheels turning."""
SINCE = CHANGES | LEFT_OFF | {"driver_ended", "stop_again"}


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


def headline(state: State) -> str:
    """What the wheels do and why, in a line."""
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
        found += [f"see to what {client.name} says is wrong" for client in state.clients if client.wrong]
        found.append(drive)
    return [words.named(step, state.name) for step in found]


def next_step(state: State) -> str:
    """The steps as one line."""
    return ", then ".join(steps(state))


# What events tell.


def newest(events: Sequence[Event], kinds: Collection[str]) -> Event | None:
    """The last event that is of one of these kinds."""
    return next((event for event in reversed(events) if event.kind in kinds), None)


def left_off(events: Sequence[Event]) -> Event | None:
    """The driver that left the wheels turning, if nothing was told since that would be news of motion."""
    last = newest(events, SINCE)
    return last if last and last.kind in LEFT_OFF else None


def ends(state: State, events: Sequence[Event]) -> dict[str, str]:
    """How the predecessor of each process ended, as a clause. What its exit status does not say is that it hung, and
    that the supervisor killed it for that."""
    fenced = {event.fields["pid"] for event in events if event.kind == "fenced"}
    died = {event.fields["process"]: event.fields["pid"] for event in events if event.kind == "died"}
    found = {}
    for name, process in state.processes.items():
        how = process.last_exit or "was lost"
        found[name] = f"was {how}" if how.startswith("killed") else how
        if died.get(name) in fenced:
            found[name] = "hung, and was killed by the supervisor"
    return found


def before(events: Sequence[Event]) -> str:
    """What ended the run before this one, if that was not in order, and the command that tells its story; or empty."""
    told = next((it.fields for it in events if it.kind == "incident" and it.fields.get("run") == "before"), None)
    return f"{told['reason']} (`failstop incident show {told['id']}`)" if told else ""
