"""Verdict: says in a word or a line what the wheels do, and why they are stopped. It uses the state and the events of a
run. Pure; events are given oldest first."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence

from failstop.api import wheels, words
from failstop.api.errors import FailstopError, NoService
from failstop.api.events import Event
from failstop.api.snapshot import Process, State, Stop
from failstop.api.wheels import CAN_MOVE as CAN_MOVE
from failstop.api.wheels import DRIVING as DRIVING
from failstop.api.wheels import MAY_TURN as MAY_TURN
from failstop.api.wheels import MOVED as MOVED
from failstop.api.wheels import MOVING as MOVING
from failstop.api.wheels import ROBOT_MOVES as ROBOT_MOVES
from failstop.api.wheels import STANDING as STANDING
from failstop.api.wheels import STOPPED as STOPPED
from failstop.api.wheels import STOPPING as STOPPING
from failstop.api.wheels import TOLD_TO_STOP as TOLD_TO_STOP
from failstop.api.wheels import TURNING as TURNING
from failstop.api.wheels import WHEELS_MAY_TURN as WHEELS_MAY_TURN
from failstop.api.wheels import WHEELS_TURN as WHEELS_TURN
from failstop.api.wheels import WRITTEN as WRITTEN
from failstop.messages.layout import GATE
from failstop.policy import causes, proofs

COMMANDED = "COMMANDED TO DRIVE"
"""Shown instead of DRIVING while the board reports that it obeys zero speed."""
NO_SERVICE = "NO SERVICE"
"""Shown when no service is running."""
UNREADABLE = "CAN'T READ"
"""Shown when the service can't be read, for example because it is of another version. It may be running."""
NEVER_ANSWERED = proofs.LINKS_IN_WORDS[proofs.LINK_UNPROVEN]
LINKS = proofs.LINKS_IN_WORDS
"""A text for each state of the connection to the board."""
UNHEEDED_S = 0.5
"""If motion is commanded, but the board has reported zero speed for at least this many seconds, it does not obey. A
shorter time proves nothing, because the reports come only about every 100 ms, and an adapter may delay a command."""
STALE_S = 0.5
"""The age after which a decision of the gate says nothing about the wheels any more, in s. The gate normally publishes
every 80 ms."""
LATE_BEAT_S = 0.3
"""The age after which the screens highlight the newest heartbeat of a process, in s. Every process has a heartbeat at
least every 100 ms."""
BATTERY_LOW_V = 10.5
"""Below this voltage the battery is almost empty. The value is for a battery of three lithium cells, 3.5 V for each
cell."""
CHANGES = frozenset(("ready", "enabled", "disabled", "reset", "stop", "driver_gone"))
"""The kinds of events that can change whether motion is enabled, or whether it can be enabled."""
LEFT_OFF = frozenset(("driver_silent", "driver_gone"))
"""The kinds of events about a driver that stopped driving while the wheels turned."""
UNLATCHED = LEFT_OFF | {"disabled"}
"""Kinds of events about wheels that were stopped although no stop was latched."""
HALTS = UNLATCHED | {"stop", "stop_again"}
"""Kinds of events about wheels that were stopped, whether a stop was latched or not."""
SINCE = CHANGES | LEFT_OFF | {"driver_ended", "stop_again"}


def without_state(problem: FailstopError) -> str:
    """Return NO_SERVICE or UNREADABLE. `problem`: the error that was raised instead of a state."""
    return NO_SERVICE if isinstance(problem, NoService) else UNREADABLE


def unreached(state: State) -> str:
    """Why bytes may not reach the board. Empty if there is no sign of such a problem."""
    if state.device.state != "open":
        return f"the port {state.device.path} is {state.device.state}, so no stop reaches the board"
    if state.device.link == "deaf":
        return "the board does not hear, so a stop may not reach the wheels"
    if state.device.link == "silent":
        since_s = state.ages.board_s
        for_s = f" for {words.span(since_s)}" if since_s else ""
        return f"the board has said nothing{for_s}, so nobody knows whether a stop reaches the wheels"
    if state.device.link == "unheard":
        return f"{state.device.path} has not answered since it came back, so it may be another device than the board"
    if state.last_stop and not state.last_stop.sent and not state.moving:
        return "the board accepts no bytes, so the last stop may not have reached the wheels"
    return ""


def link(state: State) -> str:
    """What the board's answers prove, as a clause. If the port is not open, the clause is about the port."""
    if state.device.state != "open":
        return f"the port {state.device.path} is {state.device.state}"
    return LINKS[state.device.link]


