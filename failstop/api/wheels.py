"""Wheels: decides what a screen may say about the wheels, from what is commanded and what is observed. Pure.

Only `State.turning` says what the wheels really do. The cause of a latched stop does not, because wheels that were seen
still after a stop may turn again hours later.
"""

from __future__ import annotations

import enum
from math import tau
from typing import NamedTuple

from failstop.api import words
from failstop.policy.proofs import ALTHOUGH_TOLD_ZERO

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.api.snapshot import State

DRIVING = "DRIVING"
STANDING = "STANDING"
"""Zero is commanded, and the wheels are seen to be still. Unlike with STOPPED, nothing blocks the wheels, so a command
can move them at any time."""
STOPPED = "STOPPED"
"""Zero is commanded, and the wheels are seen to be still."""
STOPPING = "STOPPING"
"""Zero is commanded, and the wheels still move. This is normal until the setting still.after_s has passed."""
TOLD_TO_STOP = "TOLD TO STOP"
"""Zero is commanded, and nothing shows whether the wheels obey."""
TURNING = "TURNING"
"""The board reports that the wheels turn, although zero is commanded or commands may not reach the board."""
MOVED = "MOVED"
"""The IMU feels that the robot moves, although zero is commanded or commands may not reach the board. The robot moves
by itself, or somebody moves it."""
MAY_TURN = "MAY TURN"
"""It is not known whether the wheels turn. Either commands may not reach the board, or the newest reading is too old to
rely on and showed that the wheels were turning."""
MOVING, CAN_MOVE, WRITTEN, WHEELS_MAY_TURN = "MOVING", "CAN MOVE", "STOP WRITTEN", "WHEELS MAY TURN"
WHEELS_TURN, ROBOT_MOVES = "WHEELS TURN", "ROBOT MOVES"
"""These words are used only on a screen that people read from a distance. Such a screen also uses STOPPED, STOPPING and
TOLD TO STOP."""


class Commanded(enum.Enum):
    """What the wheels are commanded to do."""

    ZERO = "zero"
    MOTION = "motion"
    NOBODY_KNOWS = "nobody knows"
    """Commands may not reach the board, so nobody knows which command the board obeys."""


class Seen(enum.Enum):
    """What is observed about the wheels."""

    TURN = "they turn"
    TURN_ON = "they turn although they were told zero for longer than they may"
    MOVE = "the IMU feels the robot move"
    MOVE_ON = "it feels that although the wheels were told zero for longer than they may move"
    STILL = "they are still"
    TURNED = "they turned at the newest reading, which is too old to say anything of now"
    UNREAD = "no reading says what they do now"
    UNSEEN = "nothing has ever reported it"


class Row(NamedTuple):
    """What a screen may say about the wheels."""

    word: str
    large: str
    """The word for a screen that people read from a distance."""
    text: str = ""
    """A clause that a screen adds to the word. Empty if the word is enough."""
    alarm: bool = False
    """True if the wheels turn, or may turn, although nobody wants that."""
    unless: str = ""
    """A harmless reason why the wheels turn, for example "somebody pushes it". Screens advise people to use the power
    switch unless this reason applies."""


