"""The fault table: each row injected once and judged by the board, and no row missing."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import pytest

from failstop.messages.layout import PORT_OWNER, PROCESS_NAMES, STOPPER, SUPERVISOR
from failstop.policy import causes
from failstop.policy.layouts import BOARDS
from failstop_lab.boards.traits import traits_of
from failstop_lab.faults import arm_table, injectors, report
from failstop_lab.faults.fault import (
    BY_ITSELF,
    BY_NEW_RUN,
    CONTINUE,
    CRASH,
    FAULT_CLASSES,
    HANG,
    KILL,
    SPIN,
    Fault,
    fits,
)
from failstop_lab.faults.injection import inject_one
from failstop_lab.faults.scene import Scene
from failstop_lab.faults.table import FAULT_BY_NAME, TABLE
from tests.support.amounts import LONG

DESIGN = {
    "gate dies or hangs": ("kill-gate", "hang-gate", "spin-gate", "hang-gate-continued"),
    "port owner dies": ("kill-port_owner",),
    "port owner hangs": ("hang-port_owner", "spin-port_owner"),
    "telemetry, stopper die or hang": ("kill-telemetry", "hang-telemetry", "kill-stopper", "hang-stopper"),
    "supervisor dies": ("kill-supervisor",),
    "supervisor hangs": ("hang-supervisor", "spin-supervisor", "hang-supervisor-continued"),
    "any two or three at once": ("kill-gate+stopper", "kill-supervisor+port_owner+stopper", "kill-gate-hang-stopper"),
    "all of them": ("kill-supervisor+port_owner+gate+telemetry+stopper",),
    "client that drives dies": ("client-killed", "client-killed-large", "client-hung-up", "client-fails"),
    "C client that drives dies": (
        *("c-client-killed", "c-client-killed-large", "c-client-crashes", "c-client-execs", "c-client-killed-forked"),
    ),
    "client that drives hangs": ("client-hung", "c-client-hung", "pad-silent"),
    "controller manager killed, crashed, interrupted, hung": (
        *("manager-killed", "manager-crashes", "manager-interrupted", "manager-hung"),
    ),
    "driver at the guard port dies, closes or hangs": (
        *("guard-driver-killed", "guard-driver-closes", "guard-driver-hung"),
    ),
    "guard dies or hangs": ("guard-killed", "guard-hung"),
    "USB drop": ("usb-drop", "usb-drop-mid-frame", "usb-drop-renamed", "usb-drop-permission"),
    "USB drop while the supervisor hangs": ("usb-drop-unwatched",),
    "board deaf, not draining": ("board-deaf", "board-not-draining", "board-unproven"),
    "out of file descriptors, memory, disk": ("no-descriptors", "no-descriptors-kill", "no-memory", "no-disk"),
    "shared memory scribbled, truncated, unlinked by a client": ("slot-scribbled", "slot-truncated", "slot-unlinked"),
    "machine suspended or clock stepped": ("suspended", "frozen", "clock-stepped"),
    "a board that does not obey": ("board-refuses", "board-wheel-runs-away"),
    "bytes garbled on the way": ("board-garbles-up", "board-garbles-down", "board-floods"),
    "stop requests, by anyone": (
        *("stop-request", "stop-request-posing", "stop-pipe-garbage", "stop-pipe-flood"),
        *("pad-button", "board-key"),
    ),
    "clients that misbehave": ("client-nan", "client-second", "client-gamepad"),
    "the sensor and the interlocks": ("scan-silent", "interlock-lost"),
    "the service is stopped": ("service-stopped",),
    "no processor time": ("no-processor",),
    "names of shared memory taken away": ("names-removed",),
}
"""Faults that the design says must be noticed, and the rows for them."""
NO_FAULT = {
    *(causes.BAD_FRAME, causes.DEFECT, causes.UNKNOWN),  # a defect of the service's own
    causes.BATTERY,  # only where a setting asks for it
    causes.DRIVER_DIED,  # only where a setting asks for it (tests/procs/test_gate_driver_death.py)
    causes.DRIVER_SILENT,  # only where a setting asks for it (tests/procs/test_gate_sources.py)
    causes.OPERATOR_GONE,  # only where a setting asks for one (tests/procs/test_gate_attendance.py, tests/web)
    causes.UNCOUNTED,  # only boards that control by their counts (tests/procs/telemetry/test_runaway_service.py)
    causes.UNSTILL,  # comes after the stop of another row
    causes.NOT_HEARD,  # only on a machine that starves the service (tests/supervisor/test_stop_tracker.py)
    causes.FLEET,  # as PIPED, by a publisher (tests/fleet/test_publish.py)
    *(row for row in causes.SIGNED if row is not causes.REQUESTED),  # as REQUESTED, by the ROS bridge (tests/ros2)
    *(causes.REMOVED, causes.STOPPING, causes.ALL_DIED, causes.SILENT),  # with them the run ends, or nobody is to latch
}
"""Causes that no row latches."""
WRITERS = frozenset({SUPERVISOR, PORT_OWNER, STOPPER})
"""Those that can write a stop. A row in which the supervisor ends costs a start of the whole service: where others go
with it, writers or all of them are tried each time, and every row in a long campaign."""


FIRST = [fault for fault in TABLE if fault.needs <= traits_of(BOARDS[0]).parts]
"""The rows of the first board; of the others each is injected at the boards that it is for (test_every_board.py)."""


def tried(fault: Fault) -> bool:
    struck = set(fault.struck(KILL, HANG))
    several = len(fault.steps) > 1 and SUPERVISOR in struck
    return LONG or not several or struck <= WRITERS or struck == set(PROCESS_NAMES)


@pytest.mark.slow
@pytest.mark.parametrize("fault", [fault for fault in FIRST if tried(fault)], ids=lambda fault: fault.name)
def test_row(scene: Scene, fault: Fault) -> None:
    outcome = inject_one(scene, fault, seed="table")
    if outcome.skipped:
        pytest.skip(outcome.skipped)
    assert not outcome.wrong, outcome.story("table")


def test_no_row_of_the_design_is_missing() -> None:
    for names in DESIGN.values():
        assert set(names) <= set(FAULT_BY_NAME)
    assert {fault.event for fault in TABLE} == set(FAULT_CLASSES)


def test_every_process_and_every_few_of_them() -> None:
    steps = {tuple(sorted(fault.steps)) for fault in TABLE}
    for action in (KILL, CRASH, HANG, SPIN):
        assert {((action, process),) for process in PROCESS_NAMES} <= steps
    for count in range(2, len(PROCESS_NAMES) + 1):
        for few in itertools.combinations(PROCESS_NAMES, count):
            assert tuple(sorted((KILL, process) for process in few)) in steps
    for killed, hung in itertools.permutations(PROCESS_NAMES, 2):
        assert tuple(sorted(((KILL, killed), (HANG, hung)))) in steps


def test_every_row_has_an_injector_and_every_injector_a_row() -> None:
    known = set(injectors.INJECTORS)
    assert {fault.injector for fault in TABLE} == known
    assert len(FAULT_BY_NAME) == len(TABLE)


def test_every_row_is_in_order() -> None:
    for fault in TABLE:
        check_row(fault)


def check_row(fault: Fault) -> None:
    assert re.fullmatch(r"[a-z_+-]+", fault.name)
    for kind, *first in fault.latched:
        assert causes.BY_NUMBER[kind.number] is kind, fault.name
        assert all(type(value) is of for value, (_, of) in zip(first, kind.parameters, strict=False)), fault.name
        assert len(first) <= len(kind.parameters), fault.name
        assert "process" not in dict(kind.parameters) or set(first) <= set(PROCESS_NAMES), fault.name
        assert kind.cleared_by == causes.A_RESET, f"{fault.name}: what but a new start clears is latched by no row"
    if fault.cleared in (BY_NEW_RUN, BY_ITSELF):
        assert not fault.latched, f"{fault.name}: a latch does not clear by itself, nor outlive the run"
    if fault.bar_ms is None:
        assert fault.cleared == BY_ITSELF, fault.name
    else:
        assert fault.limit_ms is not None, fault.name
        assert fault.limit_ms > fault.bar_ms, fault.name
        told = fault.logged or fault.latched or fault.cleared == BY_ITSELF
        assert told, f"{fault.name}: a stop that is not over by itself is said"
    lost = SUPERVISOR in fault.struck(KILL, CRASH, HANG, SPIN) and SUPERVISOR not in fault.struck(CONTINUE)
    assert not lost or not fault.survives, fault.name


def test_what_is_latched_fits_its_row_and_no_other() -> None:
    died, hangs = causes.DIED("gate"), causes.HANGS("gate", 61)
    assert fits(died, ((causes.DIED, "gate"),))
    assert fits(died, ((causes.DIED,),))
    assert fits(hangs, ((causes.DIED, "gate"), (causes.HANGS, "gate"), (causes.STARVED, "gate")))
    assert not fits(died, ((causes.DIED, "telemetry"), (causes.HANGS, "gate")))
    assert not fits(causes.PIPED("gate died"), ((causes.DIED, "gate"), (causes.REQUESTED,)))
    assert not fits(causes.PIPED("asked"), ((causes.PIPED, "asked meanwhile"),))
    assert not fits(None, ((causes.DIED,),))
    assert not fits(died, ())


def test_every_cause_of_a_running_service_is_in_the_table() -> None:
    latched = {kind for fault in TABLE for kind, *_ in fault.latched}
    latched |= {kind for fault in arm_table.ROWS for kind, *_ in fault.latched}
    assert set(causes.BY_NUMBER.values()) - latched == NO_FAULT


def test_the_page_has_the_rows_of_the_table() -> None:
    page = (Path(__file__).parents[3] / "docs" / "reference" / "faults.md").read_text()
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    described = [report.described(fault) for fault in sorted(FIRST, key=lambda fault: FAULT_CLASSES.index(fault.event))]
    described += [fault.described() for fault in arm_table.ROWS]
    for expected, row in zip(described, rows, strict=True):
        assert row.startswith(expected), "make docs"
