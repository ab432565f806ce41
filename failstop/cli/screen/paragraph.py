"""Paragraph: what holds the wheels, since when, why, what proof the stop has, what clears it, in plain words. Pure."""

from __future__ import annotations

import dataclasses
from typing import Any

from failstop.api.state import State, Stop
from failstop.cli.screen import history, reasons, verdict, words
from failstop.policy.processes import ROLES
from failstop.shm import blocks

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

    from failstop.api.events import Event
    from failstop.cli.screen.left import Left

NO_SERVICE = "no service"
SAVED = "its black box is in memory, and is saved as an incident when it is started again"
YET_S = 2.0
"""By then everything that will be known of a stop is known."""
CHANGES = frozenset(("ready", "enabled", "disabled", "reset", "stop"))
"""Events that change whether motion is enabled."""


@dataclasses.dataclass(frozen=True)
class Block:
    """One block reason of the gate: what holds the wheels, and what clears it."""

    holds: str
    clears: str


BLOCKS = {
    blocks.LATCHED: Block(
        "a stop is latched, and it stays until somebody resets it",
        "a reset clears the latch alone; motion needs to be enabled after it",
    ),
    blocks.DISABLED: Block(
        "motion is disabled, as it is after every start and every latched stop",
        "enabling it is a decision of a person or a program, and is never made by itself",
    ),
    blocks.NO_COMMAND: Block(
        "motion is enabled, but nobody commands: no source has a command that is younger than its timeout (0.3 s "
        "unless the settings say otherwise)",
        "the next command moves them",
    ),
    blocks.NO_SCAN: Block(
        "motion is enabled, but the obstacle sensor is silent; without it only a person may drive (teleop, gamepad)",
        "motion resumes by itself, from zero, when the sensor delivers again",
    ),
}


@dataclasses.dataclass(frozen=True)
class Explanation:
    """The answer to "why do the wheels stand?", in parts and as one paragraph."""

    blocked: str | None
    since: float | None
    """Unix time; None: not known."""
    cause: str
    proof: str
    next: list[str]
    """What to do, in order."""
    text: str

    def as_dict(self) -> dict[str, Any]:
        """Plain values, as in `failstop why --json`."""
        return dataclasses.asdict(self)


def block(state: State) -> Block | None:
    """The row of what blocks now; None when nothing does."""
    if state.blocked is None:
        return None
    kind = blocks.LATCHED if state.blocked.startswith(blocks.LATCHED) else state.blocked
    return BLOCKS.get(kind) or Block(f"the gate blocks them: {state.blocked}", "")


def explain(state: State, events: Sequence[Event], now_s: float) -> Explanation:
    """The whole answer; `events`, oldest first, may be empty, and then less is known."""
    row = block(state)
    todo = verdict.steps(state)
    if row is None:
        said = _sentences(_free(state), *_troubles(state, events), _advice(state, ""))
        return Explanation(None, None, "", "", todo, said)
    stop = state.last_stop
    since, cause = _since(state, events, now_s)
    proof, see_to = "", ""
    if state.cause:
        told, see_to = reasons.explain(state.cause)
        cause = f"it was latched because {told}"
    if stop and (state.blocked == blocks.DISABLED or stop.cause == state.cause):
        proof = _proof(stop, state, now_s)
    head = _head(state, row, "" if since is None else f" since {words.ago(since, now_s)}")
    before = _before(state, events, now_s)
    text = _sentences(*head, cause, proof, before, *_troubles(state, events), _advice(state, see_to), row.clears)
    return Explanation(state.blocked, since, cause, proof, todo, words.named(text, state.name))


def gone(found: Left, now_s: float) -> Explanation:
    """The same of a service that has died: `found` is what it has left."""
    what = f"{found.cause} (pid {found.pid}; {words.ago(found.t, now_s)}) without being told to end"
    cause = f"no service named {found.name!r} runs: {what}"
    doubt = "THE WHEELS MAY TURN. If they do, use the POWER SWITCH" if found.stop is None else ""
    todo = found.steps()
    settings = "a configuration file that it had is not known here: name it with --config" if found.by_hand() else ""
    text = _sentences(doubt, cause, found.written(), f"what to do: {', then '.join(todo)}", settings, SAVED)
    return Explanation(NO_SERVICE, found.t, cause, found.written(), todo, text)


def _head(state: State, row: Block, since: str) -> tuple[str, ...]:
    """Whether the wheels stand, as far as is known, and what holds them."""
    if doubt := verdict.doubt(state):
        return (
            f"THE WHEELS MAY TURN: {doubt}. If they do, use the POWER SWITCH",
            f"nothing may drive{since}: {row.holds}",
        )
    return (f"the wheels stand{since}: {row.holds}",)


def _free(state: State) -> str:
    """Nothing blocks: who drives, and how."""
    how = words.velocity(*state.body_vel) or "zero, so the wheels stand"
    if row := state.driver:
        return f"nothing holds the wheels: {row.who} drives as {row.source}, {how}"
    return f"nothing holds the wheels: the command is {how}"


