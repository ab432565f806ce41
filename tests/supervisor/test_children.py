"""The state of a process: every cell of the table of what changes it; its restarts, ever later; its fencing."""

from __future__ import annotations

import importlib
from collections.abc import Sequence

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from failstop.messages import layout
from failstop.policy import causes
from failstop.policy.processes import PROCESS_BY_NAME, PROCESSES, SUPERVISOR_PRIORITY, Process
from failstop.policy.settings import Settings
from failstop.procs.loop import Timer
from failstop.supervisor import children
from failstop.supervisor.children import (
    BEATS,
    DEAD,
    DOWN,
    FENCED,
    GIVEN_UP,
    HUNG,
    KILLED,
    LONGEST_WAIT_NS,
    NEXT,
    REAPED,
    RECALLED,
    RUNNING,
    RUNS,
    SPARED,
    STARTED,
    STARTING,
    STARTING_NS,
    TERMINATED,
    WAITING,
    Child,
    Fence,
)

STATES = (WAITING, DOWN, STARTING, RUNNING, HUNG, FENCED, DEAD)
SHORT = {"WA": WAITING, "DO": DOWN, "ST": STARTING, "RU": RUNNING, "HU": HUNG, "FE": FENCED, "DE": DEAD}
EVENTS = (STARTED, RUNS, SPARED, BEATS, KILLED, TERMINATED, REAPED, GIVEN_UP, RECALLED)
CELLS = """
    ST  -   -   WA  -   -   -   DO  -
    ST  -   -   DO  -   -   -   -   WA
    -   RU  ST  ST  FE  DE  -   -   -
    -   -   HU  RU  FE  DE  -   -   -
    -   -   HU  RU  FE  DE  -   -   -
    -   -   -   FE  -   DE  -   -   -
    -   -   -   DE  -   -   WA  -   -
"""
"""A row a state, a column an event, as they are declared; what cannot happen is a dash: nobody is started who has a
process, nobody runs who has none, nobody dies twice, and only the dead are reaped, and later given up."""


LEASE_NS = 60_000_000


def child(
    state: str, limits: tuple[int, int, int] = (5, 10**10, 10**8), row: Process = PROCESSES[0], lease_ns: int = LEASE_NS
) -> Child:
    settings, (deaths, window_ns, backoff_ns) = Settings(), limits
    settings.values |= {"restart.deaths": deaths, "restart.window_s": window_ns / S}
    settings.values |= {"restart.backoff_s": backoff_ns / S, "gate.lease_s": lease_ns / S}
    made = Child(row, None, Timer(), settings)  # type: ignore[arg-type]
    made.state = state
    return made


def cells() -> list[tuple[str, str, str]]:
    rows = [line.split() for line in CELLS.strip().splitlines()]
    assert len(rows) == len(STATES)
    assert {len(row) for row in rows} == {len(EVENTS)}
    return [(state, *cell) for state, row in zip(STATES, rows, strict=True) for cell in zip(EVENTS, row, strict=True)]


@pytest.mark.parametrize("row", PROCESSES, ids=lambda row: row.name)
def test_nobody_that_runs_has_less_time_than_a_lease(row: Process) -> None:
    assert child(RUNNING, row=row).allowed_ns() == row.deadline_ns, "the usual lease is shorter than every deadline"
    for lease_ns in (row.deadline_ns - 1, row.deadline_ns + 1):
        assert child(RUNNING, row=row, lease_ns=lease_ns).allowed_ns() == max(row.deadline_ns, lease_ns)
    assert child(STARTING, row=row, lease_ns=10**12).allowed_ns() == STARTING_NS


@pytest.mark.parametrize(("state", "event", "cell"), cells())
def test_every_cell(state: str, event: str, cell: str) -> None:
    found = child(state)
    found.on(event)
    assert (event in NEXT[state]) is (cell != "-")
    assert found.state == SHORT.get(cell, state), "what cannot happen changes nothing"
    assert found.defects == ([] if cell != "-" else [causes.DEFECT("port_owner", event, state)])


