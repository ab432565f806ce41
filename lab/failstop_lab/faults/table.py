"""The fault table: what goes wrong, who stops first, what stays latched, what clears it, what is said of it.

The tests, the campaign (`failstop chaos`) and docs/reference/faults.md all come from these rows. Whether the wheels
stopped is the simulated board's word (judge.py), never the service's.
"""

from __future__ import annotations

from failstop.messages.layout import GATE, PORT_OWNER, SUPERVISOR
from failstop.policy.causes import (
    BOARD_SILENT,
    BUTTON,
    DEAF,
    DEVICE_LOST,
    DIED,
    HELD_UP,
    KEY,
    MUTE,
    NOT_FINITE,
    PIPED,
    REMOVED,
    RESTARTED,
    RUNAWAY,
    STARVED,
    STUCK,
    SUPERVISOR_SUSPENDED,
    SUSPENDED,
    TWO_PUBLISHERS,
)
from failstop.policy.causes import HANGS as HANGS_CAUSE
from failstop_lab.boards.traits import (
    HAS_BATTERY,
    HAS_CHECK,
    HAS_DRIVERS,
    HAS_GAMEPAD,
    HAS_IMU,
    HAS_KEYS,
    HAS_PINGS,
    HAS_REPORTS,
    HAS_WHEEL_REPORTS,
    SHOWS_DEAF,
)
from failstop_lab.faults import processes
from failstop_lab.faults.fault import (
    ASKED_TO_STOP,
    BOARD_FAILS,
    BOARD_SAYS_NOTHING,
    BY_ENABLE,
    BY_ITSELF,
    BY_NEW_RUN,
    BY_RESET,
    CLIENT_FAILS,
    CONTINUE,
    GUARD_FAILS,
    HANG,
    MACHINE,
    MEMORY,
    SENSOR,
    SERVICE_STOPPED,
    SEVERAL,
    TIME,
    USB,
    WHEEL_FAILS,
    Fault,
)
from failstop_lab.faults.inject_board import WATCHDOG_S

BACK = "the device's return"
STOP_ASKED_MEANWHILE = "a stop request meanwhile"
THAWED = "the thaw"
RUN_DOWN_MS = 1_700.0
"""The run-down time of the board that reports least often, at the trials' speed, and 0.2 s (docs/dev/runaway.md)."""
IN_TURN_MS = 60.0
"""Two turns of a controller manager's loop at 50 Hz, and the time of a stop."""
DRIVER_HAS_DIED = "died after it had driven"


def _asked(
    name: str, event: str, cause: str, injector: str, logged: str = "", *, bar_ms: float = 20.0, needs: str = ""
) -> Fault:
    """A trouble that must not stop the wheels, and not keep a stop request from stopping them either."""
    return Fault(
        name=name,
        event=event,
        cause=cause,
        first="port owner, when asked",
        latched=((PIPED, "asked meanwhile"),),
        cleared=BY_RESET,
        logged=logged,
        bar_ms=bar_ms,
        injector=injector,
        counted_from=STOP_ASKED_MEANWHILE,
        needs=frozenset({needs} - {""}),
        weight=1,
    )


WOKEN = (
    Fault(
        "hang-supervisor+port_owner-continued", SEVERAL,
        "SIGSTOP of supervisor and port_owner, SIGCONT once the stopper has stopped", "stopper",
        (
            (SUPERVISOR_SUSPENDED,), (HANGS_CAUSE, SUPERVISOR), (DIED, SUPERVISOR), (HANGS_CAUSE, PORT_OWNER),
            (DIED, PORT_OWNER),
        ), BY_RESET, "",
        processes.STOPPER_MS, "processes",
        steps=((HANG, SUPERVISOR), (HANG, PORT_OWNER), (CONTINUE, SUPERVISOR), (CONTINUE, PORT_OWNER)), weight=1,
    ),
)  # fmt: skip