def reached(state: State) -> str:
    """How it is known that the latched stop has reached the wheels, as a clause. Empty if it is not known, or in
    doubt."""
    stop = state.last_stop
    if state.cause is None or doubt(state):
        return ""
    if state.cause.kind is causes.UNSTILL:
        return "they have been seen still since" if wheels.seen(state) is wheels.Seen.STILL else ""
    heard = stop and stop.cause == state.cause and stop.acknowledged_s is not None
    return "the board has acknowledged the stop since" if heard else ""


def row(state: State) -> wheels.Row:
    """What the screens may say about the wheels."""
    return wheels.row(state, unreached(state))


def doubt(state: State) -> str:
    """Why the wheels turn, or may turn, although they were commanded to stop. Empty if there is no sign of that."""
    found = row(state)
    return ", and ".join(filter(None, (found.text, unreached(state)))) if found.alarm else ""


def unseen(state: State) -> str:
    """What people must know about the wheels in addition to word(), for example that nothing shows what they do. Empty
    if word() is enough, or if doubt() has a text."""
    found = row(state)
    return "" if found.alarm else found.text


def unproven(state: State) -> str:
    """Why nobody can rely on what word() says: the board has never answered, or it reports zero speed although motion
    is commanded. Empty if neither is the case, or if doubt() has a text."""
    if doubt(state):
        return ""
    never = state.device.state == "open" and state.device.link == "unproven"
    return NEVER_ANSWERED if never else unheeded(state)


def unheeded(state: State) -> str:
    """For how long the board has reported zero speed although motion is commanded, as a clause. Empty if it does not
    report that, or has reported it for less than UNHEEDED_S."""
    for_s = state.device.unheeded_s
    if not state.moving or for_s is None or for_s < UNHEEDED_S:
        return ""
    return f"the board has reported for {words.span(for_s)} that it obeys a command of zero"


def word(state: State) -> str:
    """The word about the wheels, such as STOPPED or TOLD TO STOP."""
    found = row(state).word
    return STANDING if found == STOPPED and not state.blocked else found


def proven_word(state: State) -> str:
    """word(), or COMMANDED if the board reports zero speed although motion is commanded. If the word is unproven, the
    text says so, and why."""
    why = unproven(state)
    found = COMMANDED if unheeded(state) else word(state)
    return f"{found}, unproven: {why}" if why else found


def large_word(state: State, events: Sequence[Event] = ()) -> str:
    """The word for a screen that people read from a distance. It warns of wheels that turn or may turn although nobody
    wants that. Otherwise, if motion is enabled, it says that the robot moves or can move. If not, it says what is
    proven about the stopped wheels."""
    found = row(state)
    if found.alarm:
        return found.large
    may_move = state.enabled and not state.estop
    large = MOVING if state.moving else CAN_MOVE if may_move else _stopped(state, found.large, events)
    return f"{large}, UNPROVEN" if unproven(state) and large not in (WRITTEN, WHEELS_MAY_TURN) else large


def _stopped(state: State, seen: str, events: Sequence[Event]) -> str:
    """What is proven about stopped wheels, in a word. `seen`: the word for what is seen. The proofs are those of the
    last latched stop. They do not count if the wheels were stopped later without a latch. Bytes that are still in the
    kernel prove nothing about the board."""
    stop = state.last_stop
    if stop is None or unlatched(state, events):
        return WHEELS_MAY_TURN if state.cause else seen
    if stop.acknowledged_s is not None or observed(stop):
        return seen
    return WRITTEN if stop.written_s is not None and stop.sent else WHEELS_MAY_TURN


def observed(stop: Stop) -> bool:
    """True if the wheels were observed to come to rest after this stop, or were already seen still before it. An IMU
    that felt no movement before the stop proves nothing about the wheels."""
    return stop.observed_s is not None and (stop.observed_s > 0 or stop.observed_by != "IMU")


def unanswered(state: State, events: Sequence[Event] = ()) -> bool:
    """True if a stop may not have reached the board, or if it was written to a board that has never answered."""
    word = large_word(state, events)
    return word == WHEELS_MAY_TURN or (word == WRITTEN and state.device.link == "unproven")


def headline(state: State) -> str:
    """One line about what the wheels do, or why they are stopped."""
    if state.cause:
        return f"stop latched: {state.cause}"
    if state.block:
        return f"blocked: {state.block.value}"
    how = words.velocity(*state.body_vel)
    return (f"{how} is commanded" if unheeded(state) else how) or "zero is commanded"


def down(state: State) -> list[str]:
    """The names of processes that have died too often. They are started again only after a pause or a reset."""
    return [name for name, process in state.processes.items() if process.state == "down"]


def absence(process: Process, ended: str = "") -> str:
    """The end of a sentence about a process that is not running: what the process does instead, and when it will start
    again. `ended`: a clause about how the previous process with the same name ended."""
    how = "died too often and is down" if process.state == "down" else f"is {process.state}"
    if process.state == "down" and process.starts_in_s is None:
        how += " until a reset"
    again = f"; it starts again in {process.starts_in_s:.0f} s" if (process.starts_in_s or 0.0) >= 1 else ""
    return f"{how}{f', after it {ended}' if ended else ''}{again}"


