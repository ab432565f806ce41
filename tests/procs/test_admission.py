"""Admission, row by row: what may go to the wire, what is dropped and what is a stop cause."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.board import codec
from failstop.board.burst import BURST
from failstop.policy import causes
from failstop.procs.port_owner.admission import Admission

MS = 1_000_000
LEASE_NS = 60 * MS
NOW = 9_000 * MS
MAX_RPS = 2.0
FRAME = codec.motor_speeds((0.8, 0.8, -0.8, -0.8), MAX_RPS)

epochs = st.integers(0, 5)


@pytest.fixture
def admission() -> Admission:
    return Admission(LEASE_NS, MAX_RPS)


def test_a_young_frame_of_the_current_epoch_goes(admission: Admission) -> None:
    assert admission.current(1, NOW - 5 * MS, 1, NOW)
    assert admission.frame_fault(FRAME) is None


# Leases.


@pytest.mark.parametrize(("silent_ns", "lapsed"), [(0, False), (LEASE_NS - 1, False), (LEASE_NS, True), (NOW, True)])
def test_a_lease_runs_out_exactly_then(admission: Admission, silent_ns: int, lapsed: bool) -> None:
    assert admission.lapsed(NOW - silent_ns, NOW) is lapsed


def test_a_beat_that_never_came_is_a_lease_run_out(admission: Admission) -> None:
    assert admission.lapsed(0, NOW)


def test_a_beat_after_the_time_was_taken_is_fresh(admission: Admission) -> None:
    assert not admission.lapsed(NOW + MS, NOW)


# Content.


@pytest.mark.parametrize(
    ("frame", "fault"),
    [
        (FRAME[:-1], "not a motor frame"),
        (FRAME + b"\0", "not a motor frame"),
        (b"", "not a motor frame"),
        (BURST, "not a motor frame"),
        (codec.buzzer(1400, 100, 100, 5), "not a motor frame"),
        (codec.motor_one(0, 0.5, MAX_RPS), "not a motor frame"),
        (FRAME[:-1] + bytes((FRAME[-1] ^ 1,)), "bad crc"),
        (codec.motor_speeds((0.0, 0.0, 0.0, 2.5), 3.0), "wheel 3 at 2.50 rps, limit 2.00"),
        (codec.motor_speeds((-2.01, 0.0, 0.0, 0.0), 3.0), "wheel 0 at -2.01 rps, limit 2.00"),
    ],
)
def test_content_that_is_a_stop_cause(admission: Admission, frame: bytes, fault: str) -> None:
    assert admission.frame_fault(frame) == causes.BAD_FRAME(fault)


def test_zero_and_the_very_limit_are_no_fault(admission: Admission) -> None:
    assert admission.frame_fault(codec.STOP) is None
    assert admission.frame_fault(codec.motor_speeds((MAX_RPS, -MAX_RPS, MAX_RPS, -MAX_RPS), MAX_RPS)) is None


# Epoch.


@pytest.mark.parametrize(("frame_epoch", "epoch"), [(1, 2), (2, 1), (0, 1), (1, 0)])
def test_a_frame_of_any_other_epoch_is_dropped(admission: Admission, frame_epoch: int, epoch: int) -> None:
    assert not admission.current(frame_epoch, NOW, epoch, NOW)


def test_epoch_zero_is_before_every_run(admission: Admission) -> None:
    assert not admission.current(0, NOW, 0, NOW)


def test_its_own_stop_refuses_its_epoch_until_a_newer_one(admission: Admission) -> None:
    admission.stopped(4, own=True)
    assert not admission.current(4, NOW, 4, NOW)
    assert admission.current(5, NOW, 5, NOW)


def test_a_stop_for_the_supervisors_cause_does_not_close_the_new_epoch(admission: Admission) -> None:
    admission.stopped(4, own=False)
    assert admission.current(4, NOW, 4, NOW)


@given(st.lists(st.tuples(epochs, st.booleans())), epochs, epochs)
def test_what_was_stopped_in_an_epoch_never_moves_in_it_or_before(
    stops: list[tuple[int, bool]], frame_epoch: int, epoch: int
) -> None:
    admission = Admission(LEASE_NS, MAX_RPS)
    for stopped_in, own in stops:
        admission.stopped(stopped_in, own=own)
    newest = max((stopped_in for stopped_in, own in stops if own), default=0)
    assert admission.current(frame_epoch, NOW, epoch, NOW) == (frame_epoch == epoch and epoch > newest)


# Age.


@pytest.mark.parametrize(("age_ns", "goes"), [(0, True), (LEASE_NS - 1, True), (LEASE_NS, False), (NOW, False)])
def test_a_frame_must_be_younger_than_the_lease(admission: Admission, age_ns: int, goes: bool) -> None:
    assert admission.current(1, NOW - age_ns, 1, NOW) is goes


# Moving.


@pytest.mark.parametrize("own", [True, False])
def test_every_stop_ends_the_motion(admission: Admission, own: bool) -> None:
    assert not admission.moving
    admission.moving = True
    admission.stopped(1, own=own)
    assert not admission.moving
