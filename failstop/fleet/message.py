"""The JSON messages that a robot publishes on the broker: its connection, its state, and its newest event. Pure.

A value that is not known is left out. `t` and `event_t` are Unix times in s. All other times are durations in s.
"""

from __future__ import annotations

import json
import math

from failstop.api import steps, verdict, wheels
from failstop.fleet import topics
from failstop.version import VERSION

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from typing import Any

    from failstop.api.errors import FailstopError
    from failstop.api.state import State, Stop

    Message = dict[str, Any]

ONLINE = "online"
OFFLINE = "offline"
"""The connection state that a publisher reports just before it ends cleanly."""
LOST = "lost"
"""The connection state in the last will, the message that the broker publishes when the robot's connection breaks."""
FLEET_STOP_OFF = "fleet_stop_off"
"""The kind of the error that a robot reports if it would obey no fleet stop."""
DOUBLED = "doubled_name"
"""The kind of the error that a robot reports if another publisher uses its name too."""
WARNING = "warning"
FATAL = "fatal"
NO_SERVICE_NEXT = "`failstop why` on the robot says more"
UNREADABLE_NEXT = "restart the publisher on the robot, which may be of another version than the service"
LATEST_S = 1e11
"""The latest Unix time that is accepted as a date. It is in the year 5138."""


class Header:
    """Adds the fields that every message of a robot has, for example the message's number. Each topic has its own
    numbers, from 0 on."""

    def __init__(self, fleet: str, robot: str, publisher: str = "") -> None:
        """`publisher`: the random number of this publisher (twins.py)."""
        self.fleet = fleet
        self.robot = robot
        self._own = {"publisher": publisher} if publisher else {}
        self._sent: dict[str, int] = {}

    def topic(self, last: str) -> str:
        """Return this robot's topic that ends with `last`."""
        return topics.of_robot(self.fleet, self.robot, last)

    def message(self, last: str, body: Message, unix_s: float) -> bytes:
        """Make the next message for this robot's topic that ends with `last`."""
        number = self._sent[last] = self._sent.get(last, -1) + 1
        head = {
            "number": number,
            "t": round(unix_s, 3),
            "fleet": self.fleet,
            "robot": self.robot,
            "failstop": VERSION,
            **self._own,
        }
        return json.dumps({**head, **body}, separators=(",", ":")).encode()


def date(found: object) -> float | None:
    """Return the date in a message's field `t`, as Unix time in seconds. `found` is the field's value. None if that is
    not a date."""
    if isinstance(found, bool) or not isinstance(found, (int, float)) or not 0.0 <= found <= LATEST_S:
        return None
    return float(found)


def connection(state: str, period_s: float | None = None, heard: Sequence[str] = ()) -> Message:
    """Return the body of a connection message. `state`: ONLINE, OFFLINE or LOST. `period_s`: the longest time between
    two state messages, s. `heard`: the numbers of other publishers that use this robot's name (twins.py)."""
    period = {} if period_s is None else {"state_period_s": period_s}
    return {"connection": state, **period, **({"heard": list(heard)} if heard else {})}


def without_state(problem: FailstopError, extra: tuple[Message, ...] = ()) -> Message:
    """Return the body of a state message while the service's state can't be read. `problem`: why. `extra`: as for
    body()."""
    word, note = verdict.without_state(problem), str(problem)
    kind, then = ("no_service", NO_SERVICE_NEXT) if word == verdict.NO_SERVICE else ("unreadable", UNREADABLE_NEXT)
    return {"word": word, "why": note, "next": then, "errors": [_error(kind, FATAL, note, then), *extra]}