CLIENT_ROWS = (
    *(
        Fault(
            name, CLIENT_FAILS, f"{how} that drives, another commands at once", "gate (its lifeline)",
            (), BY_ENABLE, DRIVER_HAS_DIED, bar_ms, name, weight=weight,
        )
        for name, how, bar_ms, weight in (
            ("client-killed", "SIGKILL of the program", processes.AT_ONCE_MS, 4),
            ("client-killed-large", "SIGKILL of a program of 300 MB", processes.AT_ONCE_MS, 1),
            ("client-hung-up", "SIGHUP, the end of its terminal, to the program", processes.AT_ONCE_MS, 2),
            ("client-fails", "an exception in the program", 20.0, 2),
            ("c-client-killed", "SIGKILL of the C program", processes.AT_ONCE_MS, 1),
            ("c-client-killed-large", "SIGKILL of a C program of 300 MB", processes.AT_ONCE_MS, 1),
            ("c-client-crashes", "a segmentation fault in the C program", processes.AT_ONCE_MS, 1),
            ("c-client-execs", "exec() by the C program", processes.AT_ONCE_MS, 1),
            ("c-client-killed-forked", "SIGKILL of the C program, whose child lives on,", processes.AT_ONCE_MS, 1),
        )
    ),
    Fault(
        "c-client-hung", CLIENT_FAILS, "SIGSTOP of the C client that drives", "gate (command timeout)",
        (), BY_ITSELF, "", 320.0, "c-client-hung", counted_from="its last command",
        aftermath_s=0.45, weight=1,
    ),
    Fault(
        "client-hung", CLIENT_FAILS, "SIGSTOP of the client that drives", "gate (command timeout)",
        (), BY_ITSELF, "", 320.0, "client-hung", counted_from="its last command",
        aftermath_s=0.45, weight=1,
    ),
    Fault(
        "pad-silent", CLIENT_FAILS, "the gamepad that drives falls silent", "gate (command timeout)",
        (), BY_ITSELF, "", 320.0, "pad-silent", aftermath_s=0.5, needs=frozenset({HAS_GAMEPAD}), weight=1,
    ),
    Fault(
        "client-nan", CLIENT_FAILS, "a command that is not a number", "gate",
        ((NOT_FINITE,),), BY_RESET, "", processes.AT_ONCE_MS, "client-nan",
    ),
    Fault(
        "client-second", CLIENT_FAILS, "a second publisher of one source", "gate",
        ((TWO_PUBLISHERS, "cmd_vel"),), BY_RESET, "", processes.AT_ONCE_MS, "client-second",
    ),
    Fault(
        "client-gamepad", CLIENT_FAILS, "a client commands zero as the gamepad", "nobody",
        (), BY_ITSELF, "the source 'gamepad' is the board's gamepad alone", None, "client-gamepad",
        aftermath_s=0.4, weight=1,
    ),
    Fault(
        "slot-scribbled", MEMORY, "the driving client's slot is overwritten", "gate (its session is gone)",
        (), BY_ENABLE, DRIVER_HAS_DIED, 60.0, "slot-scribbled", counted_from="its last command",
        aftermath_s=0.45, weight=1,
    ),
    Fault(
        "slot-truncated", MEMORY, "the driving client's slot is truncated", "gate (its session is gone)",
        (), BY_ENABLE, DRIVER_HAS_DIED, 60.0, "slot-truncated", counted_from="its last command",
        aftermath_s=0.45, weight=1,
    ),
    Fault(
        "slot-unlinked", MEMORY, "the driving client's slot is unlinked", "nobody",
        (), BY_ITSELF, "", None, "slot-unlinked", aftermath_s=0.4, weight=1,
    ),
)  # fmt: skip

