"""Other publishers of a robot's name, by what the topic of its connection says."""

from __future__ import annotations

import itertools

import pytest

from failstop.fleet import message
from failstop.fleet.twins import NUMBER, Twins, connection_of, draw, number_of

OWN, OTHER, EARLIER = "a" * 16, "b" * 16, "c" * 16
START_S = 1_700_000_000.0


def published(word: str, number: str, after_s: float = 1.0) -> bytes:
    """Of the publisher with that number, dated so long after this one's start."""
    header = message.Header("m", "r1", number)
    return header.message("connection", message.connection(word), START_S + after_s)


@pytest.fixture
def twins() -> Twins:
    """Connected: what the broker had kept is of an earlier publisher, and it has passed on this one's own message."""
    made = Twins(OWN, START_S)
    made.hear(published(message.ONLINE, EARLIER, -5.0), retained=True)
    made.hear(published(message.ONLINE, OWN), retained=False)
    assert (made.others, made.again) == (set(), False)
    return made


def test_numbers_are_drawn() -> None:
    drawn = {draw() for _ in range(1000)}
    assert len(drawn) == 1000
    assert all(NUMBER.fullmatch(number) and number_of(number) == number for number in drawn)


@pytest.mark.parametrize("found", [None, 7, "", "A" * 16, "a" * 15, "a" * 17, f"{'a' * 16}\n", ["a" * 16], {}])
def test_a_number_that_is_none(found: object) -> None:
    assert number_of(found) == ""


def test_a_twin_that_connects_is_answered_once(twins: Twins) -> None:
    twins.hear(published(message.ONLINE, OTHER), retained=False)
    assert (twins.others, twins.again) == ({OTHER}, True)
    twins.again = False
    twins.hear(published(message.ONLINE, OTHER), retained=False)
    assert not twins.again, "or both would go on for ever"


def test_two_learn_of_each_other_and_then_are_quiet() -> None:
    both = {OWN: Twins(OWN, START_S), OTHER: Twins(OTHER, START_S + 5.0)}
    said, kept = [OWN], None
    for turn in itertools.count():
        assert turn < 20, "they go on and on"
        if not said:
            break
        number = said.pop(0)
        kept = published(message.ONLINE, number, 5.0)
        for own, twins in both.items():
            twins.hear(kept, retained=False)
            if twins.again:
                twins.again = False
                said.append(own)
    assert [twins.others for twins in both.values()] == [{OTHER}, {OWN}]


def test_a_publisher_of_an_older_failstop_is_one_too(twins: Twins) -> None:
    twins.hear(published(message.ONLINE, ""), retained=False)
    assert twins.others == {""}


@pytest.mark.parametrize("word", [message.LOST, message.OFFLINE])
def test_the_end_of_an_earlier_publisher_is_put_right_and_is_no_twin(twins: Twins, word: str) -> None:
    twins.hear(published(word, EARLIER, -5.0), retained=False)
    assert (twins.others, twins.again) == (set(), True)


@pytest.mark.parametrize("word", [message.LOST, message.OFFLINE])
def test_a_twin_that_has_gone_is_remembered(twins: Twins, word: str) -> None:
    twins.hear(published(message.ONLINE, OTHER), retained=False)
    twins.hear(published(word, OTHER), retained=False)
    assert twins.others == {OTHER}


@pytest.mark.parametrize("word", [message.ONLINE, message.LOST, message.OFFLINE])
def test_a_twin_that_takes_turns_is_known_by_what_it_left(twins: Twins, word: str) -> None:
    """The broker keeps a message that was made after this publisher's start, and not by it."""
    twins.hear(published(word, OTHER, 9.0), retained=True)
    assert twins.others == {OTHER}


def test_a_broker_that_comes_back_with_an_old_copy_makes_no_twin(twins: Twins) -> None:
    twins.hear(published(message.ONLINE, EARLIER, -60.0), retained=True)
    assert twins.others == set()


def test_what_was_kept_before_the_first_message_of_ones_own_makes_no_twin() -> None:
    """Whatever its date: the clock of a robot may be years behind when it starts."""
    twins = Twins(OWN, START_S)
    twins.hear(published(message.ONLINE, EARLIER, 1e8), retained=True)
    assert (twins.others, twins.again) == (set(), False)


@pytest.mark.parametrize("payload", [b"", b"nonsense", b"[]", b'{"connection": ""}', published("offline", OWN)])
def test_a_connection_that_somebody_took_away_or_spoiled_is_said_again(twins: Twins, payload: bytes) -> None:
    twins.hear(payload, retained=False)
    assert (twins.others, twins.again) == (set(), True)


@pytest.mark.parametrize("payload", [b"\xff", b"3", b"null", b'"x"', b"[" * 100_000, b'{"connection": {}}'])
def test_nonsense_is_no_connection(payload: bytes) -> None:
    assert connection_of(payload) == ("", "", None)
