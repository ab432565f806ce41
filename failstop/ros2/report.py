"""Report: the service's state as the bridge publishes it in ~/state and ~/status, and a line about the bridge for
people. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from math import degrees, nan
from typing import Any

from failstop.api import steps, verdict
from failstop.api.errors import FailstopError
from failstop.api.state import State, Stop
from failstop.messages import box
from failstop.policy.proofs import NO_IMU, TO_A_STRANGER, wheels_seen
from failstop.ros2 import words
from failstop.ros2.contract import STATE_KEYS

PLUGGED = {"plugged": True, "unplugged": False, "unknown": None}
NOBODY = "nobody publishes cmd_vel"


def blocked(state: State) -> str | None:
    """Why the wheels may not turn, in the words of an earlier driver. None if they may."""
    return f"{box.LATCHED}{words.plain(state.cause)}" if state.cause else state.blocked


def driver(state: State) -> str | None:
    """The program that drives, and its source. None if no program drives."""
    return next((f"{row.who} as {row.source}" for row in state.sources if row.state == "drives"), None)


NO_ARM: dict[str, Any] = {
    "arm_enabled": False,
    "arm_moving": False,
    "arm_pose": {},
    "servo_silent": [],
    "arm_holding": False,
    "auto_tuck_in_s": None,
    "pad_joint": None,
}


def arm(state: State) -> dict[str, Any]:
    """The keys of ~/state that are about the arm."""
    found = state.arm
    if found is None:
        return NO_ARM
    joints = found.joints.values()
    return {
        "arm_enabled": not found.closed,
        "arm_moving": found.moving,
        "arm_pose": {str(joint.servo): joint.pulses for joint in joints if joint.pulses is not None},
        "servo_silent": list(found.silent),
        "arm_holding": not found.moving and any(joint.torque for joint in joints),
        "auto_tuck_in_s": found.auto_tuck_s,
        "pad_joint": found.pad_joint,
    }


UNKNOWN_WHEELS: dict[str, Any] = {
    "does": "unknown",
    "by": None,
    "unexpected": False,
    "age_ms": None,
    "radps": {},
}


def wheels(state: State) -> dict[str, Any]:
    """The key `wheels` of ~/state: what is observed of the wheels, and the word that every screen shows."""
    known = state.turning
    measured = known.speeds_radps or ()
    names = known.speeds_radps.names if known.speeds_radps else ()
    return {
        "word": verdict.word(state),
        "does": known.does,
        "by": known.by or None,
        "unexpected": known.unexpected,
        "age_ms": _times(known.age_s, 1e3),
        "radps": {name: round(speed, 3) for name, speed in zip(names, measured, strict=True)},
    }


def busy(state: State | None) -> bool:
    """The value of ~/arm_busy: True if the arm moves or is about to."""
    return bool(state and state.arm and state.arm.mode)


def as_json(state: State, publishers: Sequence[str], wrong: Sequence[str]) -> dict[str, Any]:
    """The values of ~/state, with the keys of contract.STATE_KEYS."""
    bias = state.gyro_bias
    stop = state.last_stop
    found = {
        "enabled": state.enabled,
        "estop": words.plain(state.cause) or None,
        "plugged": PLUGGED[state.plugged],
        **arm(state),
        "blocked": blocked(state),
        "body_vel": [round(value, 3) for value in state.body_vel],
        "scan_age": None if state.scan_age_s is None else round(state.scan_age_s, 2),
        "gyro_bias_dps": [round(degrees(value), 4) for value in (bias.bias_radps if bias else (0.0, 0.0, 0.0))],
        "gyro_bias_tracking": bool(bias and bias.tracking),
        "pad_mode": state.pad_mode or "locked",
        "next": steps.typed(state),
        "driver": driver(state),
        "publishers": list(publishers),
        "wrong": "; ".join(wrong) or None,
        "link": state.device.link,
        "port": state.device.state,
        "processes": {
            name: {"pid": row.pid, "state": row.state, "age_ms": round(row.age_s * 1e3, 1), "restarts": row.restarts}
            for name, row in state.processes.items()
        },
        "last_stop": stop
        and {
            "reason": words.plain(stop.cause),
            "written_us": _times(stop.written_s, 1e6),
            "acknowledged_us": _times(stop.acknowledged_s, 1e6),
            "observed_ms": _times(stop.observed_s, 1e3),
        },
        "wheels": wheels(state),
        "state_age_ms": round(state.age_s * 1e3, 1),
    }
    return {key: found[key] for key in STATE_KEYS}


def without_state(problem: FailstopError) -> dict[str, Any]:
    """The values of ~/state while the service's state can't be read. `problem`: why."""
    word = verdict.without_state(problem)
    step = steps.NO_SERVICE if word == verdict.NO_SERVICE else steps.UNREADABLE
    found = {
        "enabled": False,
        "estop": None,
        "plugged": None,
        **NO_ARM,
        "blocked": str(problem),
        "body_vel": [0.0, 0.0, 0.0],
        "scan_age": None,
        "gyro_bias_dps": [0.0, 0.0, 0.0],
        "gyro_bias_tracking": False,
        "pad_mode": "locked",
        "next": [step.typed],
        "driver": None,
        "publishers": [],
        "wrong": None,
        "link": "unproven",
        "port": "closed",
        "processes": {},
        "last_stop": None,
        "wheels": {"word": word, **UNKNOWN_WHEELS},
        "state_age_ms": None,
    }
    return {key: found[key] for key in STATE_KEYS}


def status(state: State) -> dict[str, Any]:
    """The fields of a failstop_msgs/Status without its stamp. Unknown values are NaN or empty."""
    stop = state.last_stop
    return {
        "enabled": state.enabled,
        "blocked": blocked(state) or "",
        "latched": state.estop is not None,
        "estop": words.plain(state.cause),
        "driver": driver(state) or "",
        "state_age_s": state.age_s,
        "scan_age_s": _known(state.scan_age_s),
        "link": state.device.link,
        "wheels": state.turning.does,
        "wheels_by": state.turning.by,
        "wheels_unexpected": state.turning.unexpected,
        "wheels_age_s": _known(state.turning.age_s),
        "last_stop": words.plain(stop.cause) if stop else "",
        "last_stop_written_s": _known(stop.written_s if stop else None),
        "last_stop_acknowledged_s": _known(stop.acknowledged_s if stop else None),
        "last_stop_observed_s": _known(stop.observed_s if stop else None),
    }


def status_without_state(problem: FailstopError) -> dict[str, Any]:
    """The fields of a failstop_msgs/Status without its stamp while the service's state can't be read. `latched` is
    true, because a stop may be latched, as in ~/emergency_stop. `problem`: why there is no state."""
    return {
        "enabled": False,
        "blocked": str(problem),
        "latched": latched(None),
        "estop": "",
        "driver": "",
        "state_age_s": nan,
        "scan_age_s": nan,
        "link": "unproven",
        "wheels": "unknown",
        "wheels_by": "",
        "wheels_unexpected": False,
        "wheels_age_s": nan,
        "last_stop": "",
        "last_stop_written_s": nan,
        "last_stop_acknowledged_s": nan,
        "last_stop_observed_s": nan,
    }


def _seen(stop: Stop) -> str:
    """Whether the wheels were seen standing still, in words."""
    if stop.observed_s is None:
        return "wheels not seen still yet" if stop.observed_by else NO_IMU
    if not stop.observed_s:
        return wheels_seen(0.0, stop.observed_by)
    return f"observed after {'at most ' if stop.observed_late else ''}{stop.observed_s * 1e3:.0f} ms"


def _known(value: float | None) -> float:
    return nan if value is None else value


def _times(value: float | None, factor: float) -> float | None:
    return None if value is None else round(value * factor, 1)


def latched(state: State | None) -> bool:
    """The value of ~/emergency_stop. Without a state it is True, because a stop may be latched."""
    return state is None or state.estop is not None


def says(names: str, scan: str) -> str:
    """What the bridge sees, in one line for `failstop status` and `failstop why`."""
    return f"cmd_vel: {names}; {scan}" if names else f"{NOBODY}; {scan}"


def proof(before: State | None, now: State | None, *, final: bool = False) -> tuple[bool, str] | None:
    """Whether the requested stop was written to the board. Returns (True if it is known to be written and nothing shows
    that it fails, what is known), or None while more may become known. `before`: the state before the request. `now`:
    the present state. With `final`, the result is never None.

    If a stop was latched before the request, the service keeps the proofs of that stop. So they count only once the
    service has heard the request, and only as long as the present state does not contradict them."""
    stop = now.last_stop if now else None
    if now is None or stop is None or not now.estop or (before and not _heard(before, now)):
        return (False, "the stop was requested, but the service has not confirmed it yet") if final else None
    latch = f"stop latched ({words.plain(now.cause)})"
    if stop.written_s is None:
        return False, f"{latch}, and it could NOT be written: use the POWER SWITCH"
    turns_again = stop.observed_s is not None and now.turning.does == "turning"
    doubt = verdict.doubt(now) or (verdict.unseen(now) if turns_again else "")
    proven = (stop.observed_s if stop.observed_by else stop.acknowledged_s) is not None
    if (doubt or not proven) and not final:
        return None  # the stop may still take effect
    if doubt:
        return False, f"{latch}, but {doubt}: use the POWER SWITCH"
    to = "" if stop.believed else f" {TO_A_STRANGER}"
    told = [f"written after {stop.written_s * 1e3:.1f} ms{to}"]
    told.append(
        "not acknowledged yet"
        if stop.acknowledged_s is None
        else f"acknowledged after {stop.acknowledged_s * 1e3:.1f} ms"
    )
    told.append(_seen(stop))
    older = "; this stop was latched before the request" if before and before.estop else ""
    return stop.believed, f"{latch}: {', '.join(told)}{older}"


def _heard(before: State, now: State) -> bool:
    """Whether the service has heard a stop since `before`. It raises the epoch for every stop, but it publishes a new
    last stop only if none was latched."""
    return now.epoch != before.epoch and (before.estop is not None or now.last_stop != before.last_stop)