MANAGER_ROWS = (
    *(
        Fault(
            name, CLIENT_FAILS, f"{how} a controller manager that drives, another program commands once it is gone",
            first, (), BY_ENABLE, logged, bar_ms, name, aftermath_s=0.4, weight=1,
        )
        for name, how, first, logged, bar_ms in (
            (
                "manager-killed", "SIGKILL of", "gate (its lifeline)", DRIVER_HAS_DIED, processes.AT_ONCE_MS,
            ),
            (
                "manager-crashes", "SIGSEGV of", "gate (its lifeline)", DRIVER_HAS_DIED, processes.AT_ONCE_MS,
            ),
            (
                "manager-interrupted", "SIGINT (Ctrl-C) to", "gate, told zero by the plugin",
                "motion disabled by", IN_TURN_MS,
            ),
        )
    ),
    Fault(
        "manager-hung", CLIENT_FAILS, "SIGSTOP of the controller manager that drives", "gate (command timeout)",
        (), BY_ITSELF, "", 320.0, "manager-hung", aftermath_s=0.45, weight=1,
    ),
)  # fmt: skip

GUARD_ROWS = (
    *(
        Fault(
            name, GUARD_FAILS, how, first, (), BY_ENABLE, DRIVER_HAS_DIED, processes.AT_ONCE_MS, name,
            aftermath_s=aftermath_s, needs=frozenset({HAS_DRIVERS}), weight=1,
        )
        for name, how, first, aftermath_s in (
            (
                "guard-driver-killed", "SIGKILL of the driver at the guard port, which is started again at once",
                "guard, then gate (driver death)", 0.3,
            ),
            (
                "guard-driver-closes", "the driver closes the guard port while it drives; another opens it at once",
                "guard, then gate (driver death)", 0.3,
            ),
            (
                "guard-killed", "SIGKILL of the guard; it is started again, and so is the driver",
                "gate (its lifeline)", 1.5,
            ),
        )
    ),
    *(
        Fault(
            name, GUARD_FAILS, how, "gate (command timeout)", (), BY_ITSELF, "", 320.0, name,
            aftermath_s=0.45, needs=frozenset({HAS_DRIVERS}), weight=1,
        )
        for name, how in (
            ("guard-driver-hung", "SIGSTOP of the driver at the guard port"),
            ("guard-hung", "SIGSTOP of the guard, while the driver writes on"),
        )
    ),
)  # fmt: skip

REQUESTS = (
    Fault(
        "service-stopped", SERVICE_STOPPED, "SIGTERM to the service", "supervisor, through the port owner",
        (), BY_NEW_RUN, "stopped; the stop was written twice", 20.0, "service-stopped",
    ),
    Fault(
        "stop-request", ASKED_TO_STOP, "a stop request by an unprivileged user", "port owner",
        ((PIPED, "nobody says so"),), BY_RESET, "", processes.ASKED_MS, "stop-request",
    ),
    Fault(
        "stop-request-posing", ASKED_TO_STOP, "a stop request in the words of a cause of the service's own",
        "port owner", ((PIPED, str(DIED(GATE))),), BY_RESET, "", processes.ASKED_MS, "stop-request-posing",
    ),
    Fault(
        "stop-pipe-garbage", ASKED_TO_STOP, "garbage in the stop FIFO", "port owner",
        ((PIPED,),), BY_RESET, "", processes.ASKED_MS, "stop-pipe-garbage",
    ),
    Fault(
        "stop-pipe-flood", ASKED_TO_STOP, "the stop FIFO is kept full", "port owner",
        ((PIPED,),), BY_RESET, "", processes.ASKED_MS, "stop-pipe-flood",
    ),
    Fault(
        "pad-button", ASKED_TO_STOP, "a button of the gamepad, one frame", "port owner, asked by telemetry",
        ((BUTTON, 0x0100),), BY_RESET, "", processes.ASKED_MS, "pad-button", needs=frozenset({HAS_GAMEPAD}),
    ),
    Fault(
        "board-key", ASKED_TO_STOP, "the board's stop key", "port owner, asked by telemetry",
        ((KEY, 1),), BY_RESET, "", processes.ASKED_MS, "board-key", needs=frozenset({HAS_KEYS}),
    ),
    Fault(
        "scan-silent", SENSOR, "the obstacle sensor falls silent, and comes back", "gate (no scan)",
        (), BY_ITSELF, "no scan for", 520.0, "scan-silent", counted_from="its last delivery",
        aftermath_s=0.65, weight=1,
    ),
    Fault(
        "interlock-lost", SENSOR, "an interlock is no longer asserted", "gate",
        (), BY_ENABLE, "motion disabled: interlock arm", 525.0, "interlock-lost", counted_from="its last assertion",
        aftermath_s=0.65, weight=1,
    ),
)  # fmt: skip

