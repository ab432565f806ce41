"""Steps: what a person must do, in order, until the wheels can move. The terminal and the web page use the same table.
Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import Enum
from typing import NamedTuple

from failstop.api import host, verdict, words
from failstop.api.events import Event
from failstop.api.snapshot import Block, Source, State
from failstop.api.words import GUARDED, ON_PAGE
from failstop.messages.layout import GATE
from failstop.policy import causes, servos
from failstop.policy.settings import PAD_SOURCE


class Purpose(Enum):
    """What a step achieves."""

    HEED = "see to the cause of the stop"
    POWER = "make sure that the wheels stand"
    MEND = "bring back what hears a request"
    ALLOW = "bring about what an enable asks for"
    RESET = "clear the latch"
    ENABLE = "allow motion"
    COMMAND = "command a velocity that counts"


REFUSED_WITHOUT = {Purpose.RESET: (Purpose.MEND,), Purpose.ENABLE: (Purpose.MEND, Purpose.ALLOW, Purpose.RESET)}
"""The purposes of the steps that must be done before a reset, and before an enable. While any such step is still to be
done, the service refuses the request."""
POWER = "turn the robot's POWER SWITCH off"
DRIVE = "`failstop drive 0.1 0 0`, or commands by your program"
OR_END = "or end it, `failstop enable`, and start it again"
"""The end of some steps' texts, for a program that never pauses. A program that was already commanding a velocity at
the moment when motion was enabled must pause before it can drive. If it never pauses, people must end it and start it
again."""
LET_GO = "let go of the stick, then push it again"
SENSOR = (
    "start the obstacle sensor and the program that calls robot.sensed(); without an obstacle sensor, set "
    'scan.gate = "off" and restart the service'
)


class Step(NamedTuple):
    """One step for a person, in words."""

    purpose: Purpose
    typed: str
    """The text for a terminal, with commands in backquotes."""
    clause: str | None = None
    """The text for the web page, which names the page's buttons. Empty if the page shows no text for this step. None if
    the page shows the text of `typed`; todo() puts that text here."""

    @property
    def pressed(self) -> str:
        """The step as a sentence for the web page; empty if the page shows none. `clause` must not be None (todo()
        fills it in)."""
        return words.sentence(self.clause) if self.clause else ""


NO_SERVICE = Step(
    Purpose.MEND, "start the service", "if the wheels turn: turn the robot's power switch off. Then start the service"
)
"""The step if no service is running. It is fixed, because without a service there is no state from which the steps
could be found."""
UNREADABLE = Step(
    Purpose.MEND,
    "end what reads the service, and start it again",
    "if the wheels turn: turn the robot's power switch off. Then restart this page's server",
)
"""The step if the service can't be read, usually because it was upgraded while another program read it."""
YOUR_PROGRAM = "start your driving program"
HERE = {"reset": "hold RESET", "attend": "press ATTEND", "enable": "hold ENABLE", "drive": YOUR_PROGRAM}
"""The texts for the web page on a paired device. That page has buttons for resetting, attending and enabling."""
BY_STICK = {**HERE, "drive": "hold the stick to drive"}
"""The texts for the web page on a paired device, if the page also shows a stick for driving."""
ELSEWHERE = {
    "reset": "reset it with a paired device or failstop reset",
    "attend": "with a paired device or failstop attend",
    "enable": "enable motion with a paired device or failstop enable,",
    "drive": YOUR_PROGRAM,
}
"""The texts for the web page on a device that is not paired. That page has no buttons for resetting, attending or
enabling."""


def is_stick(source: Source | None) -> bool:
    """True for a source that a person commands with a stick: the gamepad, or the stick of the operator's page."""
    return source is not None and (source.source == PAD_SOURCE or f" {ON_PAGE} (pid " in source.who)


def _for_the_gate(state: State) -> tuple[str, str]:
    """Two texts, for the terminal and for the page, that ask people to wait for the gate. The supervisor starts the
    gate after a pause."""
    gate = state.processes.get(GATE)
    left_s = (gate.starts_in_s if gate else None) or 0.0
    wait = f"wait {left_s:.0f} s for the {GATE}" if left_s >= 1 else f"wait for the {GATE}"
    return wait, f"{wait}: it died too often, so it restarts after a pause"


