"""The proof that an operator's device is there: freshness, replay, backlog, forgery, and a clock that jumps."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.web.lease import COUNT, NONCE_BYTES, Lease, answer_to, key_of

MS = 1_000_000
KEY = key_of("a token")


def nonces(lease: Lease, count: int, since_ns: int = MS, every_ns: int = 100 * MS) -> list[str]:
    """Made one after another."""
    return [lease.ask((since_ns + n).to_bytes(NONCE_BYTES, "big"), since_ns + n * every_ns) for n in range(count)]


def right(nonce: str) -> tuple[str, str]:
    return nonce, answer_to(nonce, KEY)


def test_an_answer_proves_when_its_nonce_was_made() -> None:
    lease = Lease(KEY)
    _, second = nonces(lease, 2)
    assert lease.accept(*right(second))
    assert lease.proven_ns == 101 * MS


def test_only_the_newest_two_count_and_each_once() -> None:
    lease = Lease(KEY)
    made = nonces(lease, 4)
    assert [lease.accept(*right(nonce)) for nonce in made] == [False, False, True, True]
    assert not any(lease.accept(*right(nonce)) for nonce in made)


def test_a_backlog_of_five_seconds_renews_nothing() -> None:
    lease = Lease(KEY)
    held_back = nonces(lease, 50)
    fresh = nonces(lease, 2, since_ns=5000 * MS)
    assert not any(lease.accept(*right(nonce)) for nonce in held_back)
    assert lease.proven_ns == 0
    assert lease.accept(*right(fresh[1]))


def test_an_answer_that_comes_out_of_order_takes_nothing_back() -> None:
    lease = Lease(KEY)
    first, second = nonces(lease, 2)
    assert lease.accept(*right(second))
    assert not lease.accept(*right(first))
    assert lease.proven_ns == 101 * MS


@pytest.mark.parametrize("answer", ["", "00", answer_to("00" * NONCE_BYTES, b"another key"), "\udcff", "x" * 64])
def test_a_wrong_answer_proves_nothing_and_uses_nothing_up(answer: str) -> None:
    lease = Lease(KEY)
    (nonce,) = nonces(lease, 1)
    assert not lease.accept(nonce, answer)
    assert lease.accept(*right(nonce))


def test_an_answer_of_one_connection_is_none_of_another() -> None:
    one, other = Lease(KEY), Lease(KEY)
    nonce = one.ask(b"1" * NONCE_BYTES, MS)
    other.ask(b"2" * NONCE_BYTES, MS)
    assert not other.accept(*right(nonce))


def test_the_key_is_of_the_token_alone() -> None:
    assert key_of("a token") == KEY != key_of("another")
    assert b"a token" not in KEY


def test_a_command_is_proven_with_its_answer_and_no_other_is() -> None:
    lease = Lease(KEY)
    first, second = nonces(lease, 2)
    proof = answer_to(first + "0.50 0.00", KEY)
    for said in ("", "1.00 0.00", "0.50 0.00 ", "0.50 0.0"):
        assert not lease.accept(first, proof, said)
    assert not lease.accept(second, proof, "0.50 0.00"), "it is of one nonce"
    assert lease.accept(first, proof, "0.50 0.00")
    assert not lease.accept(first, proof, "0.50 0.00"), "it counts once"


def test_half_a_character_is_a_command_like_another() -> None:
    """JSON can hold one, and UTF-8 can't."""
    lease = Lease(KEY)
    (nonce,) = nonces(lease, 1)
    assert not lease.accept(nonce, answer_to(f"{nonce}?", KEY), "\ud800")
    assert lease.accept(nonce, answer_to(f"{nonce}\ud800", KEY), "\ud800")


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 5)), max_size=40))
def test_whatever_is_answered_it_proves_the_newest_nonce_that_still_counted(steps: list[tuple[bool, int]]) -> None:
    lease = Lease(KEY)
    made: list[tuple[str, int]] = []
    best = 0
    clock = itertools.count(1)
    for asks, back in steps:
        if asks:
            now_ns = next(clock) * MS
            made.append((lease.ask(now_ns.to_bytes(NONCE_BYTES, "big"), now_ns), now_ns))
        elif back < len(made):
            nonce, asked_ns = made[-1 - back]
            lease.accept(*right(nonce))
            if back < COUNT:
                best = max(best, asked_ns)
        assert lease.proven_ns == best
