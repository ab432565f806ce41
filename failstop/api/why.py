"""Why: explains in three lines why the wheels are stopped, what proves it, and what to do. Pure."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from failstop.api import steps, verdict, wheels, words
from failstop.api.events import Event
from failstop.api.snapshot import Block, State, Stop
from failstop.board.interface import BUTTONS
from failstop.policy.causes import PORT_SHARED, Cause, filled, remedied
from failstop.policy.processes import ROLES
from failstop.policy.proofs import (
    ACKNOWLEDGED_BY,
    LINK_UNASKED,
    NO_IMU,
    NOT_SENT,
    SEEN_BY,
    TO_A_STRANGER,
    UNMOVED,
    heard_late,
    unmoved,
    wheels_seen,
)

YET_S = 2.0
"""How long after a stop a missing proof may still come, in seconds. Until then, the text says, for example, "NOT
acknowledged by the board yet". After that, it leaves out "yet"."""


@dataclasses.dataclass(frozen=True)
class Why:
    """The answer to "why are the wheels stopped?". str() returns its three lines, and a line for each fault in
    `also`."""

    what: str
    """Why the wheels are stopped, and since when. If nothing stops them, it says which velocity is commanded, and by
    which program."""
    proof: str
    """What proves that the wheels are stopped. If a latched stop has stopped them, it says how long it took until that
    stop was written, acknowledged and observed; other stops are not timed. At the end it says what is observed at
    present, with the age of the reading."""
    do: tuple[str, ...]
    """The steps to take, in order, with commands in backquotes. Empty while a velocity is commanded and nothing
    blocks the wheels."""
    also: tuple[str, ...]
    """Faults that are not the reason for the stop, but that people should know about."""
    since: float | None
    """When the wheels were stopped (Unix time, s). None if not known."""

    def __str__(self) -> str:
        return "\n".join(f"{label:<7}{text}" for label, text in self.rows())

    def rows(self) -> list[tuple[str, str]]:
        """The lines of the answer, each with its label."""
        found = [("what", self.what), ("proof", self.proof), ("do", ", then ".join(self.do) or "nothing")]
        return [*found, *(("also", text) for text in self.also)]


HOLDS = {
    Block.LATCHED: ("a stop is latched", "A stop is latched."),
    Block.DISABLED: ("motion is disabled", "Motion is disabled, as after every start and every stop."),
    Block.NO_COMMAND: (
        "no program sends commands, or its newest one is older than its timeout",
        "Motion is enabled, but no program sends commands.",
    ),
    Block.HELD: (
        "a program commanded before motion was enabled, so it must send zero or pause before it can drive",
        "Motion is enabled, but a program commanded before that, so it must send zero or pause before it can drive.",
    ),
    Block.NO_SCAN: (
        "the obstacle sensor is silent, and without it only a person may drive",
        "Motion is enabled, but the obstacle sensor is silent.",
    ),
}
"""Two texts for each block: one for a terminal, and a sentence for the web page."""
SINCE = {Block.LATCHED: "a stop has been latched", Block.DISABLED: "motion has been disabled"}
"""The texts that are used for a block if it is known when the block began. The word "since" and the time follow the
text."""
WAITS = (Block.NO_SCAN, Block.NO_COMMAND)
"""The reasons for a block that last until a client, such as a driving program, sends something. The lines that clients
report with say() may explain them."""


def explain(state: State, events: Sequence[Event], now_s: float) -> Why:
    """Explain why the wheels are stopped, or what moves them. `events`: the events of this run, the oldest first.
    Without these events, the answer says less."""
    start, began = since(state, events, now_s)
    what = _holds(state) if state.block else _free(state)
    if state.block and start is not None:
        what = f"{SINCE.get(state.block, what)} since {words.ago(start, now_s)}"
    also = troubles(state, events)
    if doubt := verdict.doubt(state):
        row = verdict.row(state)
        unless = f", unless {row.unless}" if row.unless else ""
        switch = f"use the POWER SWITCH{unless}" if row.large != verdict.WHEELS_MAY_TURN else "if they do: POWER SWITCH"
        what = f"THE {row.large} ({switch}): {doubt}; {what}"
    elif verdict.unproven(state):
        what = f"{verdict.proven_word(state)}; {what}"
    if (before := verdict.before(events)) and not state.last_stop and state.block is Block.DISABLED:
        also.append(f"the run before this one: {before}")
    return Why(
        what=": ".join(filter(None, (what, began))),
        proof=f"{_proof(state, events, now_s)}; now: {wheels.now(state)}",
        do=tuple(step.typed for step in steps.todo(state)),
        also=tuple(words.named(text, state.name) for text in also),
        since=start,
    )


