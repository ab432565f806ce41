"""The schedule of repeated stops: bursts after 20 and 100 ms, zero frames at 5 Hz while nothing moves."""

from __future__ import annotations

from failstop.procs.port_owner.repeats import BURST, ZERO, Repeats

MS = 1_000_000
T0 = 5_000 * MS


def written(repeats: Repeats, start_ms: int, end_ms: int, *, moving: bool = False) -> list[tuple[int, int]]:
    """What comes due from start to end, asked every millisecond: (ms, what)."""
    times = range(start_ms, end_ms)
    return [(ms, what) for ms in times if (what := repeats.due(T0 + ms * MS, moving=moving))]


def test_after_a_stop() -> None:
    repeats = Repeats(T0)
    repeats.restart(T0)
    assert written(repeats, 0, 850) == [(20, BURST), (100, BURST), (200, ZERO), (400, ZERO), (600, ZERO), (800, ZERO)]


def test_before_any_stop_zero_frames_go_out() -> None:
    assert written(Repeats(T0), 0, 450) == [(0, ZERO), (200, ZERO), (400, ZERO)]


def test_due_exactly_then_and_once() -> None:
    repeats = Repeats(T0)
    repeats.restart(T0)
    assert repeats.due(T0 + 20 * MS - 1, moving=False) == 0
    assert repeats.due(T0 + 20 * MS, moving=False) == BURST
    assert repeats.due(T0 + 20 * MS, moving=False) == 0


def test_what_comes_next_while_something_moves_and_while_nothing_does() -> None:
    repeats = Repeats(T0)
    assert repeats.next_ns(moving=True) is None
    assert repeats.next_ns(moving=False) == T0
    repeats.restart(T0)
    assert repeats.next_ns(moving=True) == repeats.next_ns(moving=False) == T0 + 20 * MS
    repeats.motion()
    assert repeats.next_ns(moving=True) is None
    assert repeats.next_ns(moving=False) == T0 + 200 * MS


def test_a_new_stop_begins_the_schedule_anew() -> None:
    repeats = Repeats(T0)
    repeats.restart(T0)
    assert written(repeats, 0, 60) == [(20, BURST)]
    repeats.restart(T0 + 60 * MS)
    assert written(repeats, 60, 300) == [(80, BURST), (160, BURST), (260, ZERO)]


def test_motion_ends_the_repeats() -> None:
    repeats = Repeats(T0)
    repeats.restart(T0)
    assert written(repeats, 0, 30) == [(20, BURST)]
    repeats.motion()
    assert written(repeats, 30, 2_000, moving=True) == []


def test_no_repeat_cuts_into_motion_even_when_it_was_overdue() -> None:
    repeats = Repeats(T0)
    repeats.restart(T0)
    repeats.motion()
    assert repeats.due(T0 + 5_000 * MS, moving=True) == 0
    repeats.restart(T0 + 5_000 * MS)
    assert written(repeats, 5_000, 5_250) == [(5_020, BURST), (5_100, BURST), (5_200, ZERO)]


def test_overdue_bursts_are_each_written() -> None:
    repeats = Repeats(T0)
    repeats.restart(T0)
    late = T0 + 1_000 * MS
    assert [repeats.due(late, moving=False) for _ in range(4)] == [BURST, BURST, ZERO, 0]


def test_waking_at_what_next_says_is_enough() -> None:
    repeats = Repeats(T0)
    repeats.restart(T0)
    found: list[tuple[int, int]] = []
    now_ns = T0
    while len(found) < 5:
        next_ns = repeats.next_ns(moving=False)
        assert next_ns is not None
        assert next_ns > now_ns, "a wake-up that is over already would spin"
        now_ns = next_ns
        found.append(((now_ns - T0) // MS, repeats.due(now_ns, moving=False)))
    assert found == [(20, BURST), (100, BURST), (200, ZERO), (400, ZERO), (600, ZERO)]


def test_nothing_to_wake_up_for_while_moving() -> None:
    repeats = Repeats(T0)
    repeats.restart(T0)
    repeats.motion()
    assert repeats.next_ns(moving=True) is None