def _table(state: State, known: bool, how: Mapping[str, str]) -> list[list[tuple[object, Step]]]:
    """All possible steps, each with the condition under which it is needed. Only the first needed step of each group is
    used. `known`: True if the reader already knows which interlock does not hold. `how`: the texts for the page, HERE,
    BY_STICK or ELSEWHERE."""
    named = {process.state: process.pid for process in state.processes.values()}
    dead, suspended, down = "dead" in named, named.get("suspended"), verdict.down(state)
    doubt, waits, path = verdict.doubt(state), state.waiting_for, state.device.path
    unless = f", unless {verdict.row(state).unless}" if verdict.row(state).unless else ""
    remedy = causes.remedied(state.cause, verdict.reached(state)) if state.cause else ""
    heed = "" if dead else f"{remedy}; then {how['reset']}"
    start = host.start(state.name) if dead else ""
    go_on = f"resume the suspended service (`fg` in its terminal, or `kill -CONT {suspended}`)"
    lost = f"{POWER} if the wheels turn; then plug the board in"
    attend, press = "have somebody attend (`failstop attend`, or the page)", f"somebody has to attend: {how['attend']}"
    complains = ", ".join(client.name for client in state.clients if client.wrong)
    idle = state.block is Block.NO_COMMAND
    guarded = ", ".join(client.name for client in state.clients if client.wrong and client.sees.startswith(GUARDED))
    dumb = next((part for part, text in state.servos_wrong.items() if servos.SILENT_SERVO in text), "")
    held, silent = (found.who if (found := state.source_that(name)) else "" for name in ("held", "silent"))
    held_back, let_go = state.block is Block.HELD, f"have {held or 'that program'} send zero or pause"
    ended = f"{let_go}, or end it, {how['enable']} and start it again"
    off, interlock = not state.enabled and not dead, f"satisfy the interlock ({state.unmet})"
    return [
        [(remedy and not doubt and not suspended, Step(Purpose.HEED, remedy, heed))],
        [
            (dead, Step(Purpose.MEND, start, "start the service again")),
            (suspended, Step(Purpose.MEND, go_on)),
            (state.device.state != "open", Step(Purpose.MEND, f"plug the board in ({path})", lost)),
            (doubt, Step(Purpose.POWER, f"{POWER} and on{unless}", f"{POWER} and on again{unless}")),
            (GATE in down, Step(Purpose.MEND, *_for_the_gate(state))),
            (dumb, Step(Purpose.ALLOW, f"check the {dumb}: its plug on the bus, its power and its id")),
            (waits and not down, Step(Purpose.ALLOW, f"wait for {waits}")),
        ],
        [(state.estop and not dead, Step(Purpose.RESET, "`failstop reset`", how["reset"]))],
        [(off and state.attended_by == (), Step(Purpose.ALLOW, attend, press))],
        [(off and state.unmet, Step(Purpose.ALLOW, "satisfy that interlock" if known else interlock))],
        [
            (
                idle and complains and not guarded,
                Step(Purpose.COMMAND, f"fix what {complains} reports"),
            )
        ],
        [
            (off or dead, Step(Purpose.ENABLE, "`failstop enable`", f"{how['enable']} when nobody is in its way")),
            (state.block is Block.NO_SCAN, Step(Purpose.COMMAND, SENSOR)),
            (held_back and is_stick(state.source_that("held")), Step(Purpose.COMMAND, let_go, LET_GO)),
            (held_back, Step(Purpose.COMMAND, f"{let_go}, {OR_END}", ended)),
            (
                idle and silent,
                Step(
                    Purpose.COMMAND,
                    f"look at {silent}, or `failstop disable` to keep the robot still if it resumes",
                    f"look at {silent}, or disable motion to keep the robot still if it resumes",
                ),
            ),
            (idle and guarded, Step(Purpose.COMMAND, f"fix what is wrong with {guarded}, {OR_END}")),
            (idle, Step(Purpose.COMMAND, DRIVE, how["drive"])),
            (state.block is None, Step(Purpose.COMMAND, DRIVE, "")),
        ],
    ]


def todo(state: State, how: Mapping[str, str] = HERE, *, known: bool = False) -> list[Step]:
    """The steps that are needed, in order. Empty while a velocity is commanded and nothing blocks the wheels. `how`:
    the texts for the page, which are HERE, BY_STICK or ELSEWHERE. `known`: True if the reader already knows which
    interlock does not hold."""
    if state.block is None and state.moving:
        return []
    found = [next((step for needed, step in group if needed), None) for group in _table(state, known, how)]
    return [
        Step(purpose, words.named(typed, state.name), words.plain(typed) if clause is None else clause)
        for purpose, typed, clause in filter(None, found)
    ]


def typed(state: State, *, known: bool = False) -> list[str]:
    """The steps as short texts for a terminal. The remedy for the cause of a stop is left out."""
    return [step.typed for step in todo(state, known=known) if step.purpose is not Purpose.HEED]


def line(state: State) -> str:
    """The steps as short texts for a terminal, in one line."""
    return ", then ".join(typed(state))


def pressed(state: State, how: Mapping[str, str] = HERE, events: Sequence[Event] = ()) -> str:
    """One sentence for the page: the first step. If a stop may not have reached the board, the sentence is about the
    power switch instead, unless the first step is POWER or MEND anyway. Empty if nothing needs to be done."""
    found = [step for step in todo(state, how=how) if step.pressed]
    sure = found and found[0].purpose in (Purpose.MEND, Purpose.POWER)
    if verdict.unanswered(state, events) and not sure:
        return words.sentence(f"{POWER} if the wheels turn: the board has not answered")
    return found[0].pressed if found else ""


def before(state: State, goal: Purpose) -> list[Step]:
    """The steps without which the service refuses this reset or enable."""
    return [step for step in todo(state) if step.purpose in REFUSED_WITHOUT[goal]]


def after_refusal(state: State, goal: Purpose, *, known: bool = False) -> str:
    """The next steps after a refused reset or enable, in one line. Empty if the state no longer shows a reason for a
    refusal: people can then repeat the request. `known`: True if the refusal has named the interlock that does not
    hold."""
    return ", then ".join(typed(state, known=known)) if before(state, goal) else ""
