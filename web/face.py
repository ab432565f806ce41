"""Face: what the page shows of a state, as plain values. Pure: the times are arguments.

The word is for arm's length; the reason is one sentence; the next step is what a person does, by the buttons of the
page and not by commands.
"""

from __future__ import annotations

from typing import Any

from failstop.api import verdict, words
from failstop.api.why import meaning, troubles
from failstop.shm import blocks
from failstop.shm.layout import GATE
from failstop.supervisor.stops import wheels_seen

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

    from failstop.api.events import Event
    from failstop.api.state import State, Stop

MOVING = "MOVING"
STOPPED = "STOPPED"
CAN_MOVE = "CAN MOVE"
MAY_TURN = "WHEELS MAY TURN"
NO_SERVICE = "NO SERVICE"
ROLES = {MOVING: "moves", STOPPED: "stopped", CAN_MOVE: "free", MAY_TURN: "bad", NO_SERVICE: "bad"}

BLOCKS = {
    blocks.DISABLED: "Motion is disabled, as after every start and every stop.",
    blocks.NO_COMMAND: "Motion is enabled, and nobody commands.",
    blocks.NO_SCAN: "Motion is enabled, but the obstacle sensor is silent.",
}
POWER = "Turn the robot's POWER SWITCH off"
MOST_EVENTS = 40


def face(state: State, events: Sequence[Event], now_s: float) -> dict[str, Any]:
    """Everything that changes seldom. `events`: of this run, oldest first."""
    word = _word(state)
    return {
        "name": state.name,
        "word": word,
        "role": ROLES[word],
        "why": _why(state),
        "since": _since(state, events),
        "next": _next(state),
        "latched": state.estop is not None,
        "enabled": state.enabled,
        "can": {"reset": _no_reset(state), "enable": _no_enable(state), "disable": _no_disable(state)},
        "stop": stop_of(state.last_stop),
        "limit": round(100 * state.speed_limit),
        "driver": next((f"{row.who} as {row.source}" for row in state.sources if row.state == "drives"), ""),
        "battery_v": state.battery_v,
        "plugged": state.plugged,
        "port": f"{state.device.path} {state.device.state}",
        "link": state.device.link,
        "clients": [f"{client.name} (pid {client.pid})" for client in state.clients],
        "attended": state.attended_by,
        "processes": [
            {"name": name.replace("_", " "), "state": process.state, "restarts": process.restarts}
            for name, process in state.processes.items()
        ],
        "troubles": [sentence(text) for text in troubles(state, events)],
        "events": [
            {"seq": event.seq, "t": event.t, "kind": event.kind, "level": event.level, "text": plain(event.text)}
            for event in events[-MOST_EVENTS:]
        ],
    }


def live(state: State, vibration_radps: float | None) -> list[Any]:
    """What changes all the time: forward, left, turn, vibration (mrad/s, None: the IMU is silent), age of the gate's
    word (ms)."""
    shake = None if vibration_radps is None else round(vibration_radps * 1e3, 2)
    return [*(round(value, 3) for value in state.body_vel), shake, round(state.age_s * 1e3)]


def absent(note: str) -> dict[str, Any]:
    """The same as `face` where no service runs."""
    return {
        "name": "",
        "word": NO_SERVICE,
        "role": ROLES[NO_SERVICE],
        "why": sentence(note),
        "since": None,
        "next": f"If the wheels turn: {POWER.lower()}. Then start the service.",
        "latched": False,
        "enabled": False,
        "can": dict.fromkeys(("reset", "enable", "disable"), "no service runs"),
        "stop": None,
        "limit": 100,
        "driver": "",
        "battery_v": None,
        "plugged": "unknown",
        "port": "",
        "link": "",
        "clients": [],
        "attended": None,
        "processes": [],
        "troubles": [],
        "events": [],
    }


def stop_of(stop: Stop | None) -> dict[str, Any] | None:
    """The last stop with its three times in words; an empty text: not known (yet)."""
    if stop is None:
        return None
    return {
        "reason": stop.reason,
        "t": stop.t,
        "written": "" if stop.written_s is None else words.took(stop.written_s),
        "acknowledged": "" if stop.acknowledged_s is None else words.took(stop.acknowledged_s),
        "observed": "" if stop.observed_s is None else _seen(stop.observed_s),
    }


def _seen(observed_s: float) -> str:
    """The third proof, short."""
    return wheels_seen(observed_s).replace("wheels still", "still").replace("less than", "<")


def sentence(text: str) -> str:
    """A capital at its beginning, a full stop at its end."""
    text = plain(text).strip()
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith(('.', '!', '?')) else '.'}"


def plain(text: str) -> str:
    """Without the backquotes of commands."""
    return text.replace("`", "")


def _word(state: State) -> str:
    if verdict.doubt(state):
        return MAY_TURN
    if state.moving:
        return MOVING
    return CAN_MOVE if state.enabled and not state.estop else STOPPED


def _why(state: State) -> str:
    if doubt := verdict.doubt(state):
        return sentence(doubt)
    if state.cause:
        return sentence(meaning(state.cause)[0])
    if state.blocked:
        return BLOCKS.get(state.blocked) or sentence(state.blocked)
    return sentence(words.velocity(*state.body_vel) or "The command is zero")


def _since(state: State, events: Sequence[Event]) -> float | None:
    """Since when it is stopped, Unix time; None: not known, or not stopped."""
    if state.cause and state.last_stop and state.last_stop.cause == state.cause:
        return state.last_stop.t
    if state.blocked == blocks.DISABLED:
        change = verdict.newest(events, verdict.CHANGES)
        return change.t if change else None
    return None


def _next(state: State) -> str:
    """One step; empty while it moves."""
    if any(process.state == "dead" for process in state.processes.values()):
        return "Start the service again."
    if state.device.state != "open":
        return f"{POWER} if the wheels turn; then plug the board in."
    if verdict.doubt(state):
        return f"{POWER} and on again."
    if state.cause:
        return f"{sentence(meaning(state.cause)[1])[:-1]}; then hold RESET."
    if missing := _waits(state):
        return sentence(missing)
    if not state.enabled and state.attended_by == ():
        return "Somebody has to attend: press ATTEND."
    if not state.enabled:
        return "Hold ENABLE when nobody is in its way."
    if state.blocked == blocks.NO_SCAN:
        return "Start the obstacle sensor and the program that calls robot.sensed()."
    if state.blocked == blocks.NO_COMMAND:
        return "Start what is to drive."
    return ""


def _waits(state: State) -> str:
    if GATE in verdict.down(state):
        return "wait: the gate died too often and is tried again within a minute"
    if state.waiting_for and not verdict.down(state):
        return f"wait for {state.waiting_for}"
    return ""


def _no_reset(state: State) -> str:
    """What stands in the way of a reset; empty when nothing does."""
    if not state.estop:
        return "nothing is latched"
    if state.device.state != "open":
        return "the board is not there"
    return ""


def _no_enable(state: State) -> str:
    if state.enabled:
        return "motion is enabled already"
    if state.estop:
        return "a stop is latched: reset first"
    return "nobody attends: press ATTEND first" if state.attended_by == () else _waits(state)


def _no_disable(state: State) -> str:
    return "" if state.enabled else "motion is disabled already"