def test_no_state_and_no_event_is_left_out() -> None:
    declared = [text for name, text in vars(children).items() if name.isupper() and isinstance(text, str)]
    assert sorted(declared) == sorted((*STATES, *EVENTS))
    assert set(NEXT) == set(STATES)
    assert {event for row in NEXT.values() for event in row} == set(EVENTS)
    assert {after for row in NEXT.values() for after in row.values()} == set(STATES)


@pytest.mark.parametrize("state", STATES)
def test_whatever_it_is_it_can_come_to_run(state: str) -> None:
    reached = {state}
    while more := {after for at in reached for after in NEXT[at].values()} - reached:
        reached |= more
    assert RUNNING in reached


MS = 1_000_000
S = 1_000 * MS
T0 = 777 * S
BACKOFF = 100 * MS


@pytest.mark.parametrize(
    ("limit", "deaths_s", "waits"),
    [
        (5, (0, 1, 2, 3, 4), [0, 1, 2, 4, None]),
        (5, (0, 1, 2, 3, 61.5, 200), [0, 1, 2, 4, 2, 0]),  # with two of the four, then with none
        (100, [n / 100 for n in range(99)], [0, *(2**n for n in range(98))]),
    ],
)
def test_a_restart_waits_twice_as_long_each_time(
    limit: int, deaths_s: Sequence[float], waits: list[int | None]
) -> None:
    """Not at all at the first death, in units of the first wait, and up to the longest."""
    one, other = (child(WAITING, (limit, 60 * S, BACKOFF)) for _ in range(2))
    for death_s, wait in zip(deaths_s, waits, strict=True):
        expected = None if wait is None else min(wait * BACKOFF, LONGEST_WAIT_NS)
        assert one.restart_wait_ns(T0 + round(death_s * S)) == expected
    assert other.restart_wait_ns(T0) == 0, "each process is counted for itself"


@given(limit=st.integers(1, 10), backoff=st.integers(1, 10 * S), gaps=st.lists(st.integers(0, 90 * S), max_size=40))
@example(5, BACKOFF, [0, S, S, S, S, S, 54 * S])
@example(5, BACKOFF, [0, 60 * S - 1])
@example(5, BACKOFF, [0, 60 * S])
@example(5, BACKOFF, [0, *[61 * S] * 99])
@example(5, BACKOFF, [0, *[15 * S] * 4, S // 2])
@example(1, BACKOFF, [0, 1000 * S])
def test_a_restart_is_refused_when_and_only_when_the_window_is_full(limit: int, backoff: int, gaps: list[int]) -> None:
    restarts = child(WAITING, (limit, 60 * S, backoff))
    deaths: list[int] = []
    now = T0
    for gap in gaps:
        now += gap
        deaths.append(now)
        within = sum(now - death < 60 * S for death in deaths)
        wait = restarts.restart_wait_ns(now)
        assert (wait is None) == (within >= limit)
        if wait is not None:
            assert 0 <= wait <= LONGEST_WAIT_NS
            assert (wait == 0) == (within == 1)


def test_a_fence_tells_its_times_in_order() -> None:
    fence = Fence(T0, T0 + MS // 10, T0 + MS // 5)
    assert fence.story("port_owner") == "port_owner was fenced: killed after 0.1 ms, stop written after 0.2 ms"
    fence.gone_ns, fence.again_ns = T0 + MS, T0 + 2 * MS
    assert fence.story("port_owner") == (
        "port_owner was fenced: killed after 0.1 ms, stop written after 0.2 ms, "
        "gone after 1.0 ms, stop again after 2.0 ms"
    )
    assert fence.fields() == {
        "silent_ms": 0.0,
        "kill_us": 100.0,
        "burst_us": 200.0,
        "gone_us": 1000.0,
        "again_us": 2000.0,
    }
    assert not fence.was_starved
    gate = Fence(T0, T0 + MS, 0, 61_250_001)
    gate.gone_ns = T0 + 200 * MS
    assert gate.story("gate") == "gate was fenced: killed after 1.0 ms, gone after 200.0 ms"
    assert gate.fields() == {"silent_ms": 61.3, "kill_us": 1000.0, "gone_us": 200000.0}


# The process table.


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