PORT_ROWS = (
    Fault(
        "usb-drop", USB, "unplugged; back under the same name", "supervisor, the moment it is back",
        ((DEVICE_LOST,),), BY_RESET, "", 20.0, "usb-drop", counted_from=BACK,
    ),
    Fault(
        "usb-drop-mid-frame", USB, "unplugged while a frame is half written", "supervisor, the moment it is back",
        ((DEVICE_LOST,),), BY_RESET, "", 20.0, "usb-drop-mid-frame", counted_from=BACK,
    ),
    Fault(
        "usb-drop-renamed", USB, "unplugged; back as another node behind the link", "supervisor, the moment it is back",
        ((DEVICE_LOST,),), BY_RESET, "", 20.0, "usb-drop-renamed", counted_from=BACK,
    ),
    Fault(
        "usb-drop-permission", USB, "unplugged; back, and the permission comes later", "supervisor, once it may open",
        ((DEVICE_LOST,),), BY_RESET, "", 20.0, "usb-drop-permission",
        counted_from="the permission", weight=1,
    ),
    Fault(
        "usb-drop-unwatched", USB, "unplugged, the supervisor stopped (SIGSTOP) meanwhile; back under the same name",
        "systemd: its watchdog, then the stop tool (ExecStopPost)", (), BY_NEW_RUN, processes.NEW_RUN_SAYS,
        1000 * WATCHDOG_S + processes.TOOL_MS, "usb-drop-unwatched", counted_from=BACK, stop_tool=True, weight=1,
    ),
    Fault(
        "board-not-draining", BOARD_FAILS, "the board takes no bytes", "nobody; port owner, once it takes bytes again",
        ((STUCK,),), BY_RESET, "POWER SWITCH", 100.0, "board-not-draining", counted_from="taking bytes again",
        weight=1,
    ),
    Fault(
        "board-deaf", BOARD_FAILS, "the board hears nothing while its telemetry goes on",
        "nobody; its 5 Hz zeros, later",
        ((DEAF,),), BY_RESET, "POWER SWITCH", 210.0, "board-deaf", counted_from="hearing again",
        aftermath_s=0.3, needs=frozenset({SHOWS_DEAF}), weight=1,
    ),
    Fault(
        "board-silent", BOARD_SAYS_NOTHING, "the board says nothing any more, and still hears",
        "port owner, by the epoch",
        ((BOARD_SILENT,),), BY_RESET, "POWER SWITCH", 1000.0, "board-silent",
        aftermath_s=1.2, needs=frozenset({HAS_REPORTS}), weight=1,
    ),
    Fault(
        "board-unwired", BOARD_FAILS, "the board neither says nor hears anything, as without its cable",
        "nobody; its 5 Hz zeros, later",
        ((BOARD_SILENT,),), BY_RESET, "POWER SWITCH", 210.0, "board-unwired", counted_from="hearing again",
        aftermath_s=0.3, needs=frozenset({HAS_REPORTS}), weight=1,
    ),
    Fault(
        "board-unproven", BOARD_FAILS, "the board has never answered a ping", "nobody",
        (), BY_ITSELF, "", None, "board-unproven", aftermath_s=1.6, link="unproven",
        needs=frozenset({HAS_PINGS}), weight=1,
    ),
    Fault(
        "board-garbles-up", BOARD_FAILS, "1 % of the bytes from the board are garbled", "nobody",
        (), BY_ITSELF, "", None, "board-garbles-up", aftermath_s=0.4, weight=1,
    ),
    _asked(
        "board-garbles-down", BOARD_FAILS, "1 % of the bytes to the board are garbled", "board-garbles-down",
        bar_ms=250, needs=HAS_CHECK,
    ),
    Fault(
        "board-restarts", BOARD_FAILS, "the board restarts, as after a dip of its supply",
        "port owner, asked by telemetry",
        ((RESTARTED,), (DEAF,)), BY_RESET, "", 250.0, "board-restarts", counted_from="hearing again",
        aftermath_s=0.6, weight=1,
    ),
    _asked("board-floods", BOARD_FAILS, "the board sends without pause", "board-floods", needs=HAS_KEYS),
    Fault(
        "board-refuses", BOARD_FAILS, "the board executes the stop, and the wheels turn on", "port owner, in vain",
        ((PIPED, "asked meanwhile"),), BY_RESET, "CRITICAL", processes.ASKED_MS, "board-refuses",
        counted_from=STOP_ASKED_MEANWHILE,
        aftermath_s=2.0, needs=frozenset({HAS_IMU}), weight=1,
    ),
    Fault(
        "board-wheel-runs-away", WHEEL_FAILS, "a wheel turns five times as fast as told, and the board reports it",
        "port owner, asked by telemetry",
        ((RUNAWAY,),), BY_RESET, "", RUN_DOWN_MS, "board-wheel-runs-away", aftermath_s=2.1,
        needs=frozenset({HAS_WHEEL_REPORTS}), weight=1,
    ),
)  # fmt: skip