_UNKNOWN = "the wheels are told to stop, but nothing shows what they do now"
_UNSEEN = "the wheels are told to stop, but nothing reports what they do"
_TURN_ON, _MOVE_ON = ALTHOUGH_TOLD_ZERO["wheels"], ALTHOUGH_TOLD_ZERO["IMU"]
_TURNED = "the wheels were turning at the last reading, and there is no newer one"
_DRIVES = Row(DRIVING, MOVING)
_NO_STOP = Row(MAY_TURN, WHEELS_MAY_TURN, alarm=True)
TABLE: dict[tuple[Commanded, Seen], Row] = {
    (Commanded.ZERO, Seen.TURN): Row(STOPPING, STOPPING, "the wheels are told to stop, but still turn"),
    (Commanded.ZERO, Seen.TURN_ON): Row(TURNING, WHEELS_TURN, _TURN_ON, True, "somebody pushes it"),
    (Commanded.ZERO, Seen.MOVE): Row(STOPPING, STOPPING, "the wheels are told to stop, but the robot still moves"),
    (Commanded.ZERO, Seen.MOVE_ON): Row(MOVED, ROBOT_MOVES, _MOVE_ON, True, "somebody moves it"),
    (Commanded.ZERO, Seen.STILL): Row(STOPPED, STOPPED),
    (Commanded.ZERO, Seen.TURNED): Row(MAY_TURN, WHEELS_MAY_TURN, _TURNED, True),
    (Commanded.ZERO, Seen.UNREAD): Row(TOLD_TO_STOP, TOLD_TO_STOP, _UNKNOWN),
    (Commanded.ZERO, Seen.UNSEEN): Row(TOLD_TO_STOP, TOLD_TO_STOP, _UNSEEN),
    **{(Commanded.MOTION, seen): _DRIVES for seen in Seen},
    **{(Commanded.NOBODY_KNOWS, seen): _NO_STOP for seen in Seen},
    (Commanded.NOBODY_KNOWS, Seen.TURN): Row(TURNING, WHEELS_TURN, "the wheels turn", True),
    (Commanded.NOBODY_KNOWS, Seen.TURN_ON): Row(TURNING, WHEELS_TURN, _TURN_ON, True),
    (Commanded.NOBODY_KNOWS, Seen.MOVE_ON): Row(MOVED, ROBOT_MOVES, _MOVE_ON, True),
}
"""What a screen may say for each combination of command and observation. Seen.UNSEEN is for a robot that can't observe
its wheels: it has no IMU, and its board reports nothing about the wheels. That alone is no reason for an alarm."""

SEEN = {
    Seen.TURN: "the wheels turn",
    Seen.TURN_ON: _TURN_ON,
    Seen.MOVE: "the robot moves, or is being moved",
    Seen.MOVE_ON: _MOVE_ON,
    Seen.STILL: "the wheels are still",
    Seen.TURNED: "not known; at the last reading the wheels were turning",
    Seen.UNREAD: "not known",
    Seen.UNSEEN: "not known: nothing reports what the wheels do",
}
"""A text for each observation."""
SAYS = {"wheels": "by the board's reports", "IMU": "by the IMU"}
"""A text for the observer that `Turning.by` names."""


def seen(state: State) -> Seen:
    """What is observed about the wheels at present."""
    known = state.turning
    if known.does == "still":
        return Seen.STILL
    if known.does == "turning" and known.by == "IMU":
        return Seen.MOVE_ON if known.unexpected else Seen.MOVE
    if known.does == "turning":
        return Seen.TURN_ON if known.unexpected else Seen.TURN
    if known.last == "turning":
        return Seen.TURNED
    return Seen.UNSEEN if known.age_s is None and state.imu is None else Seen.UNREAD


def commanded(state: State, unreached: str) -> Commanded:
    """What the wheels are commanded to do. `unreached`: the text from verdict.unreached()."""
    if unreached:
        return Commanded.NOBODY_KNOWS
    return Commanded.MOTION if state.moving else Commanded.ZERO


def row(state: State, unreached: str) -> Row:
    """What a screen may say about the wheels. `unreached`: the text from verdict.unreached()."""
    return TABLE[commanded(state, unreached), seen(state)]


def now(state: State) -> str:
    """What is observed about the wheels, as text: what they do, their speeds if the board reports these, who observes
    it, and how old the reading is."""
    known, found = state.turning, seen(state)
    text = SEEN[found]
    if found is Seen.STILL and known.by == "IMU":
        # An IMU can't feel wheels that turn in the air, or a robot that drives slowly.
        return f"the IMU feels no movement ({words.span(known.age_s or 0.0)} ago)"
    if found in (Seen.TURN, Seen.TURN_ON, Seen.TURNED) and (how := speeds(state)):
        text += f": {how}"
    if known.by:
        text += f" ({SAYS[known.by]}, {words.span(known.age_s or 0.0)} ago)"
    elif known.age_s is not None:
        text += f" (last read {words.span(known.age_s)} ago)"
    elif found is Seen.UNREAD:
        text += " (the IMU can't tell yet)"
    return text


def speeds(state: State) -> str:
    """The measured speed of each wheel in turns per second, positive forward, as text. Empty if the board reports no
    speeds."""
    measured = state.turning.speeds_radps
    if measured is None:
        return ""
    each = (
        f"{name.replace('_', ' ')} {radps / tau:+.2f}" for name, radps in zip(measured.names, measured, strict=True)
    )
    return f"{', '.join(each)} turns/s"
