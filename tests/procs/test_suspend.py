"""A machine that slept is noticed by the clock that went on; being held up is no sleep."""

from __future__ import annotations

from collections.abc import Iterator

from failstop.procs.world import SLEPT_NS, SuspendWatch, World, gained_ns

MS = 1_000_000


def watch(readings: list[int]) -> SuspendWatch:
    """The first reading is taken three times."""
    found: Iterator[int] = iter([readings[0], readings[0], *readings])
    return SuspendWatch(lambda: next(found))


def test_a_sleep_is_told_once_with_its_length() -> None:
    watched = watch([7, 7, 7 + 3000 * MS, 7 + 3000 * MS])
    assert [watched.slept_ns() for _ in range(3)] == [0, 3000 * MS, 0]


def test_two_sleeps_are_two() -> None:
    watched = watch([0, 60 * MS, 120 * MS])
    assert [watched.slept_ns() for _ in range(2)] == [60 * MS, 60 * MS]


def test_jitter_is_no_sleep() -> None:
    watched = watch([0, 3 * MS, 0, SLEPT_NS - 1])
    assert [watched.slept_ns() for _ in range(3)] == [0, 0, 0]


def test_a_start_that_was_held_up_does_not_look_like_a_sleep_for_ever() -> None:
    watched = watch([-40 * MS, 0, 0, 0])
    assert [watched.slept_ns() for _ in range(3)] == [0, 0, 0]


def test_being_held_up_between_the_clocks_makes_the_reading_smaller() -> None:
    times = iter([1000, 1000 + 900 * MS])
    assert gained_ns(lambda: next(times), lambda _clock: 1000) == -900 * MS


def test_this_machine_does_not_sleep_now() -> None:
    watched = SuspendWatch(World().gained_ns)
    assert [watched.slept_ns() for _ in range(1000)] == [0] * 1000
