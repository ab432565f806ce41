"""The fault table: each row injected once and judged by the board, and no row missing."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import pytest

from failstop.faults import inject, report
from failstop.faults.campaign import inject_one
from failstop.faults.fault import CONTINUE, EVENTS, HANG, ITSELF, KILL, NEW_RUN, SPIN, Fault
from failstop.faults.scene import Scene
from failstop.faults.table import BY_NAME, TABLE
from failstop.shm.layout import PROCESSES, SUPERVISOR

DESIGN = {
    "gate dies or hangs": ("kill-gate", "hang-gate", "spin-gate", "hang-gate-continued"),
    "port owner dies": ("kill-port_owner",),
    "port owner hangs": ("hang-port_owner", "spin-port_owner"),
    "telemetry, stopper die or hang": ("kill-telemetry", "hang-telemetry", "kill-stopper", "hang-stopper"),
    "supervisor dies": ("kill-supervisor",),
    "supervisor hangs": ("hang-supervisor", "spin-supervisor", "hang-supervisor-continued"),
    "any two or three at once": ("kill-gate+stopper", "kill-supervisor+port_owner+stopper", "kill-gate-hang-stopper"),
    "all of them": ("kill-supervisor+port_owner+gate+telemetry+stopper",),
    "client that drives dies": ("client-killed", "client-killed-large", "client-hung", "pad-silent"),
    "USB drop": ("usb-drop", "usb-drop-mid-frame", "usb-drop-renamed", "usb-drop-permission"),
    "USB drop while the supervisor hangs": ("usb-drop-unwatched",),
    "board deaf, not draining": ("board-deaf", "board-not-draining", "board-unproven"),
    "out of file descriptors, memory, disk": ("no-descriptors", "no-descriptors-kill", "no-memory", "no-disk"),
    "shared memory scribbled, truncated, unlinked by a client": ("slot-scribbled", "slot-truncated", "slot-unlinked"),
    "machine suspended or clock stepped": ("suspended", "frozen", "clock-stepped"),
    "a board that does not obey": ("board-refuses",),
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
"""What the design says must be noticed, and the rows for it."""


@pytest.mark.slow
@pytest.mark.parametrize("fault", TABLE, ids=lambda fault: fault.name)
def test_row(scene: Scene, fault: Fault) -> None:
    outcome = inject_one(scene, fault, seed="table")
    if outcome.skipped:
        pytest.skip(outcome.skipped)
    assert not outcome.wrong, outcome.story("table")


def test_no_row_of_the_design_is_missing() -> None:
    for names in DESIGN.values():
        assert set(names) <= set(BY_NAME)
    assert {fault.event for fault in TABLE} == set(EVENTS)


def test_every_process_and_every_few_of_them() -> None:
    steps = {tuple(sorted(fault.steps)) for fault in TABLE}
    for action in (KILL, HANG, SPIN):
        assert {((action, process),) for process in PROCESSES} <= steps
    for count in range(2, len(PROCESSES) + 1):
        for few in itertools.combinations(PROCESSES, count):
            assert tuple(sorted((KILL, process) for process in few)) in steps
    for killed, hung in itertools.permutations(PROCESSES, 2):
        assert tuple(sorted(((KILL, killed), (HANG, hung)))) in steps


def test_every_row_has_an_injector_and_every_injector_a_row() -> None:
    known = inject.names()
    assert {fault.injector for fault in TABLE} == known
    assert len(BY_NAME) == len(TABLE)


@pytest.mark.parametrize("fault", TABLE, ids=lambda fault: fault.name)
def test_a_row_is_in_order(fault: Fault) -> None:
    assert re.fullmatch(r"[a-z_+-]+", fault.name)
    re.compile(fault.latched)
    re.compile(fault.logged)
    if fault.cleared in (NEW_RUN, ITSELF):
        assert not fault.latched, "a latch does not clear by itself, nor outlive the run"
    if fault.bar_ms is None:
        assert fault.cleared == ITSELF
    else:
        assert fault.limit_ms is not None
        assert fault.limit_ms > fault.bar_ms
        assert fault.logged or fault.cleared == ITSELF, "a stop that is not over by itself is said"
    lost = SUPERVISOR in fault.struck(KILL, HANG, SPIN) and SUPERVISOR not in fault.struck(CONTINUE)
    assert not lost or not fault.survives


def test_the_page_has_the_rows_of_the_table() -> None:
    page = (Path(__file__).parents[2] / "docs" / "faults.md").read_text()
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    assert len(rows) == len(TABLE)
    for fault, row in zip(sorted(TABLE, key=lambda fault: EVENTS.index(fault.event)), rows, strict=True):
        assert row.startswith(report.described(fault)), "failstop chaos --each 5 --json F --markdown > docs/faults.md"