def _holds(state: State) -> str:
    """A text about why the wheels are stopped."""
    if state.block is Block.HELD and (source := state.source_that("held")):
        return f"{source.who} commanded before motion was enabled, so it must send zero or pause before it can drive"
    if state.block is Block.NO_COMMAND and (source := state.source_that("silent")):
        return f"{source.who} stopped sending commands, so the wheels were stopped; if it resumes, they turn again"
    return HOLDS[state.block][0] if state.block else ""


def meaning(cause: Cause, reached: str = "") -> tuple[str, str]:
    """Return two texts that continue a sentence: what has happened, and what to check before a reset. `reached`: the
    text from verdict.reached()."""
    given = cause.named()
    given["role"] = ROLES.get(str(given.get("process")), "")
    given["names"] = _buttons(int(given.get("buttons", 0)))
    what, doubt = filled(cause.kind.what, given), cause.kind.doubt
    if doubt:
        what += f"; {reached}" if reached else f", {doubt}"
    return what, remedied(cause, reached)


def _buttons(pressed: int) -> str:
    """The names of the buttons that were pressed. A button without a name is shown as a number."""
    names = [name for name, bit in BUTTONS.items() if pressed & bit]
    names += [f"0x{1 << bit:04X}" for bit in range(16) if pressed & 1 << bit and 1 << bit not in BUTTONS.values()]
    return " and ".join(names)


def _free(state: State) -> str:
    how = words.velocity(*state.body_vel) or "zero"
    driver = state.driver
    if driver and verdict.unheeded(state):
        return f"{driver} commands {how}"
    if driver:
        return f"driving: {driver} commands {how}"
    return f"motion is enabled, and the command is {how}"


def since(state: State, events: Sequence[Event], now_s: float) -> tuple[float | None, str]:
    """When the present block began (Unix time, s; None if not known), and a text about its cause."""
    stop = state.last_stop
    if state.cause:
        begun = stop.t if stop and stop.cause == state.cause else None
        return begun, meaning(state.cause, verdict.reached(state))[0]
    if state.block is Block.NO_SCAN:
        age_s = state.scan_age_s
        never = "it has sent nothing in this run"
        return None, never if age_s is None else f"it last sent something {words.span(age_s)} ago"
    if state.block is Block.DISABLED:
        change = verdict.newest(events, verdict.CHANGES)
        if change and change.kind == "ready":
            return change.t, "nobody has enabled motion since the service was started"
        return (change.t, change.what.removeprefix("motion disabled: ")) if change else (None, "")
    if state.block is Block.NO_COMMAND and (event := verdict.left_off(events)):
        # The time is not returned, because the program may have driven since, and not every start is reported.
        return None, f"{event.text} ({words.ago(event.t, now_s)})"
    return None, ""


UNTIMED = "this stop was not timed: failstop times only latched stops"
FORGOTTEN = "the events since then are not remembered, so the wheels may have turned and stopped again"
"""Replaces the proofs of the last latched stop if verdict.remembered() is False."""


def _proof(state: State, events: Sequence[Event], now_s: float) -> str:
    """What proves that the wheels are stopped, as text. If the last latched stop is why they are stopped, the text
    gives the proofs of that stop. If not, the text says only what the board's answers prove."""
    stop = state.last_stop
    if stop and _explains(stop, state, events):
        which = "" if state.cause else f"the last stop ({stop.reason}; {words.ago(stop.t, now_s)}): "
        told = ", ".join(text for text, _ in proofs(stop, now_s, state.device.link))
        if stop.written_s is None and not verdict.doubt(state):
            told += " at first; the port is open now, and the board is told to stop"
        return f"{which}{told}"
    told = verdict.link(state)
    if state.block is Block.DISABLED and (change := verdict.newest(events, verdict.CHANGES)):
        told += f"; {UNTIMED}" * (change.kind in verdict.UNLATCHED)
    return told if state.block in (None, Block.LATCHED) else f"the board is told to stop; {told}"