def _since(state: State, events: Sequence[Event], now_s: float) -> tuple[float | None, str]:
    """Since when this block holds, as far as is known, and what began it."""
    stop = state.last_stop
    if state.estop:
        return (stop.t if stop and stop.cause == state.cause else None), ""
    if state.blocked == blocks.NO_SCAN:
        if state.scan_age_s is None:
            return None, "it has not delivered once since the service was started"
        return None, f"it delivered last {words.span(state.scan_age_s)} ago"
    if state.blocked == blocks.DISABLED:
        change = next((event for event in reversed(events) if event.kind in CHANGES), None)
        if change:
            return change.t, f"what was said then: {change.text.partition('; next: ')[0]}"
    if state.blocked == blocks.NO_COMMAND and (event := history.left_off(events)):
        return None, _left_off(event, state, now_s)
    return None, ""


def _left_off(event: Event, state: State, now_s: float) -> str:
    """Who drove and did not stop in order. It may have driven on since: that is not told of each time."""
    text = f"the last that is known of a driver: {history.leaving(event)} ({words.ago(event.t, now_s)})"
    who = event.fields.get("who")
    if any(who == f"{client.name} (pid {client.pid})" for client in state.clients):
        text += "; it is still connected, so it hangs, waits, or commands too seldom"
    return text


def _before(state: State, events: Sequence[Event], now_s: float) -> str:
    """That the run before this one was not ended in order."""
    found = history.earlier(events)
    if found is None or state.last_stop or state.blocked != blocks.DISABLED:
        return ""
    return (
        f"the service was started anew after it had ended without being told to: {found.how} "
        f"({words.ago(found.t, now_s)}); its story: {found.show(state.name)}"
    )


def _proof(stop: Stop, state: State, now_s: float) -> str:
    """The three levels of the last stop."""
    which = "the stop" if state.estop else f"the last stop ({stop.reason}; {words.ago(stop.t, now_s)})"
    if stop.written_s is None:
        if verdict.doubt(state):
            return f"{which} could NOT be written to the port"
        return (
            f"{which} could NOT be written at first; the port is open now, and the board is told zero 5 times a second"
        )
    yet = " yet" if 0 <= now_s - stop.t < YET_S else ""
    by = stop.written_by.replace("_", " ")
    found = [f"{which} was written to the port by the {by} {words.took(stop.written_s)} after its cause was noticed"]
    if stop.acknowledged_s is None:
        found.append(f"the board has not acknowledged it{yet}")
    else:
        found.append(f"the board acknowledged it after {words.took(stop.acknowledged_s)}")
    if stop.observed_s is None:
        found.append(f"the IMU has not shown the wheels still{yet}")
    elif stop.observed_s:
        found.append(f"the IMU showed the {words.wheels_seen(stop)}")
    else:
        found.append("the IMU saw no shaking before it or after")
    return words.joined(found)


def _troubles(state: State, events: Sequence[Event]) -> list[str]:
    """What else is wrong and keeps the wheels from moving, or may."""
    found = []
    hung = history.exits(events)
    for name, process in state.processes.items():
        if process.state == "down":
            found.append(
                f"{name} died too often (it {history.last_exit(state, name, hung)}) and is {verdict.until(name)}"
            )
        elif process.state != "running":
            after = f", after it {history.last_exit(state, name, hung)}" if process.last_exit else ""
            found.append(f"{name} is {process.state}{after}")
    if state.device.state == "open" and state.device.link == "unproven":
        found.append("the board has not answered a ping since the port was opened, so nobody knows that it hears")
    elif state.waiting_for and not found and not verdict.doubt(state):
        found.append(f"the service waits for {state.waiting_for}")
    if starved := words.starved(state.starved):
        found.append(f"{starved} (`failstop doctor` has the command that gives it real-time rights)")
    if state.age_s > verdict.STALE_S:
        found.append(f"the gate has said nothing for {words.span(state.age_s)}, so this may be old")
    if state.arm:
        found += [f"the arm: {text}" for text in state.arm.wrong]
    return found + _said(state)


def _said(state: State) -> list[str]:
    """What is wrong by a client's own account; and what it sees, where the wheels wait for its kind."""
    found = []
    for who, sees, wrong in words.said(state):
        if wrong:
            found.append(f"the client {who} says: {wrong}")
        elif state.blocked in (blocks.NO_SCAN, blocks.NO_COMMAND):
            found.append(f"the client {who} says: {sees}")
    return found


def _advice(state: State, see_to: str) -> str:
    """What to do now."""
    step = verdict.next_step(state)
    if not step:
        return ""
    first = f"first {see_to}; then " if see_to and not verdict.doubt(state) else ""
    return f"what to do: {first}{step}"


def _sentences(*parts: str) -> str:
    """The parts that there are as sentences. A text that begins with a name keeps its case."""
    return " ".join(f"{_capital(part)}." for part in parts if part)


def _capital(text: str) -> str:
    first = text.split(" ", 1)[0]
    return text if first in ROLES else text[:1].upper() + text[1:]
