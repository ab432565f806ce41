"""States as a service publishes them, for tests of what people see."""

from __future__ import annotations

import dataclasses
from typing import Any

from failstop.api.snapshot import (
    ArmState,
    Client,
    Device,
    JointState,
    Process,
    Source,
    State,
    Stop,
    Turning,
    Velocity,
    Wheels,
)
from failstop.policy import causes
from failstop.policy.causes import Cause

NOW_S = 1_700_000_000.0
STILL = Turning("still", "IMU", since_s=60.0, age_s=0.01, last="still")
SEEN = "; now: the IMU feels no movement (0.0 s ago)"
"""STILL, at the end of the proof in `failstop why`."""
SPEEDS = Wheels((5.0, 5.0, 5.0, 5.0))
TURNS = Turning("turning", "wheels", since_s=0.4, age_s=0.02, last="turning", speeds_radps=SPEEDS)
TURNS_ON = dataclasses.replace(TURNS, unexpected=True, since_s=12.0)
MOVES = Turning("turning", "IMU", since_s=0.4, age_s=0.01, last="turning")
MOVES_ON = dataclasses.replace(MOVES, unexpected=True, since_s=12.0)
TURNED = Turning(age_s=3.2, last="turning", speeds_radps=SPEEDS)
UNREAD = Turning(age_s=3.2, last="still")
UNSEEN = Turning()
KEY = causes.KEY(1)
KEY_STOP = Stop(KEY, str(KEY), NOW_S - 12, "port_owner", "port owner", 210e-6, 4.4e-3, 0.3)


def process(**changed: Any) -> Process:
    healthy = Process(4711, "running", 0.005, 0, None, 0.02, realtime=True, memory_locked=True)
    return dataclasses.replace(healthy, **changed)


def stop(cause: Cause = KEY, **changed: Any) -> Stop:
    """A stop of 12 s ago with all its proofs."""
    return dataclasses.replace(KEY_STOP, cause=cause, reason=str(cause), **changed)


def state(**changed: Any) -> State:
    """A service as it is after its start: disabled, all well."""
    base: dict[str, Any] = {"name": "failstop", "enabled": False, "estop": None, "cause": None, "blocked": "disabled"}
    base |= {"body_vel": Velocity(0.0, 0.0, 0.0), "wheels_radps": Wheels((0.0,) * 4), "epoch": 1, "waiting_for": None}
    base |= {"device": Device("/dev/ttyACM0", "open", "alive"), "starved": None, "clients": (), "sources": ()}
    base |= {"processes": {name: process() for name in ("supervisor", "port_owner", "stopper", "gate", "telemetry")}}
    base |= dict.fromkeys(("scan_age_s", "last_stop", "imu", "gyro_bias", "odometry", "pad_mode"))
    base |= {"turning": STILL, "battery_v": 12.0, "plugged": "unknown", "age_s": 0.004}
    return State(**{**base, **changed})


def latched(cause: Cause = KEY, **changed: Any) -> State:
    told = {"cause": cause, "estop": str(cause), "blocked": f"estop: {cause}", "last_stop": stop(cause)}
    return state(**{**told, **changed})


def arm(*joints: str, **changed: Any) -> ArmState:
    rows = {name: JointState(servo, 0.0, 500, 0.1, 0.0, True, 40, 7.4) for servo, name in enumerate(joints, 1)}
    base = ArmState("", "", False, "", "", "", False, (), (), "", None, None, rows)
    return dataclasses.replace(base, **changed)


def driving(**changed: Any) -> State:
    source = Source("cmd_vel", 0, "nav (pid 42)", "drives")
    base: dict[str, Any] = {
        "enabled": True,
        "blocked": None,
        "sources": (source,),
        "clients": (Client(0, "nav", 42, True),),
    }
    base |= {"turning": MOVES, "body_vel": Velocity(0.2, 0.0, 0.0), "wheels_radps": Wheels((5.0,) * 4)}
    return state(**{**base, **changed})