def body(state: State, extra: tuple[Message, ...] = ()) -> Message:
    """Return the body of a state message. `extra`: errors of the publisher itself."""
    found = {
        "word": verdict.word(state),
        "why": why(state),
        "next": steps.line(state),
        "moves": state.moving or state.turning.does == "turning",
        "enabled": state.enabled,
        "latched": state.cause is not None,
        "velocity": _finite(zip(("vx_mps", "vy_mps", "wz_radps"), state.body_vel, strict=True)),
        "battery": _battery(state),
        "wheels": {"text": wheels.now(state), **_seen(state)},
        "errors": [*_errors(state), *extra],
    }
    if state.last_stop:
        found["last_stop"] = _proofs(state.last_stop)
    return found


def steady(found: Message) -> Message:
    """Return a state message without the fields that change often, such as velocity, wheels and battery."""
    changing = ("velocity", "battery", "wheels", *(("why",) if found.get("moves") else ()))
    return {key: value for key, value in found.items() if key not in changing}


def why(state: State) -> str:
    """Return one line about what the wheels do, or why they don't move."""
    if doubt := verdict.doubt(state):
        return doubt
    blocked = str(state.cause) if state.cause else state.blocked
    unproven, unseen = verdict.unproven(state), verdict.unseen(state)
    said = (unproven and f"unproven: {unproven}", unseen, blocked or verdict.headline(state))
    return "; ".join(filter(None, said))


def warning(kind: str, text: str, then: str) -> Message:
    """Return a warning about the publisher itself. `then`: what to do about it."""
    return _error(kind, WARNING, text, then)


def _finite(named: Iterable[tuple[str, float]]) -> dict[str, float]:
    """Return these values as JSON fields. Infinities and NaN are left out, because JSON doesn't have them."""
    return {name: round(value, 4) for name, value in named if math.isfinite(value)}


def _battery(state: State) -> Message:
    if not state.is_current(state.ages.battery_s):
        return {}
    found: Message = {"plugged": state.plugged} if state.plugged else {}
    volts = state.battery_v
    if volts is not None and math.isfinite(volts):
        found["volts"] = volts
    return found


def _errors(state: State) -> list[Message]:
    found = []
    if doubt := verdict.doubt(state):
        found.append(_error("wheels_may_turn", FATAL, doubt, "use the POWER SWITCH"))
    if state.cause:
        fields = {"cause": state.cause.kind.name, **state.cause.named()}
        found.append(_error("stop_latched", FATAL, str(state.cause), steps.line(state), fields))
    for name, process in state.processes.items():
        if process.state != "running":
            text = f"{name} is {process.state}"
            found.append(_error("process_not_running", WARNING, text, "", {"process": name}))
    if state.device.state == "open" and state.device.link == "unproven":
        text = f"{verdict.NEVER_ANSWERED}: no stop is known to reach the wheels"
        found.append(_error("link_unproven", WARNING, text))
    if state.starved:
        found.append(_error("starved", WARNING, "the machine did not run the service in time", "`failstop doctor`"))
    return found + [_error("arm", WARNING, text) for text in (state.arm.wrong if state.arm else ())]


def _seen(state: State) -> Message:
    """Return what is known about the wheels' motion, as JSON fields."""
    known = state.turning
    found: Message = {"does": known.does, "by": known.by or None, "unexpected": known.unexpected}
    if known.age_s is not None:
        found["age_s"] = round(known.age_s, 2)
    if known.speeds_radps:
        names = (f"{name}_radps" for name in known.speeds_radps.names)
        found |= _finite(zip(names, known.speeds_radps, strict=True))
    return {key: value for key, value in found.items() if value is not None}


def _proofs(stop: Stop) -> Message:
    """Return the last stop, with the proofs that are known."""
    found = {
        "cause": stop.cause.kind.name,
        "reason": stop.reason,
        "t": stop.t,
        "written_s": stop.written_s,
        "acknowledged_s": stop.acknowledged_s,
        "observed_s": stop.observed_s,
        "sent": None if stop.sent else False,
        "believed": None if stop.believed else False,
    }
    return {key: value for key, value in found.items() if value is not None}


def _error(kind: str, level: str, text: str, then: str = "", fields: Message | None = None) -> Message:
    return {"kind": kind, "level": level, "text": text, "next": then, "fields": fields or {}}
