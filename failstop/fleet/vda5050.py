"""VDA 5050: a robot's connection and state in the words of version 2.1.0 of that interface. Pure.

The robot takes no orders, so what tells of orders is empty. What that interface has no field for stands in
`information`, which is for people: the word, why, the next step, the last stop.
"""

from __future__ import annotations

import datetime
import json
import math

from failstop.api import steps, verdict, wheels
from failstop.policy.causes import Cause

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from failstop.api.state import State, Stop

    Message = dict[str, Any]

VERSION = "2.1.0"
ROOT = "uagv/v2"
ONLINE = "ONLINE"
OFFLINE = "OFFLINE"
BROKEN = "CONNECTIONBROKEN"
GOOD_CHARGE, LOW_CHARGE = 80.0, 20.0
"""The charges that the interface gets for batteries that are known to be well or low, and no more."""
FLEET_STOP_OFF = "fleetStopOff"
"""The type of a robot's error: it obeys no stop of the fleet."""
DOUBLED = "doubledName"
"""The type of a robot's error: another publisher uses its name."""
WARNING = "WARNING"
FATAL = "FATAL"
BY_HAND = ("gamepad", "teleop")
"""Sources that are a person."""
NO_SERVICE_NEXT = "`failstop why` on the robot says more"


def topic(manufacturer: str, robot: str, last: str) -> str:
    """Where a message goes; `+` for any robot."""
    return f"{ROOT}/{manufacturer}/{robot}/{last}"


def stamp(unix_s: float) -> str:
    """A time as the interface has it."""
    moment = datetime.datetime.fromtimestamp(unix_s, datetime.timezone.utc)
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def seconds(stamped: object) -> float | None:
    """The inverse; None for what is none."""
    try:
        return datetime.datetime.fromisoformat(str(stamped).replace("Z", "+00:00")).timestamp()
    except ValueError:
        return None


class Header:
    """The head of all messages; its number counts by topic."""

    def __init__(self, manufacturer: str, robot: str, publisher: str = "") -> None:
        """`publisher`: the number that its publisher drew (twins.py)."""
        self.manufacturer = manufacturer
        self.robot = robot
        self._own = {"publisher": publisher} if publisher else {}
        self._sent: dict[str, int] = {}

    def topic(self, last: str) -> str:
        """This robot's."""
        return topic(self.manufacturer, self.robot, last)

    def message(self, last: str, body: Message, unix_s: float) -> bytes:
        """The next message of that topic."""
        number = self._sent[last] = self._sent.get(last, -1) + 1
        head = {
            "headerId": number,
            "timestamp": stamp(unix_s),
            "version": VERSION,
            "manufacturer": self.manufacturer,
            "serialNumber": self.robot,
            **self._own,
        }
        return json.dumps({**head, **body}, separators=(",", ":")).encode()


def connection(state: str, period_s: float | None = None) -> Message:
    """ONLINE, OFFLINE, or BROKEN, which is the last will. `period_s`: how often a state follows at least."""
    return {"connectionState": state, **({} if period_s is None else {"statePeriod": period_s})}


def body(state: State | None, note: str, extra: tuple[Message, ...] = ()) -> Message:
    """The state. None: no service, and `note` says why; `extra`: errors that the publisher itself has."""
    if state is None:
        error = _error("noService", FATAL, note, NO_SERVICE_NEXT)
        told = [_info("word", verdict.NO_SERVICE), _info("why", note), _info("next", NO_SERVICE_NEXT)]
        return {**_NO_ORDER, **_standing("SERVICE"), "errors": [error, *extra], "information": told}
    latched = state.cause is not None
    return {
        **_NO_ORDER,
        "driving": state.moving or state.turning.does == "turning",
        "paused": not state.enabled and not latched,
        "operatingMode": _mode(state),
        "velocity": {
            name: round(value, 4)
            for name, value in zip(("vx", "vy", "omega"), state.body_vel, strict=True)
            if math.isfinite(value)  # JSON has no other number
        },
        "batteryState": _battery(state),
        "errors": [*_errors(state), *extra],
        "information": _information(state),
        "safetyState": {"eStop": "MANUAL" if latched else "NONE", "fieldViolation": False},
    }


def steady(found: Message) -> Message:
    """Of a body, what does not change all the time: without how fast, how full, and how old a reading is."""
    kept = {key: value for key, value in found.items() if key not in ("velocity", "batteryState")}
    changing = ("wheels", "why") if found["driving"] else ("wheels",)
    kept["information"] = [row for row in found["information"] if row["infoType"] not in changing]
    return kept


_NO_ORDER: Message = {
    "orderId": "",
    "orderUpdateId": 0,
    "lastNodeId": "",
    "lastNodeSequenceId": 0,
    "nodeStates": [],
    "edgeStates": [],
    "actionStates": [],
}


