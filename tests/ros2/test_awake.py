"""How long a request may have waited because the bridge did not run, and whether it is still carried out."""

from __future__ import annotations

import pytest

from failstop.api.errors import Refused
from failstop.ros2.awake import Awake

MS = 1_000_000


class Clock:
    """A clock that the test sets."""

    def __init__(self) -> None:
        self.now_ns = 0

    def __call__(self) -> int:
        return self.now_ns

    def pass_ms(self, ms: int) -> None:
        self.now_ns += ms * MS


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def awake(clock: Clock) -> Awake:
    return Awake(clock)


def test_without_a_pause_nothing_has_waited(awake: Awake, clock: Clock) -> None:
    for _ in range(100):
        clock.pass_ms(50)
        assert awake.waited_ns() == 0
        assert awake.waited_ns(20 * MS) == 20 * MS
        awake.check_request()


def test_what_is_handled_right_after_a_pause_may_be_as_old_as_the_pause(awake: Awake, clock: Clock) -> None:
    clock.pass_ms(8000)
    for _ in range(9):
        assert awake.waited_ns() == 8000 * MS
        with pytest.raises(Refused, match=r"it may have waited for 8\.000 s, .*: ask again"):
            awake.check_request()
        clock.pass_ms(10)
    assert awake.waited_ns(50 * MS) == 8000 * MS, "it arrived during the pause"
    clock.pass_ms(20)
    assert awake.waited_ns() == 0
    awake.check_request()


def test_a_short_pause_refuses_no_request(awake: Awake, clock: Clock) -> None:
    clock.pass_ms(400)
    assert awake.waited_ns() == 400 * MS
    awake.check_request()


def test_a_second_short_pause_hides_no_long_one(awake: Awake, clock: Clock) -> None:
    clock.pass_ms(8000)
    assert awake.waited_ns() == 8000 * MS
    clock.pass_ms(150)
    assert awake.waited_ns() == 8000 * MS
    clock.pass_ms(90)
    assert awake.waited_ns() == 8000 * MS
    clock.pass_ms(60)
    assert awake.waited_ns() == 0
    clock.pass_ms(150)
    assert awake.waited_ns() == 150 * MS
