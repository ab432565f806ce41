"""The rows about processes: each killed, hung and spinning, every two to five at once."""

from __future__ import annotations

import dataclasses
import itertools

from failstop.api.distance import DEATH_S, SLACK_S
from failstop.messages.layout import GATE, PORT_OWNER, PROCESS_NAMES, STOPPER, SUPERVISOR, TELEMETRY
from failstop.policy import causes
from failstop.policy.processes import HANG_NS, PROCESS_BY_NAME
from failstop.policy.settings import BY_KEY
from failstop_lab.faults.fault import (
    BY_NEW_RUN,
    BY_RESET,
    CONTINUE,
    CRASH,
    HANG,
    KILL,
    PROCESS_DIES,
    PROCESS_HANGS,
    SEVERAL,
    SPIN,
    Fault,
    Wanted,
)

AT_ONCE_MS = 1000 * DEATH_S
ASKED_MS = 10.0
"""From a request, a button or a key to the stop."""
NO_ANSWER_MS = AT_ONCE_MS
"""The 3 to 5 ms that the stopper and the supervisor grant a port owner that does not answer are a part of it."""
SLACK_MS = 1000 * SLACK_S
LEASE_MS = float(BY_KEY["gate.lease_s"].default) * 1000 + SLACK_MS
STOPPER_MS = HANG_NS / 1e6 + SLACK_MS
DEADLINES_MS = {name: row.deadline_ns / 1e6 + SLACK_MS for name, row in PROCESS_BY_NAME.items()}
TOOL_MS = 200.0
"""The stop tool is a new process, started once systemd, here the campaign, has seen that the supervisor is gone."""

STOP_WRITERS = {SUPERVISOR, PORT_OWNER, STOPPER}
"""Once these have died together, only the stop tool is left to write a stop."""
SEVERAL_OF_THEM = [some for count in (2, 3, 4, 5) for some in itertools.combinations(PROCESS_NAMES, count)]

NEW_RUN_SAYS = "is ready: it has told the wheels to stop"
SPARE_S = 0.12
"""Time for the burst's repeats."""

DEATH_OF = {
    GATE: "port owner (its lifeline)",
    PORT_OWNER: "supervisor and stopper, own descriptors",
    TELEMETRY: "port owner (its lifeline)",
    STOPPER: "port owner (its lifeline)",
    SUPERVISOR: "port owner (its lifeline), then stopper",
}
HANG_OF = {
    GATE: ("port owner (its lease)", LEASE_MS),
    PORT_OWNER: ("supervisor, which fences it", DEADLINES_MS[PORT_OWNER]),
    TELEMETRY: ("supervisor, through the port owner", DEADLINES_MS[TELEMETRY]),
    STOPPER: ("supervisor, through the port owner", DEADLINES_MS[STOPPER]),
    SUPERVISOR: ("port owner (its lease), then systemd's watchdog", LEASE_MS),
}
AT_ITS_END = "port owner, as the kernel ends it; without real-time rights supervisor, through the port owner"
LOOPS_IN = {
    GATE: HANG_OF[GATE],
    PORT_OWNER: ("supervisor, as it fences it or as the kernel ends it", DEADLINES_MS[PORT_OWNER]),
    TELEMETRY: (AT_ITS_END, DEADLINES_MS[TELEMETRY]),
    STOPPER: (AT_ITS_END, DEADLINES_MS[STOPPER]),
    SUPERVISOR: ("port owner (its lease); then it has died", LEASE_MS),
}
"""At real-time priority the kernel ends an endless loop after 0.1 s (procs/rights.py)."""
HANG_OF_BOTH = {
    (SUPERVISOR, PORT_OWNER): ("stopper", STOPPER_MS),
    (SUPERVISOR, GATE): ("port owner (its lease)", LEASE_MS),
    (SUPERVISOR, STOPPER): ("port owner (its lease)", LEASE_MS),
    (PORT_OWNER, GATE): ("supervisor, which fences it", DEADLINES_MS[PORT_OWNER]),
    (PORT_OWNER, STOPPER): ("supervisor, which fences it", DEADLINES_MS[PORT_OWNER]),
    (GATE, STOPPER): ("port owner (its lease)", LEASE_MS),
}


def _row(
    name: str,
    event: str,
    cause: str,
    first: str,
    bar_ms: float,
    steps: tuple[tuple[str, str], ...],
    *,
    fenced_s: float = 0.0,
    weight: int = 2,
) -> Fault:
    """The first cause stays latched; a service that lost its supervisor starts again, with nothing latched.
    `fenced_s`: the hung hang until the supervisor has fenced them; 0: they are continued before."""
    hangs = (causes.HANGS, causes.STARVED)
    fates = {KILL: (causes.DIED,), CRASH: (causes.DIED,), HANG: hangs, SPIN: (*hangs, causes.DIED)}
    struck = {process: fates[action] for action, process in steps if action != CONTINUE}
    continued = {process for action, process in steps if action == CONTINUE}
    again = SUPERVISOR in struck and SUPERVISOR not in continued
    wanted: tuple[Wanted, ...] = tuple((kind, process) for process, kinds in struck.items() for kind in kinds)
    if SUPERVISOR in continued:  # it knows by itself that it was suspended
        wanted = (
            (causes.SUPERVISOR_SUSPENDED,),
            *((kind, process) for kind, process in wanted if process != SUPERVISOR),
        )
    return Fault(
        name=name,
        event=event,
        cause=cause,
        first=first,
        latched=() if again else wanted,
        cleared=BY_NEW_RUN if again else BY_RESET,
        logged=NEW_RUN_SAYS if again else "",
        bar_ms=bar_ms,
        injector="processes",
        steps=steps,
        aftermath_s=fenced_s + SPARE_S,
        fences=fenced_s > 0 and not again,
        stop_tool={(KILL, process) for process in STOP_WRITERS} <= set(steps),
        weight=weight,
    )