def _explains(stop: Stop, state: State, events: Sequence[Event]) -> bool:
    """True if this stop is why the wheels are stopped. That holds while it is latched, and after its reset until
    something enables or disables motion. False if that can't be known, because the events since then are not
    remembered."""
    if state.block is not Block.DISABLED:
        return stop.cause == state.cause
    change = verdict.newest(events, verdict.CHANGES)
    return change.kind in ("stop", "reset") if change else verdict.remembered(state, events)


def proofs(stop: Stop, now_s: float, link: str = "") -> list[tuple[str, bool | None]]:
    """The three proofs of a stop, each as (text, proven). `proven` is True, False, or None if no proof is possible: the
    wheels were already still before the stop, nothing observes them, or this board never acknowledges a stop. A stop
    that could not be written has only one text, which says so. `link`: the state of the connection to the board."""
    if stop.written_s is None:
        return [("it could NOT be written", False)]
    yet = " yet" if 0 <= now_s - stop.t < YET_S else ""
    written = f"written by the {stop.written_by.replace('_', ' ')} after {words.took(stop.written_s)}"
    if not stop.believed:
        written += f" {TO_A_STRANGER}"
    late = heard_late(stop.cause.named().get("process"))
    heard, by = f"NOT acknowledged by the board{yet}", stop.observed_by
    seen = f"NOT seen still by {SEEN_BY[by]}{yet}" if by else NO_IMU
    if not stop.acknowledged_by:
        heard = "this board never acknowledges a stop"
    elif stop.acknowledged_s is not None:
        heard = f"acknowledged by {ACKNOWLEDGED_BY[stop.acknowledged_by]} after {words.took(stop.acknowledged_s)}"
        heard += late
    elif link == LINK_UNASKED:
        heard = UNMOVED if unmoved(stop.observed_s, by) else f"NOT acknowledged by the board's echo{yet}"
    if stop.observed_s is not None:
        seen = wheels_seen(stop.observed_s, by, late=stop.observed_late) + late * (stop.observed_s > 0)
    return [
        (written if stop.sent else NOT_SENT, stop.sent and stop.believed),
        (heard, stop.acknowledged_s is not None if stop.acknowledged_by else None),
        (seen, None if stop.observed_s == 0 or not by else stop.observed_s is not None),
    ]


def troubles(state: State, events: Sequence[Event]) -> list[str]:
    """Faults other than the reason for the stop, in words, including the faults that clients report. While the wheels
    wait for a client (WAITS), the texts also say what clients see."""
    found = []
    ends = verdict.ends(state, events)
    for name, process in state.processes.items():
        if process.state != "running":
            found.append(f"{name} {verdict.absence(process, ends[name] if process.last_exit else '')}")
    if state.device.state == "open" and state.device.link == "unproven":
        unknown = f"{verdict.NEVER_ANSWERED}, so no stop is known to reach the wheels"
        found.append(f"{unknown}: check its power and its cable; {PORT_SHARED}")
    found += [text for text in (state.scale.capped, *state.scale.wrong) if text]
    found += [f"{part}: {text}" for part, text in state.servos_wrong.items()]
    if state.starved:
        found.append(f"{state.starved} (`failstop doctor` says what helps)")
    if not all(process.early_news for process in state.processes.values() if process.pid):
        found.append("this kernel reports deaths late, so stops after a death come later (`failstop doctor` says more)")
    if state.age_s > verdict.STALE_S:
        found.append(f"the gate has said nothing for {words.span(state.age_s)}, so this may be old")
    if state.arm:
        found += [f"the arm: {text}" for text in state.arm.wrong]
    for who, sees, wrong in words.said(state):
        # Not "says", because the guard reports about a driver under the driver's name.
        if wrong:
            found.append(f"{who}: {wrong}")
        elif state.block in WAITS:
            found.append(f"{who}: {sees}")
    return found
