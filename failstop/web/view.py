"""View: turns the robot's state into the plain values that the page shows. Pure: times are arguments.

The page shows one large word that can be read from a distance, a reason in one sentence, and the next step. The next
step uses the page's buttons, not a command.
"""

from __future__ import annotations

from typing import Any

from failstop.api import distance, steps, verdict, wheels, words
from failstop.api.snapshot import Block
from failstop.api.steps import Purpose
from failstop.api.why import FORGOTTEN, HOLDS, UNTIMED, meaning, since, troubles
from failstop.policy import proofs

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

    from failstop.api.events import Event
    from failstop.api.state import State, Stop

BAD = "bad"
"""The colour role of the large word if the wheels may be turning, if nobody knows whether they turn, or if no service
is running."""
ROLES = {
    **dict.fromkeys((verdict.MOVING, verdict.WRITTEN, verdict.STOPPING), "moves"),
    **dict.fromkeys((verdict.STOPPED, verdict.TOLD_TO_STOP), "stopped"),
    verdict.CAN_MOVE: "free",
}
STICK_HELD = "Let go of the stick, then push it again: it was pushed before motion was enabled."
MOST_EVENTS = 40


def view(state: State, events: Sequence[Event], now_s: float) -> dict[str, Any]:
    """Return all values that change seldom. `events`: the events of this run, the oldest first."""
    state = verdict.seen_since(state, events, now_s)
    word = verdict.large_word(state, events)
    return {
        "name": state.name,
        "word": word,
        "role": BAD if verdict.unproven(state) else ROLES.get(word, BAD),
        "why": _why(state),
        "since": since(state, events, now_s)[0],
        "epoch": state.epoch,
        "run": state.run,
        "next": steps.pressed(state, steps.HERE, events),
        "next_driver": steps.pressed(state, steps.BY_STICK, events),
        "next_unpaired": steps.pressed(state, steps.ELSEWHERE, events),
        "latched": state.estop is not None,
        "enabled": state.enabled,
        "can": _obstacles(state),
        "stop": stop_of(state.last_stop),
        "unlatched": unlatched_of(verdict.unlatched(state, events), known=verdict.remembered(state, events)),
        "limit": round(100 * state.speed_limit),
        "stands": distance.WITHIN.format(state.stands_within_m),
        "driver": str(state.driver or ""),
        "battery_v": state.battery_v,
        "battery_age": words.aged(state.ages.battery_s, current=state.is_current(0.0)),
        "plugged": state.plugged,
        "port": f"{state.device.path} {state.device.state}",
        "board": words.sentence(verdict.link(state)) if state.device.state == "open" else "not known",
        "imu": state.device.imu,
        "clients": [f"{client.name} (pid {client.pid})" for client in state.clients],
        "attended": state.attended_by,
        "processes": [
            {"name": name.replace("_", " "), "state": process.state, "restarts": process.restarts}
            for name, process in state.processes.items()
        ],
        "troubles": [words.sentence(text) for text in troubles(state, events)],
        "events": [
            {"seq": event.seq, "t": event.t, "kind": event.kind, "level": event.level, "text": words.plain(event.text)}
            for event in events[-MOST_EVENTS:]
        ],
    }


def live(state: State, vibration_radps: float | None) -> list[Any]:
    """Return the values that change all the time: the speed forward (m/s), the speed to the left (m/s), the turning
    speed (rad/s), the vibration (mrad/s, None while the IMU is silent), the age of the gate's record (ms), the steering
    in words, and what the wheels are seen to do."""
    shake = None if vibration_radps is None else round(vibration_radps * 1e3, 2)
    steered = "" if state.steering_rad is None else words.steering(state.steering_rad)
    return [*(round(value, 3) for value in state.body_vel), shake, round(state.age_s * 1e3), steered, wheels.now(state)]


