"""The schedule of repeated stops: bursts after 20 and 100 ms, zero frames at 5 Hz while nothing moves."""

from __future__ import annotations

import pytest

from failstop.procs.loop import NEVER, Timer
from failstop.procs.port_owner.schedule import BURST, ZERO, Repeats

MS = 1_000_000
T0 = 5_000 * MS


class Schedule(Repeats):
    """With its deadline in sight."""

    def __init__(self) -> None:
        self.next = Timer()
        super().__init__(self.next, T0)


def written(repeats: Repeats, start_ms: int, end_ms: int) -> list[tuple[int, int]]:
    """What comes due from start to end, asked every millisecond: (ms, what)."""
    times = range(start_ms, end_ms)
    return [(ms, what) for ms in times if (what := repeats.take(T0 + ms * MS))]


@pytest.fixture
def repeats() -> Schedule:
    made = Schedule()
    made.restart(T0)
    return made


def test_after_a_stop(repeats: Schedule) -> None:
    assert written(repeats, 0, 850) == [(20, BURST), (100, BURST), (200, ZERO), (400, ZERO), (600, ZERO), (800, ZERO)]


def test_before_any_stop_zero_frames_go_out() -> None:
    assert written(Schedule(), 0, 450) == [(0, ZERO), (200, ZERO), (400, ZERO)]


def test_due_exactly_then_and_once(repeats: Schedule) -> None:
    assert repeats.take(T0 + 20 * MS - 1) == 0
    assert repeats.take(T0 + 20 * MS) == BURST
    assert repeats.take(T0 + 20 * MS) == 0


def test_a_new_stop_begins_the_schedule_anew(repeats: Schedule) -> None:
    assert written(repeats, 0, 60) == [(20, BURST)]
    repeats.restart(T0 + 60 * MS)
    assert written(repeats, 60, 300) == [(80, BURST), (160, BURST), (260, ZERO)]


def test_motion_ends_the_repeats(repeats: Schedule) -> None:
    assert written(repeats, 0, 30) == [(20, BURST)]
    repeats.motion()
    assert written(repeats, 30, 2_000) == []
    assert repeats.next.ns == NEVER


def test_no_repeat_cuts_into_motion_even_when_it_was_overdue(repeats: Schedule) -> None:
    repeats.motion()
    assert repeats.take(T0 + 5_000 * MS) == 0
    repeats.restart(T0 + 5_000 * MS)
    assert written(repeats, 5_000, 5_250) == [(5_020, BURST), (5_100, BURST), (5_200, ZERO)]


def test_overdue_bursts_are_each_written(repeats: Schedule) -> None:
    late = T0 + 1_000 * MS
    assert [repeats.take(late) for _ in range(4)] == [BURST, BURST, ZERO, 0]


def test_waking_at_the_deadline_is_enough(repeats: Schedule) -> None:
    found: list[tuple[int, int]] = []
    now_ns = T0
    while len(found) < 5:
        assert repeats.next.ns > now_ns, "a wake-up that is over already would spin"
        now_ns = repeats.next.ns
        found.append(((now_ns - T0) // MS, repeats.take(now_ns)))
    assert found == [(20, BURST), (100, BURST), (200, ZERO), (400, ZERO), (600, ZERO)]
