"""Motion needs an operator who is there: enabled only while one is, stopped by the lease's end and by leaving."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.policy import causes
from failstop.procs.gate.conditions import AHEAD_NS, DEPARTED, NOBODY_ATTENDS, Attendance
from tests.support.why import told

from .gate_bench import MS, T0, Gate

LEASE = 1000 * MS


def attended() -> Gate:
    """A gate that needs an operator, has one since now, and is enabled."""
    gate = Gate(attend__required="on")
    gate.core.attendance.hear(1, "Anna", gate.now, gate.now)
    gate.enable()
    return gate


def gone(gate: Gate) -> causes.Cause | None:
    return gate.core.attendance.gone(gate.now)


@pytest.mark.claim("ATTEND-1")
def test_nobody_has_to_attend_by_default_and_else_until_the_lease_ends(gate: Gate) -> None:
    gate.enable()
    assert gone(gate) is None
    assert told(Gate(attend__required="on").core.enable(1, "", T0)) == (False, NOBODY_ATTENDS)
    gate = attended()
    gate.now += LEASE
    assert gone(gate) is None
    gate.now += 1
    assert str(gone(gate)) == "operator gone: Anna, was not heard for 1000 ms"
    assert told(gate.core.enable(1, "", gate.now)) == (False, NOBODY_ATTENDS)


def test_the_last_of_several_counts() -> None:
    gate = attended()
    gate.core.attendance.hear(2, "Bert", gate.now, gate.now)
    gate.core.attendance.leave(1)
    assert gone(gate) is None
    gate.core.attendance.leave(2)
    assert gone(gate) == causes.OPERATOR_GONE("Bert", DEPARTED)


def test_a_record_of_somebody_who_is_gone_names_nobody() -> None:
    """The gate reads the same record at every tick. Else one would be told to have gone who did not attend last."""
    gate = attended()
    gate.now += 2 * LEASE
    assert gone(gate) == causes.OPERATOR_GONE("Anna", "was not heard for 2000 ms")
    gate.core.attendance.hear(2, "Bert", gate.now, gate.now)
    gate.core.attendance.leave(2)
    gate.core.attendance.hear(1, "Anna", T0, gate.now)
    assert gone(gate) == causes.OPERATOR_GONE("Bert", DEPARTED)
    for age_ns, attends in ((LEASE + 1, False), (LEASE, True)):
        gate.core.attendance.hear(3, "Carl", gate.now - age_ns, gate.now)
        assert gone(gate) == (None if attends else causes.OPERATOR_GONE("Bert", DEPARTED))
    gate.now += 1
    assert gone(gate) == causes.OPERATOR_GONE("Carl", "was not heard for 1000 ms")


def test_a_session_that_names_another_operator_says_that_the_one_before_has_left() -> None:
    """The page speaks for several, and names the one who was there last."""
    gate = attended()
    for _ in range(3):
        gate.core.attendance.hear(1, "Bert", gate.now - LEASE - 1, gate.now)
        assert gone(gate) == causes.OPERATOR_GONE("Anna", DEPARTED), "Bert sleeps"
    gate = attended()
    gate.core.attendance.hear(1, "Bert", gate.now - 300 * MS, gate.now)
    gate.now += LEASE - 300 * MS
    assert gone(gate) is None
    gate.now += 1
    assert gone(gate) == causes.OPERATOR_GONE("Bert", "was not heard for 1000 ms"), "by his own moment"


def test_a_stamp_from_the_future_proves_nothing() -> None:
    gate = Gate(attend__required="on")
    for ahead_ns, attends in ((AHEAD_NS + 1, False), (AHEAD_NS, True)):
        gate.core.attendance.hear(1, "Anna", gate.now + ahead_ns, gate.now)
        assert (gone(gate) is None) is attends
    gate.now += LEASE + 1
    assert gone(gate) is not None, "it counts from when it was heard"
    attendance = Attendance(LEASE, on=True)
    attendance.hear(1, "Anna", MS + AHEAD_NS + 1, MS)
    assert attendance.names(MS) == [], "nor while the machine is younger than a lease"


def test_the_gate_wakes_when_the_lease_ends_and_when_the_last_operator_leaves() -> None:
    gate = attended()
    gate.accept((0.2, 0.0, 0.0))
    assert gate.core.due_ns(gate.now) == gate.now + 300 * MS + 1  # the command's end comes first
    gate.now += 900 * MS
    gate.accept((0.2, 0.0, 0.0))
    assert gate.core.due_ns(gate.now) == T0 + LEASE + 1
    gate.core.attendance.leave(1)
    due_ns = gate.core.due_ns(gate.now)
    assert due_ns is not None
    assert due_ns <= gate.now


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 400), st.integers(0, 3000), st.booleans()), max_size=60))
def test_attendance_lasts_for_the_lease_after_the_newest_proof(steps: list[tuple[int, int, int, bool]]) -> None:
    """In any order and however late: it is attended exactly while some session that has not left
    has proven a moment no older than the lease."""
    attendance = Attendance(LEASE, on=True)
    now = T0
    proven: dict[int, int] = {}
    for session, elapsed_ms, age_ms, leaves in steps:
        now += elapsed_ms * MS
        if leaves:
            attendance.leave(session)
            proven.pop(session, None)
        else:
            attendance.hear(session, str(session), now - age_ms * MS, now)
            proven[session] = max(proven.get(session, 0), now - age_ms * MS)
        there = {str(each) for each, at in proven.items() if now - at <= LEASE}
        assert set(attendance.names(now)) == there
        assert (attendance.gone(now) is None) == bool(there)