def no_answer(state: State) -> str:
    """Why the gate answers no requests, with the remedy. Empty while the gate is running."""
    gate = state.processes[GATE]
    if gate.state == "running":
        return ""
    ended = f"{'was ' * gate.killed}{gate.last_exit}" if gate.last_exit else ""
    remedy = ", or restart the service now" if gate.state == "down" else ""
    return f"it {absence(gate, ended)}. Only a stop is heard until then; ask again then{remedy}"


def newest(events: Sequence[Event], kinds: Collection[str]) -> Event | None:
    """The newest event of one of these kinds. None if there is no such event. An event `ready` counts only if it is
    about the start of the service. Later ones report only that something is there again, which changes nothing about
    whether motion is enabled."""
    return next((event for event in reversed(events) if event.kind in kinds and not _again_ready(event)), None)


def _again_ready(event: Event) -> bool:
    """True for an event `ready` that is not about the start of the service. Only the one about the start has a next
    step, because motion is always disabled then."""
    return event.kind == "ready" and not event.next


def left_off(events: Sequence[Event]) -> Event | None:
    """The newest event about a driver that stopped driving while the wheels turned. None if there is no such event, or
    if a later stop, enable or similar event has made it out of date."""
    last = newest(events, SINCE)
    return last if last and last.kind in LEFT_OFF else None


def unlatched(state: State, events: Sequence[Event]) -> Event | None:
    """The event that last stopped the wheels, if it latched no stop: a driver died or fell silent, or motion was
    disabled. None if a latched stop was the last to stop the wheels, or if a stop is latched now. None
    proves nothing if remembered() is False."""
    stop, last = state.last_stop, newest(events, HALTS)
    if state.cause or last is None or last.kind not in UNLATCHED:
        return None
    return last if stop is None or last.ns > stop.noticed_ns else None


def remembered(state: State, events: Sequence[Event]) -> bool:
    """True if no event since the last latched stop is missing from `events`: a stop is latched now, or the events reach
    back to that stop. The service keeps only its newest events. If this is False, the wheels may have turned and
    stopped again since that stop, even if no event shows it."""
    stop = state.last_stop
    if state.cause or stop is None:
        return True
    return bool(events) and (events[0].seq == 1 or events[0].ns <= stop.noticed_ns)


def seen_since(state: State, events: Sequence[Event], now_s: float) -> State:
    """Return the state without an observation that is older than the last stop. If the wheels were seen still only
    before that stop, `turning.does` becomes unknown. The IMU's observation covers half a second, so all of that half
    second must be after the stop. `now_s`: Unix time."""
    known, stop, event = state.turning, state.last_stop, unlatched(state, events)
    told_s = event.t if event else stop.t if stop else None
    if known.does != "still" or told_s is None:
        return state
    window_s = proofs.WINDOW_NS / 1e9 if known.by == "IMU" else 0.0
    # If the clock was set back since, the two times can't be compared.
    if not 0 <= now_s - told_s < (known.age_s or 0.0) + window_s:
        return state
    return dataclasses.replace(state, turning=dataclasses.replace(known, does="unknown", by="", since_s=None))


def ends(state: State, events: Sequence[Event]) -> dict[str, str]:
    """For each process, a clause about how the previous process with the same name ended. The clause also says if the
    supervisor killed that process because it hung, which the exit status does not show."""
    fenced = {event.fields["pid"] for event in events if event.kind == "fenced"}
    died = {event.fields["process"]: event.fields["pid"] for event in events if event.kind == "died"}
    found = {}
    for name, process in state.processes.items():
        how = process.last_exit or "was lost"
        found[name] = f"was {how}" if process.killed else how
        if died.get(name) in fenced:
            found[name] = "hung, and was killed by the supervisor"
    return found


def before(events: Sequence[Event]) -> str:
    """How the previous run of the service ended, with the command that shows more, or with the reason why its incident
    was not saved. Empty if the previous run ended cleanly."""
    if (told := before_event(events)) is None:
        return ""
    if "id" in told.fields:
        return f"{told.fields['reason']} (`failstop incident show {told.fields['id']}`)"
    return (
        f"{told.fields.get('ended', 'it did not end cleanly')}; {told.what.replace('incident', 'its incident was', 1)}"
    )


def before_event(events: Sequence[Event]) -> Event | None:
    """The event that reports whether the incident of the previous run was saved. None if the previous run ended
    cleanly."""
    return next((it for it in events if it.kind == "incident" and it.fields.get("run") == "before"), None)
