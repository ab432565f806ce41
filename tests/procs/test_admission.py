"""Admission, the whole table: which row decides, its boundaries, and what is dropped, written, or a stop."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from failstop.board import codec
from failstop.board.burst import BURST
from failstop.board.rrc.board import BOARD
from failstop.lab import encoders
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.procs.port_owner.admission import ADMIT, DROP, STAND_STILL, STOP_ASKED, Admission, DatedFrame

MS = 1_000_000
LEASE_NS = 60 * MS
NOW = 9_000 * MS
MAX_RPS = 2.0
FRAME = codec.motor_speeds((0.8, 0.8, -0.8, -0.8), MAX_RPS)
TOO_FAST = codec.motor_speeds((0.0, 0.0, 0.0, 2.5), 3.0)
EPOCH = 4

epochs = st.integers(0, 5)


@pytest.fixture
def admission() -> Admission:
    return Admission(BOARD, LEASE_NS, MAX_RPS)


def decided(
    admission: Admission,
    motion: DatedFrame = (FRAME, EPOCH, NOW),
    *,
    epoch: int = EPOCH,
    gate_ns: int | None = NOW,
    supervisor_ns: int = NOW,
    requested: bool = False,
) -> int | Cause:
    return admission.decide(motion, epoch, NOW, gate_ns, supervisor_ns, admission, requested=requested)


GATE, DEAD_EPOCH, OWN_STOP, OLD, ASKED, GATE_LEASE, SUPERVISOR_LEASE, CONTENT = ROWS = range(8)
ELSE: dict[int, int | Cause] = {
    GATE: DROP,
    DEAD_EPOCH: DROP,
    OWN_STOP: DROP,
    OLD: DROP,
    ASKED: STOP_ASKED,
    GATE_LEASE: causes.HANGS("gate", 60),
    SUPERVISOR_LEASE: causes.HANGS("supervisor", 61),
    CONTENT: causes.BAD_FRAME("wheel 3 at 2.50 rps, limit 2.00"),
}


@pytest.mark.parametrize("kind", ["motion", "zero", "zero, nothing moves"])
@pytest.mark.parametrize("first", [*ROWS, None])
def test_the_first_row_that_does_not_hold_decides(first: int | None, kind: str) -> None:
    """The rows after it change nothing."""
    rows = [row for row in ROWS if kind == "motion" or row != CONTENT]  # zeros have no other content
    after = [row for row in rows if first is not None and row > first]
    for later in (set(some) for n in range(len(after) + 1) for some in itertools.combinations(after, n)):
        failing = later if first is None else {first, *later}
        admission = Admission(BOARD, LEASE_NS, MAX_RPS)
        admission.wheels_move = kind == "zero"
        if OWN_STOP in failing:
            admission.stopped_in = EPOCH
        frame = codec.STOP if kind != "motion" else TOO_FAST if CONTENT in failing else FRAME
        found = decided(
            admission,
            (frame, EPOCH - (DEAD_EPOCH in failing), NOW - LEASE_NS * (OLD in failing)),
            gate_ns=None if GATE in failing else NOW - LEASE_NS * (GATE_LEASE in failing),
            supervisor_ns=NOW - (LEASE_NS + MS) * (SUPERVISOR_LEASE in failing),
            requested=ASKED in failing,
        )
        expected = ADMIT if first is None or (first == CONTENT and kind != "motion") else ELSE[first]
        assert found == (STAND_STILL if expected == DROP and kind == "zero" else expected), failing


# Leases.


@pytest.mark.parametrize(("silent_ns", "lapsed"), [(0, False), (LEASE_NS - 1, False), (LEASE_NS, True), (NOW, True)])
def test_a_lease_runs_out_exactly_then(admission: Admission, silent_ns: int, lapsed: bool) -> None:
    beat_ns = NOW - silent_ns
    assert decided(admission, gate_ns=beat_ns) == (causes.HANGS("gate", silent_ns // MS) if lapsed else ADMIT)
    told = causes.HANGS("supervisor", silent_ns // MS)
    assert decided(admission, supervisor_ns=beat_ns) == (told if lapsed else ADMIT)
    assert bool(admission.lapsed(beat_ns, NOW, NOW)) is lapsed
    assert (admission.lapses_ns(beat_ns, NOW) <= NOW) is lapsed
    assert (admission.lapses_ns(NOW, beat_ns) <= NOW) is lapsed
    assert decided(admission, (FRAME, EPOCH, beat_ns)) == (DROP if lapsed else ADMIT), "a frame must be younger"


def test_a_beat_after_the_time_was_taken_is_fresh(admission: Admission) -> None:
    assert decided(admission, gate_ns=NOW + MS, supervisor_ns=NOW + MS) == ADMIT


# Content.


@pytest.mark.parametrize(
    ("frame", "fault"),
    [
        (FRAME[:-1], "not a motor frame"),
        (FRAME + b"\0", "not a motor frame"),
        (b"", "not a motor frame"),
        (BURST, "not a motor frame"),
        (codec.buzzer(1400, 100, 100, 5), "not a motor frame"),
        (encoders.motor_one(0, 0.5, MAX_RPS), "not a motor frame"),
        (FRAME[:-1] + bytes((FRAME[-1] ^ 1,)), "bad crc"),
        (TOO_FAST, "wheel 3 at 2.50 rps, limit 2.00"),
        (codec.motor_speeds((-2.01, 0.0, 0.0, 0.0), 3.0), "wheel 0 at -2.01 rps, limit 2.00"),
        (codec.STOP, ADMIT),
        (codec.motor_speeds((MAX_RPS, -MAX_RPS, MAX_RPS, -MAX_RPS), MAX_RPS), ADMIT),
    ],
)
def test_content(admission: Admission, frame: bytes, fault: int | str) -> None:
    expected = causes.BAD_FRAME(fault) if isinstance(fault, str) else fault
    assert decided(admission, (frame, EPOCH, NOW)) == expected


# Epoch.


@pytest.mark.claim("MOVE-1")
@given(st.lists(epochs), epochs, epochs)
@example([], 0, 0)
@example([], 1, 2)
@example([], 2, 1)
@example([4], 4, 4)
@example([4], 5, 5)
def test_a_frame_of_another_epoch_or_one_that_was_stopped_in_is_dropped(
    stops: list[int], frame_epoch: int, epoch: int
) -> None:
    """Epoch 0 is before every run."""
    admission = Admission(BOARD, LEASE_NS, MAX_RPS)
    for stopped_in in stops:
        admission.wheels_move = True
        admission.stopped(stopped_in, NOW)
        assert not admission.wheels_move
    admitted = frame_epoch == epoch and epoch > max(stops, default=0)
    assert decided(admission, (FRAME, frame_epoch, NOW), epoch=epoch) == (ADMIT if admitted else DROP)


# Invariants.


@pytest.mark.parametrize(
    ("latched_in", "frame_ns", "alone", "broken"),
    [
        (0, NOW, True, None),
        (EPOCH + 1, NOW, True, None),  # a stop that is just being raised
        (EPOCH, NOW, True, "gate: motion while a stop is latched"),
        (1, NOW, True, "gate: motion while a stop is latched"),
        (0, NOW - 1, True, "gate: motion while a stop is newer"),
        (0, NOW, False, "port_owner: motion while another process writes its memory"),
    ],
)
@pytest.mark.parametrize("own", [True, False])
def test_an_invariant_that_does_not_hold_is_a_stop(
    admission: Admission, latched_in: int, frame_ns: int, alone: bool, broken: str | None, own: bool
) -> None:
    """Of a frame that was admitted, after a stop at NOW: its own, or for a new epoch."""
    if own:
        admission.stopped(EPOCH - 1, NOW)
    else:
        assert admission.follow(EPOCH, EPOCH - 1, NOW) is None
    found = admission.impossible(frame_ns, EPOCH, latched_in, alone=alone)
    assert (found and str(found)) == (broken and f"internal error: {broken}")


def test_an_epoch_that_goes_back_admits_nothing_until_one_above_all_that_were_seen(admission: Admission) -> None:
    assert str(admission.follow(EPOCH - 2, EPOCH, NOW)) == "internal error: supervisor: epoch 2 while 4 was in force"
    for epoch, verdict in ((EPOCH - 2, DROP), (EPOCH, DROP), (EPOCH + 1, ADMIT)):
        assert decided(admission, (FRAME, epoch, NOW), epoch=epoch) == verdict
