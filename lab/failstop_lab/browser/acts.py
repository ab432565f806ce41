"""Acts: the buttons and switches of the page, each with what it does to the robot."""

from __future__ import annotations

from typing import NamedTuple

from failstop.messages.layout import GATE, PORT_OWNER, STOPPER, SUPERVISOR, TELEMETRY

PRESS, A_SWITCH = "press", "switch"
KILL_PREFIX, HANG_PREFIX = "kill-", "hang-"


class Act(NamedTuple):
    """A button, or a switch that is on at first and may be turned off."""

    name: str
    group: str
    label: str
    kind: str = PRESS
    off: str = ""
    """If this is a switch: its label while it is off."""


ASK, DRIVER, SENSES, OF_PROCESSES, OF_BOARD, MACHINE = GROUPS = (
    "Ask",
    "Driver",
    "Sensor and interlock",
    "Processes",
    "Board",
    "Machine",
)
STAY = (GATE, PORT_OWNER, TELEMETRY, STOPPER, SUPERVISOR)
ACTS = (
    Act("enable", ASK, "enable"),
    Act("reset", ASK, "reset"),
    Act("disable", ASK, "disable"),
    Act("stop", ASK, "ask for a stop"),
    Act("stop-pipe", ASK, "garbage in the stop pipe"),
    Act("commands", DRIVER, "commands 0.2 m/s", A_SWITCH, "commands nothing"),
    Act("driver", DRIVER, "program runs", A_SWITCH, "program suspended (SIGSTOP)"),
    Act("driver-killed", DRIVER, "kill it; another commands at once"),
    Act("driver-nan", DRIVER, "command what is not a number"),
    Act("driver-second", DRIVER, "a second publisher of cmd_vel"),
    Act("driver-gamepad", DRIVER, "command zero as the gamepad"),
    Act("sensor", SENSES, "obstacle sensor delivers", A_SWITCH, "obstacle sensor silent"),
    Act("interlock", SENSES, "interlock asserted", A_SWITCH, "interlock lost"),
    *(
        act
        for name in STAY
        for shown in (name.replace("_", " "),)
        for act in (
            Act(f"{HANG_PREFIX}{name}", OF_PROCESSES, f"{shown} runs", A_SWITCH, f"{shown} hangs (SIGSTOP)"),
            Act(f"{KILL_PREFIX}{name}", OF_PROCESSES, "kill"),
        )
    ),
    Act("plug", OF_BOARD, "plugged in", A_SWITCH, "unplugged"),
    Act("hears", OF_BOARD, "hears", A_SWITCH, "deaf"),
    Act("drains", OF_BOARD, "takes bytes", A_SWITCH, "takes no bytes"),
    Act("obeys", OF_BOARD, "obeys", A_SWITCH, "wheels turn on"),
    Act("key", OF_BOARD, "press its stop key"),
    Act("pad", OF_BOARD, "press a button of its gamepad"),
    Act("sleep", MACHINE, "sleep for 20 s, and wake"),
    Act("freeze", MACHINE, "freeze everything for 0.3 s"),
    Act("clock", MACHINE, "step the wall clock by an hour"),
    Act("end", MACHINE, "stop the service (SIGTERM)"),
)
ACT_BY_NAME = {act.name: act for act in ACTS}
SWITCHES = tuple(act.name for act in ACTS if act.kind == A_SWITCH)

TENTH = "+"
"""A tenth of a second passes."""
BRIEFLY = 15 * (TENTH,)
ROWS: dict[str, tuple[str, ...]] = {
    **{f"{fault}-{name}": (f"{fault}-{name}",) for fault in ("kill", "hang") for name in STAY},
    "hang-supervisor-continued": ("hang-supervisor", TENTH, TENTH, "hang-supervisor"),
    "kill-gate+telemetry": ("kill-gate", "kill-telemetry"),
    "kill-supervisor+stopper": ("kill-supervisor", "kill-stopper"),
    "kill-supervisor+port_owner": ("kill-supervisor", "kill-port_owner"),
    "hang-gate+stopper": ("hang-gate", "hang-stopper"),
    "kill-port_owner-hang-supervisor": ("kill-port_owner", "hang-supervisor"),
    "client-killed": ("driver-killed",),
    "client-hung": ("driver",),
    "client-nan": ("driver-nan",),
    "client-second": ("driver-second",),
    "client-gamepad": ("driver-gamepad",),
    "service-stopped": ("end",),
    "stop-pipe-garbage": ("stop-pipe",),
    "pad-button": ("pad",),
    "board-key": ("key",),
    "scan-silent": ("sensor",),
    "interlock-lost": ("interlock",),
    "usb-drop": ("plug", TENTH, TENTH, "plug"),
    "board-not-draining": ("drains", *BRIEFLY, "drains"),
    "board-deaf": ("hears", *BRIEFLY, "hears"),
    "suspended": ("sleep",),
    "frozen": ("freeze",),
    "clock-stepped": ("clock",),
}
"""Rows of the fault table (lab/faults/table.py), each by the acts that make its fault."""
