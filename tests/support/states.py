"""States as a service publishes them, for tests of what people see."""

from __future__ import annotations

import dataclasses
from typing import Any

from failstop.api.state import Process, State, Stop
from failstop.policy import causes
from failstop.policy.causes import Cause

NOW_S = 1_700_000_000.0
KEY = causes.KEY(1)
STOP = Stop(KEY, str(KEY), NOW_S - 12, "port_owner", "port owner", 210.0, 4400.0, 300.0)


def process(**changed: Any) -> Process:
    """A process that runs well."""
    healthy = Process(4711, "running", 5.0, 0, None, 20.0, realtime=True, memory_locked=True)
    return dataclasses.replace(healthy, **changed)


def stop(cause: Cause = KEY, **changed: Any) -> Stop:
    """A stop of 12 s ago with all its proofs."""
    return dataclasses.replace(STOP, cause=cause, reason=str(cause), **changed)


def state(**changed: Any) -> State:
    """A service as it is after its start: disabled, all well."""
    base = State(
        name="failstop",
        enabled=False,
        estop=None,
        cause=None,
        blocked="disabled",
        body_vel=(0.0, 0.0, 0.0),
        wheels_rps=(0.0, 0.0, 0.0, 0.0),
        epoch=1,
        waiting_for=None,
        device={"path": "/dev/ttyACM0", "state": "open", "link": "alive"},
        processes={name: process() for name in ("supervisor", "port_owner", "stopper", "gate", "telemetry")},
        starved=None,
        clients=[],
        sources=[],
        scan_age_s=None,
        last_stop=None,
        imu=None,
        gyro_bias=None,
        odometry=None,
        pad_mode=None,
        battery_mv=12_000,
        plugged="unknown",
        age_ms=4.0,
    )
    return dataclasses.replace(base, **changed)


def latched(cause: Cause = KEY, **changed: Any) -> State:
    """The same with a stop latched."""
    told = {"cause": cause, "estop": str(cause), "blocked": f"estop: {cause}", "last_stop": stop(cause)}
    return state(**{**told, **changed})


def driving(**changed: Any) -> State:
    """The same while a client drives forward."""
    source = {"source": "cmd_vel", "priority": 0, "who": "nav (pid 42)", "state": "drives"}
    base = {
        "enabled": True,
        "blocked": None,
        "body_vel": (0.2, 0.0, 0.0),
        "wheels_rps": (0.8, 0.8, -0.8, -0.8),
        "sources": [source],
        "clients": [{"slot": 0, "name": "nav", "pid": 42, "driving": True}],
    }
    return state(**{**base, **changed})