def _words(processes: tuple[str, ...]) -> str:
    return f"{', '.join(processes[:-1])} and {processes[-1]}"


def _death(process: str, action: str, number: str, weight: int) -> Fault:
    cause = f"{number} of the {process}"
    return _row(
        f"{action}-{process}", PROCESS_DIES, cause, DEATH_OF[process], AT_ONCE_MS, ((action, process),), weight=weight
    )


def _hang(process: str, action: str, cause: str) -> Fault:
    first, bar_ms = (HANG_OF if action == HANG else LOOPS_IN)[process]
    steps = ((action, process),)
    fenced_s = DEADLINES_MS.get(process, bar_ms) / 1000
    return _row(f"{action}-{process}", PROCESS_HANGS, f"{cause} the {process}", first, bar_ms, steps, fenced_s=fenced_s)


def _continued(process: str, when: str) -> Fault:
    first, bar_ms = HANG_OF[process]
    cause = f"SIGSTOP of the {process}, SIGCONT {when}"
    steps = ((HANG, process), (CONTINUE, process))
    return _row(f"hang-{process}-continued", PROCESS_HANGS, cause, first, bar_ms, steps)


def _kill_many(processes: tuple[str, ...], *, apart: bool = False) -> Fault:
    """`apart`: of those after which only the stop tool is left, the row in which they die one after the other."""
    writers = tuple(process for process in (SUPERVISOR, STOPPER) if process not in processes)
    if PORT_OWNER not in processes:
        first, bar_ms = "port owner", AT_ONCE_MS
    elif writers:
        first, bar_ms = " and ".join(writers) + ", own descriptor", NO_ANSWER_MS
    elif apart:
        first, bar_ms = "the process that is killed last, or the stop tool", TOOL_MS
    else:
        first, bar_ms = "systemd: the stop tool (ExecStopPost)", TOOL_MS
    at_once = set(processes) >= STOP_WRITERS and not apart
    when = "at once" if at_once else "one after the other, within 5 ms" if apart else "at once or within 5 ms"
    cause = f"SIGKILL of {_words(processes)}, {when}"
    steps = tuple((KILL, process) for process in processes)
    name = "kill-" + "+".join(processes) + "-apart" * apart
    row = _row(name, SEVERAL, cause, first, bar_ms, steps)
    return dataclasses.replace(row, at_once=at_once)


def _kill_and_hang(killed: str, hung: str) -> Fault:
    first, bar_ms = "port owner", NO_ANSWER_MS
    if PORT_OWNER in (killed, hung):
        first = "stopper" if SUPERVISOR in (killed, hung) else "supervisor"
    elif hung == SUPERVISOR and killed != GATE:
        first, bar_ms = "port owner (its lease on the supervisor)", LEASE_MS
    cause = f"SIGKILL of the {killed}, SIGSTOP of the {hung}, at once or within 5 ms"
    steps = ((KILL, killed), (HANG, hung))
    return _row(f"kill-{killed}-hang-{hung}", SEVERAL, cause, first, bar_ms, steps, weight=1)


def _hang_both(one: str, other: str) -> Fault:
    first, bar_ms = HANG_OF_BOTH[one, other]
    cause = f"SIGSTOP of {one} and {other}, at once or within 5 ms"
    steps = ((HANG, one), (HANG, other))
    fenced_s = max(DEADLINES_MS.get(process, bar_ms) for process in (one, other)) / 1000
    return _row(f"hang-{one}+{other}", SEVERAL, cause, first, bar_ms, steps, fenced_s=fenced_s, weight=1)


ROWS = (
    *(_death(process, KILL, "SIGKILL", 16) for process in PROCESS_NAMES),
    *(_death(process, CRASH, "SIGSEGV", 2) for process in PROCESS_NAMES),
    *(_hang(process, HANG, "SIGSTOP of") for process in PROCESS_NAMES),
    *(_hang(process, SPIN, "an endless loop in") for process in PROCESS_NAMES),
    _continued(GATE, "before it is fenced"),
    _continued(SUPERVISOR, "before systemd's watchdog"),
    *(_kill_many(some) for some in SEVERAL_OF_THEM),
    *(_kill_many(some, apart=True) for some in SEVERAL_OF_THEM if set(some) >= STOP_WRITERS),
    *(_kill_and_hang(killed, hung) for killed, hung in itertools.permutations(PROCESS_NAMES, 2)),
    *(_hang_both(*pair) for pair in HANG_OF_BOTH),
)