def _standing(mode: str) -> Message:
    return {
        "driving": False,
        "operatingMode": mode,
        "batteryState": {"batteryCharge": 0.0, "charging": False},
        "safetyState": {"eStop": "NONE", "fieldViolation": False},
    }


def _mode(state: State) -> str:
    """The holder of the wheels: a person, nobody while the service is not ready, else programs."""
    if any(row.state == "drives" and row.source in BY_HAND for row in state.sources):
        return "MANUAL"
    return "SERVICE" if state.waiting_for else "AUTOMATIC"


def _volts(state: State) -> float | None:
    """The battery's voltage now."""
    volts = state.battery_v
    known = volts is not None and math.isfinite(volts) and state.is_current(state.ages.battery_s)
    return volts if known else None


def _battery(state: State) -> Message:
    known = _volts(state) or 0.0
    charge = (GOOD_CHARGE if known >= verdict.BATTERY_LOW_V else LOW_CHARGE) if known else 0.0
    volts = {"batteryVoltage": known} if known else {}
    return {"batteryCharge": charge, **volts, "charging": state.plugged == "plugged"}


def _errors(state: State) -> list[Message]:
    found = []
    if doubt := verdict.doubt(state):
        found.append(_error("wheelsMayTurn", FATAL, doubt, "use the POWER SWITCH"))
    if state.cause:
        found.append(_error("stopLatched", FATAL, str(state.cause), steps.line(state), _named(state.cause)))
    for name, process in state.processes.items():
        if process.state != "running":
            found.append(_error("processNotRunning", WARNING, f"{name} is {process.state}", "", {"process": name}))
    if state.device.state == "open" and state.device.link == "unproven":
        found.append(_error("linkUnproven", WARNING, f"{verdict.NEVER_ANSWERED}: no stop is known to reach the wheels"))
    if state.starved:
        found.append(_error("starved", WARNING, "the machine did not run the service in time", "`failstop doctor`"))
    return found + [_error("arm", WARNING, text) for text in (state.arm.wrong if state.arm else ())]


def _information(state: State) -> list[Message]:
    found = [_info("word", verdict.word(state)), _info("why", why(state)), _info("next", steps.line(state))]
    found.append(_info("wheels", wheels.now(state), _seen(state)))
    if _volts(state) is None:
        found.append(_info("battery", "not known"))
    if state.last_stop:
        found.append(_info("lastStop", state.last_stop.reason, _proofs(state.last_stop)))
    return found


def why(state: State) -> str:
    """One line on what the wheels do or why not."""
    if doubt := verdict.doubt(state):
        return doubt
    blocked = str(state.cause) if state.cause else state.blocked
    unproven, unseen = verdict.unproven(state), verdict.unseen(state)
    said = (unproven and f"unproven: {unproven}", unseen, blocked or verdict.headline(state))
    return "; ".join(filter(None, said))


def _seen(state: State) -> dict[str, object]:
    """What is seen of the wheels, for programs."""
    known = state.turning
    found: dict[str, object] = {"does": known.does, "by": known.by or None, "unexpected": known.unexpected}
    if known.age_s is not None:
        found["age_s"] = round(known.age_s, 2)
    if known.speeds_radps:
        found |= {
            f"{name}_radps": round(speed, 3)
            for name, speed in zip(known.speeds_radps.names, known.speeds_radps, strict=True)
        }
    return {key: value for key, value in found.items() if value is not None}


def _named(cause: Cause) -> dict[str, object]:
    return {"cause": cause.kind.name, **cause.named()}


def _proofs(stop: Stop) -> dict[str, object]:
    """The three levels of a stop, of those that are known."""
    found = {
        "cause": stop.cause.kind.name,
        "t": stamp(stop.t),
        "written_s": stop.written_s,
        "acknowledged_s": stop.acknowledged_s,
        "observed_s": stop.observed_s,
        "believed": None if stop.believed else False,
    }
    return {key: value for key, value in found.items() if value is not None}


def _references(values: dict[str, object]) -> list[Message]:
    return [{"referenceKey": key, "referenceValue": str(value)} for key, value in values.items()]


def _error(kind: str, level: str, text: str, hint: str = "", references: dict[str, object] | None = None) -> Message:
    return {
        "errorType": kind,
        "errorReferences": _references(references or {}),
        "errorDescription": text,
        "errorHint": hint,
        "errorLevel": level,
    }


def _info(kind: str, text: str, references: dict[str, object] | None = None) -> Message:
    return {
        "infoType": kind,
        "infoReferences": _references(references or {}),
        "infoDescription": text,
        "infoLevel": "INFO",
    }


def warning(kind: str, text: str, hint: str) -> Message:
    """An error of the publisher's own."""
    return _error(kind, WARNING, text, hint)
