"""The process table holds together with the processes, the layout and the descriptors there are."""

from __future__ import annotations

import importlib

import pytest

from failstop.messages import layout
from failstop.policy.processes import PROCESS_BY_NAME, PROCESSES, SUPERVISOR_PRIORITY, Process

each = pytest.mark.parametrize("row", PROCESSES, ids=lambda row: row.name)
STOPPING = {layout.PORT_OWNER, layout.STOPPER}


def test_every_process_of_the_layout_but_the_supervisor_has_its_row() -> None:
    assert sorted(PROCESS_BY_NAME) == sorted(set(layout.PROCESS_NAMES) - {layout.SUPERVISOR})
    assert len(PROCESS_BY_NAME) == len(PROCESSES)


@each
def test_a_row_says_what_its_process_is_and_how_it_is_woken_and_watched(row: Process) -> None:
    assert callable(importlib.import_module(row.module).run)
    assert row.role
    assert {"bell", "supervisor_bell"} <= set(row.descriptors)
    assert len(set(row.descriptors)) == len(row.descriptors)
    assert 50_000_000 <= row.deadline_ns <= 500_000_000, "a hang is noticed well within a second"


@each
def test_who_writes_to_the_port_outlives_the_supervisor_and_who_reads_it_has_it(row: Process) -> None:
    has_it = row.name in STOPPING | {layout.TELEMETRY}
    assert ("port" in row.descriptors) is has_it
    assert ("control" in row.descriptors) is has_it
    assert row.outlives_supervisor is (row.name in STOPPING)


def test_on_the_stop_path_comes_before_what_is_not() -> None:
    ranks = {row.name: row.priority for row in PROCESSES} | {layout.SUPERVISOR: SUPERVISOR_PRIORITY}
    assert min(ranks[name] for name in STOPPING) > max(rank for name, rank in ranks.items() if name not in STOPPING)
    assert ranks[layout.PORT_OWNER] > ranks[layout.STOPPER], "the port owner orders stops against motion: it goes first"
    assert ranks[layout.TELEMETRY] == min(ranks.values()), "no stop needs it"
    assert all(1 <= rank <= 98 for rank in ranks.values()), "what SCHED_FIFO takes, below the kernel's own threads"


def test_whoever_stops_is_started_before_whoever_moves() -> None:
    order = [row.name for row in PROCESSES]
    assert max(order.index(name) for name in STOPPING) < order.index(layout.GATE)
