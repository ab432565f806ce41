"""A machine on which all is well, as facts; tests change one thing."""

from __future__ import annotations

import dataclasses
from typing import Any

from failstop.doctor.facts import (
    Clock,
    Cpu,
    Facts,
    Idle,
    Node,
    RemoveIpc,
    Rights,
    Service,
    SharedMemory,
    StopTest,
    Ticks,
    Unit,
    User,
)
from failstop.shm.layout import PROCESSES
from failstop.version import VERSION
from tests.support.states import process, state

SERVER = User("failstop", 998, frozenset({998, 20}))
PERSON = User("anna", 1000, frozenset({1000, 20}))
NODE = Node(
    path="/dev/ttyACM0",
    resolved="/dev/ttyACM0",
    character=True,
    pseudo=False,
    mode=0o660,
    uid=0,
    gid=20,
    group="dialout",
    usb_id="1a86:55d4",
    product="USB Single Serial",
    modem_ignored=True,
    accessible=True,
)
STATE = state(processes={name: process(pid=100 + at) for at, name in enumerate(PROCESSES)})
SERVICE = Service(100, VERSION, "failstop", STATE)
UNIT = Unit("failstop.service", "loaded", "active", "running", "enabled", "success", "failstop", False, 100, 0)
RIGHTS = Rights(40, -1, nice_capability=False, lock_capability=False, realtime_granted=True, runtime_us=950_000)
CLOCK = Clock("tsc", ("tsc", "hpet"), backward_ns=0, resolution_ns=1, synchronized=True, offset_s=0.0001)
MEMORY = SharedMemory(True, True, 1 << 30, 1 << 21)
CPU = Cpu(4, ("performance",), Idle("C1", 2))
TICKS = (Ticks(False, 500, 60.0, 400.0, 3000.0), Ticks(True, 500, 20.0, 60.0, 300.0))
STOPS = (StopTest("stop tool", True, 4.5),)

WELL = Facts(
    name="failstop",
    device="/dev/ttyACM0",
    device_origin="the default of device.path",
    user=PERSON,
    service_user=SERVER,
    rights=RIGHTS,
    clock=CLOCK,
    memory=MEMORY,
    cpu=CPU,
    lease_s=0.06,
    period_s=0.02,
    node=NODE,
    service=SERVICE,
    systemd=True,
    unit=UNIT,
    remove_ipc=RemoveIpc(True, ""),
    ticks=TICKS,
    stops=STOPS,
)


def facts(**changed: Any) -> Facts:
    """All is well but for this."""
    return dataclasses.replace(WELL, **changed)


def serving(**changed: Any) -> Service:
    """The service, in a state but for this."""
    return dataclasses.replace(SERVICE, state=dataclasses.replace(STATE, **changed))


def but(part: Any, **changed: Any) -> Any:
    """One part, changed."""
    return dataclasses.replace(part, **changed)