SURROUNDINGS = (
    _asked("no-processor", MACHINE, "every core is busy", "no-processor"),
    _asked("no-descriptors", MACHINE, "no process may open another file", "no-descriptors"),
    Fault(
        "no-descriptors-kill", MACHINE, "no process may open another file; SIGKILL of the gate", "port owner",
        ((DIED, GATE),), BY_RESET, "", 10.0, "no-descriptors-kill", weight=1,
    ),
    _asked("no-memory", MACHINE, "no process may have more memory", "no-memory"),
    _asked("no-disk", MACHINE, "the state files can't grow", "no-disk", "can't be written", needs=HAS_BATTERY),
    Fault(
        "names-removed", MACHINE, "the names in /dev/shm are gone, as by logind's RemoveIPC=yes",
        "port owner; the supervisor looks once a second", (), BY_NEW_RUN, str(REMOVED("")).lstrip(),
        1020.0, "names-removed", aftermath_s=1.2, weight=1,
    ),
    Fault(
        "frozen", TIME, "every process frozen for 0.3 s and thawed together", "the first to wake",
        ((HANGS_CAUSE,), (MUTE,), (HELD_UP,), (STARVED,), (SUPERVISOR_SUSPENDED,)), BY_RESET, "", 65.0,
        "frozen", counted_from=THAWED, weight=1,
    ),
    Fault(
        "suspended", TIME, "the machine sleeps and wakes", "the first to wake",
        ((SUSPENDED,),), BY_RESET, "", 65.0, "suspended", counted_from="waking", weight=1,
    ),
    Fault(
        "clock-stepped", TIME, "the wall clock is stepped by an hour, both ways", "nobody",
        (), BY_ITSELF, "", None, "clock-stepped", aftermath_s=0.5, weight=1,
    ),
)  # fmt: skip

TABLE = (*processes.ROWS, *WOKEN, *CLIENT_ROWS, *MANAGER_ROWS, *GUARD_ROWS, *REQUESTS, *PORT_ROWS, *SURROUNDINGS)
FAULT_BY_NAME = {fault.name: fault for fault in TABLE}

BEYOND = (
    (
        "everything is frozen from outside (the hypervisor, SIGSTOP to all)",
        "a watchdog on the board's side",
    ),
    ("the kernel is dead or stuck", "a hardware watchdog that resets the machine; a watchdog on the board's side"),
    ("no power to USB, the cable is cut and stays cut", "a relay in the motors' supply that needs a living signal"),
    (
        "a board that hears nothing, does not drain, or does not obey",
        "the POWER SWITCH, or a relay run by `still.command`",
    ),
)
"""Faults that no program on this side of the wire can answer, and the hardware that helps."""
