"""Admission, the whole table: which row decides, its boundaries, and what is dropped, written, or a stop."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from failstop.board.kinds import board_of
from failstop.board.rrc import codec
from failstop.board.rrc.board import BOARD
from failstop.board.rrc.burst import BURST
from failstop.board.servos import POSITION
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.procs.loop import NEVER
from failstop.procs.port_owner.admission import ADMIT, DROP, STAND_STILL, STOP_ASKED, Admission, BusSchedule, DatedFrame
from tests.support import frames

MS = 1_000_000
LEASE_NS = 60 * MS
NOW = 9_000 * MS
MAX_RPS = 2.0
FRAME = codec.motor_speeds((0.8, 0.8, -0.8, -0.8), MAX_RPS)
TOO_FAST = codec.motor_speeds((0.0, 0.0, 0.0, 2.5), 3.0)
EPOCH = 4


def decided(
    motion: DatedFrame = (FRAME, EPOCH, NOW),
    admission: Admission | None = None,
    *,
    epoch: int = EPOCH,
    gate_ns: int | None = NOW,
    supervisor_ns: int = NOW,
    requested: bool = False,
) -> int | Cause:
    by = admission or Admission(BOARD, LEASE_NS, MAX_RPS)
    return by.decide(motion, epoch, NOW, gate_ns, supervisor_ns, by, requested=requested)


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
            (frame, EPOCH - (DEAD_EPOCH in failing), NOW - LEASE_NS * (OLD in failing)),
            admission,
            gate_ns=None if GATE in failing else NOW - LEASE_NS * (GATE_LEASE in failing),
            supervisor_ns=NOW - (LEASE_NS + MS) * (SUPERVISOR_LEASE in failing),
            requested=ASKED in failing,
        )
        expected = ADMIT if first is None or (first == CONTENT and kind != "motion") else ELSE[first]
        assert found == (STAND_STILL if expected == DROP and kind == "zero" else expected), failing


@pytest.mark.parametrize("silent_ns", [-MS, 0, LEASE_NS - 1, LEASE_NS, NOW])
def test_a_lease_runs_out_exactly_then(silent_ns: int) -> None:
    beat_ns, lapsed = NOW - silent_ns, silent_ns >= LEASE_NS
    admission = Admission(BOARD, LEASE_NS, MAX_RPS)
    for process, found in (("gate", decided(gate_ns=beat_ns)), ("supervisor", decided(supervisor_ns=beat_ns))):
        assert found == (causes.HANGS(process, silent_ns // MS) if lapsed else ADMIT)
    assert bool(admission.lapsed(beat_ns, NOW, NOW)) is lapsed
    assert (admission.lapses_ns(beat_ns, NOW) <= NOW) is (admission.lapses_ns(NOW, beat_ns) <= NOW) is lapsed
    assert decided((FRAME, EPOCH, beat_ns)) == (DROP if lapsed else ADMIT), "a frame must be younger"


@pytest.mark.parametrize(
    ("frame", "fault"),
    [
        *((frame, "not a motor frame") for frame in (b"", BURST, frames.motor_one(0, 0.5))),
        (FRAME[:-1] + bytes((FRAME[-1] ^ 1,)), "bad crc"),
        (codec.motor_speeds((-2.01, 0.0, 0.0, 0.0), 3.0), "wheel 0 at -2.01 rps, limit 2.00"),
        (codec.STOP, ADMIT),
        (codec.motor_speeds((MAX_RPS, -MAX_RPS, MAX_RPS, -MAX_RPS), MAX_RPS), ADMIT),
    ],
)
def test_a_frame_s_content_is_the_board_s_to_judge(frame: bytes, fault: int | str) -> None:
    expected = causes.BAD_FRAME(fault) if isinstance(fault, str) else fault
    assert decided((frame, EPOCH, NOW)) == expected


@pytest.mark.parametrize("answer", [None, False, 0, b"", (), True, "it is too fast"])
def test_a_frame_passes_only_where_the_board_s_check_says_nothing(answer: object) -> None:
    """A check that forgets to return anything returns None."""

    class Careless(type(BOARD)):  # type: ignore[misc]
        __slots__ = ()

        def check_motion(self, *_: object) -> object:
            return answer

    class CarelessArm(type(BOARD.arm)):  # type: ignore[misc]
        __slots__ = ()

        def check(self, *_: object) -> object:
            return answer

    board = Careless.__new__(Careless)
    said = answer if isinstance(answer, str) else f"its check returned {answer!r}, not a text"
    assert Admission(board, LEASE_NS, MAX_RPS).check(FRAME) == causes.BAD_FRAME(said)
    assert BusSchedule(CarelessArm(), (1,)).check(FRAME) == causes.BAD_FRAME(f"for the arm, {said}")


@pytest.mark.claim("MOVE-1")
@given(st.lists(st.integers(0, 5)), st.integers(0, 5), st.integers(0, 5))
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
    assert decided((FRAME, frame_epoch, NOW), admission, epoch=epoch) == (ADMIT if admitted else DROP)


def test_a_zero_frame_of_a_dead_epoch_is_dropped_before_anything_was_written() -> None:
    """The wheels stand."""
    assert decided((codec.STOP, EPOCH - 1, NOW)) == DROP


def test_an_arm_beside_the_wheels_is_asked_while_servos_and_wheels_move() -> None:
    arm = board_of("feetech", 0.1, 0.0).arm
    assert arm
    bus, move = BusSchedule(arm, (1,)), arm.move([(1, 2048)], 20)
    assert bus.wrote(move, NOW)
    free_ns = NOW + arm.held_ns(move)
    assert bus.due_ns(arm.read(1, POSITION), free_ns, wheels_move=True) == free_ns


def test_a_board_without_an_arm_has_no_frame_for_one() -> None:
    bus = BusSchedule(None, (1,))
    assert bus.check(FRAME) == causes.BAD_FRAME("for the arm, this robot has no arm")
    assert bus.due_ns(FRAME, NOW, wheels_move=False) == NEVER
    assert not bus.wrote(FRAME, NOW)


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
def test_an_invariant_that_does_not_hold_is_a_stop(
    latched_in: int, frame_ns: int, alone: bool, broken: str | None
) -> None:
    """Of a frame that was admitted after a stop of the port owner's own at NOW."""
    admission = Admission(BOARD, LEASE_NS, MAX_RPS)
    admission.stopped(EPOCH - 1, NOW)
    found = admission.impossible(frame_ns, EPOCH, latched_in, alone=alone)
    assert (found and str(found)) == (broken and f"internal error: {broken}")


def test_an_epoch_that_goes_back_admits_nothing_until_one_above_all_that_were_seen() -> None:
    admission = Admission(BOARD, LEASE_NS, MAX_RPS)
    assert admission.follow(EPOCH, EPOCH - 1) is None
    assert str(admission.follow(EPOCH - 2, EPOCH)) == "internal error: supervisor: epoch 2 while 4 was in force"
    for epoch, verdict in ((EPOCH - 2, DROP), (EPOCH, DROP), (EPOCH + 1, ADMIT)):
        assert decided((FRAME, epoch, NOW), admission, epoch=epoch) == verdict