def absent(note: str, *, gone: bool = True) -> dict[str, Any]:
    """Return the values to show if the service can't be read. `note`: the reason. `gone`: True if no service is
    running."""
    step = steps.NO_SERVICE if gone else steps.UNREADABLE
    return {
        "name": "",
        "word": verdict.NO_SERVICE if gone else verdict.UNREADABLE,
        "role": BAD,
        "why": words.sentence(note),
        "since": None,
        "epoch": 0,
        "run": "",
        **dict.fromkeys(("next", "next_driver", "next_unpaired"), step.pressed),
        "latched": False,
        "enabled": False,
        "can": dict.fromkeys(("reset", "enable", "disable"), "no service runs" if gone else "it can't be read"),
        "stop": None,
        "unlatched": None,
        "limit": 100,
        "stands": "not known",
        "driver": "",
        "battery_v": None,
        "battery_age": "",
        "plugged": "unknown",
        "port": "",
        "board": "not known",
        "imu": True,
        "clients": [],
        "attended": None,
        "processes": [],
        "troubles": [],
        "events": [],
    }


def stop_of(stop: Stop | None) -> dict[str, Any] | None:
    """Return the last stop, with its three proofs in words, or None if there was no stop. A missing proof is "". For a
    missing proof, `lacks` has the reason, or "" if the reason is not known. `id` stays the same for one stop, while `t`
    changes if the clock is set."""
    if stop is None:
        return None
    return {
        "id": str(stop.noticed_ns),
        "reason": stop.reason,
        "t": stop.t,
        "written": _written(stop),
        "acknowledged": "" if stop.acknowledged_s is None else words.took(stop.acknowledged_s),
        "observed": _observed(stop),
        "lacks": {
            "written": "NO: it could not be written" if stop.written_s is None else "NO: the board accepts no bytes",
            "acknowledged": "" if stop.acknowledged_by else "this board never does",
            "observed": _unseen(stop),
        },
    }


def unlatched_of(event: Event | None, *, known: bool) -> dict[str, Any] | None:
    """Return what stopped the wheels after the last latched stop, when this was, and why failstop has not timed this
    stop. `event`: the event that reports this stop. Returns None if there is no such event. `known`: False if there may
    have been such a stop that is not remembered (verdict.remembered). Its time is then None."""
    if event is None and not known:
        return {"reason": "not known", "t": None, "lacks": FORGOTTEN}
    return None if event is None else {"reason": words.plain(event.what), "t": event.t, "lacks": UNTIMED}


def _observed(stop: Stop) -> str:
    """Return how long it took until the wheels were seen still, in words. Empty if they were not seen to come to
    rest."""
    if not stop.observed_s:
        return ""
    return proofs.still_or_unseen(stop.observed_s, "<", stop.observed_by, late=stop.observed_late)


def _unseen(stop: Stop) -> str:
    """Return why nobody saw the wheels come to rest after this stop. Empty if the reason is not known."""
    if not stop.observed_by:
        return "no IMU"
    return "" if stop.observed_s is None else proofs.NEVER_SEEN[stop.observed_by]


def _written(stop: Stop) -> str:
    """Return how long it took to send the stop's bytes, in words. Empty if the kernel has not sent them."""
    if stop.written_s is None or not stop.sent:
        return ""
    return f"{words.took(stop.written_s)}{'' if stop.believed else ', to a device that has not answered'}"


def _why(state: State) -> str:
    if doubt := verdict.doubt(state):
        return words.sentence(doubt)
    told = filter(None, (verdict.unproven(state), verdict.unseen(state)))
    return " ".join((*map(words.sentence, told), _held(state)))


def _held(state: State) -> str:
    """Return why the wheels are stopped, or else how they move."""
    if state.cause:
        return words.sentence(meaning(state.cause, verdict.reached(state))[0])
    if state.block is Block.HELD and (source := state.source_that("held")):
        return STICK_HELD if steps.is_stick(source) else HOLDS[state.block][1].replace("a program", source.who)
    if state.block:
        return HOLDS[state.block][1]
    return words.sentence(verdict.headline(state) if any(state.body_vel) else "The command is zero")


def _obstacles(state: State) -> dict[str, str]:
    """For each of the requests reset, enable and disable, return why it would be refused now, in a few words, or ""."""
    return {
        "reset": _first(state, Purpose.RESET) if state.estop else "nothing is latched",
        "enable": "motion is enabled already" if state.enabled else _first(state, Purpose.ENABLE),
        "disable": "" if state.enabled else "motion is disabled already",
    }


def _first(state: State, goal: Purpose) -> str:
    """Return the first thing that must be done before a request can be granted, or ""."""
    first = next(iter(steps.before(state, goal)), None)
    if first is None:
        return ""
    return "a stop is latched: reset first" if first.purpose is Purpose.RESET else first.clause or ""
