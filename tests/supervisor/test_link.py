"""The link's proof: unproven, alive, deaf."""

from __future__ import annotations

from failstop.supervisor.stops import ALIVE, DEAF, UNPROVEN, Link

MS = 1_000_000
DEAF_NS = 1_000 * MS
T0 = 10_000 * MS


def heard(at_ns: int) -> Link:
    link = Link(DEAF_NS)
    link.answered(at_ns)
    return link


def deaf_after_ms(link: Link, pings_ms: list[int], until_ms: int = 5_000) -> int | None:
    """Look every 20 ms, from T0 on, with pings sent at these times; returns when it became deaf."""
    for ms in range(0, until_ms, 20):
        newest = max([T0 + at * MS for at in pings_ms if at <= ms], default=0)
        if link.silent(newest, T0 + ms * MS):
            return ms
    return None


def test_a_board_that_never_answers_is_unproven_and_no_cause() -> None:
    link = Link(DEAF_NS)
    assert link.state == UNPROVEN
    assert deaf_after_ms(link, list(range(0, 5_000, 500))) is None
    assert link.state == UNPROVEN


def test_a_board_that_has_answered_and_is_silent_for_a_second_is_deaf_once() -> None:
    link = heard(T0)
    assert deaf_after_ms(link, [0, 500, 1_000, 1_500]) == 1_020, "the ping at 1,000 may still be answered"
    assert link.state == DEAF
    assert deaf_after_ms(link, [2_000, 2_500]) is None, "once"


def test_a_board_that_answers_is_alive() -> None:
    link = heard(T0)
    for ms in range(0, 10_000, 500):
        assert not link.silent(T0 + ms * MS, T0 + ms * MS + 20 * MS)
        link.answered(T0 + ms * MS)
    assert link.state == ALIVE


def test_nobody_is_deaf_who_was_not_asked() -> None:
    """As when the port owner was held up: silence counts from the first question."""
    assert deaf_after_ms(heard(T0), [3_000]) == 3_500
    assert deaf_after_ms(heard(T0), [0, 3_000]) == 3_500, "it has answered the last one"


def test_nor_before_its_time_from_the_last_answer() -> None:
    assert deaf_after_ms(heard(T0), [0, 400]) == 1_000


def test_silence_while_nobody_listened_does_not_count() -> None:
    link = heard(T0)
    assert not link.silent(T0 + 500 * MS, T0 + 990 * MS)
    link.listen(T0 + 1_500 * MS)
    assert not link.silent(T0 + 1_500 * MS, T0 + 2_400 * MS), "nobody heard the answer to that one"
    assert not link.silent(T0 + 2_500 * MS, T0 + 2_510 * MS)
    assert link.silent(T0 + 2_500 * MS, T0 + 3_010 * MS)


def test_a_deaf_board_that_answers_again_is_alive() -> None:
    link = heard(T0)
    assert deaf_after_ms(link, [500, 1_000]) == 1_020
    link.answered(T0 + 1_500 * MS)
    assert link.state == ALIVE


def test_another_port_is_another_board() -> None:
    link = heard(T0)
    link.opened()
    assert link.state == UNPROVEN
    assert deaf_after_ms(link, list(range(0, 5_000, 500))) is None
