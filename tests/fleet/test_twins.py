"""Other publishers of a robot's name, by what the topic of its connection says."""

from __future__ import annotations

import itertools
import json
import random
from collections.abc import Sequence

import pytest

from failstop.fleet import message
from failstop.fleet.twins import MOST, NOTHING, NUMBER, Twins, connection_of, draw, number_of

OWN, OTHER, EARLIER = "a" * 16, "b" * 16, "c" * 16
START_S = 1_700_000_000.0


def published(word: str, number: str, after_s: float = 1.0, heard: Sequence[str] = ()) -> bytes:
    """Of the publisher with that number, dated so long after this one's start."""
    header = message.Header("m", "r1", number)
    return header.message("connection", message.connection(word, heard=heard), START_S + after_s)


@pytest.fixture
def twins() -> Twins:
    """Connected: what the broker had kept is of an earlier publisher, and it has passed on this one's own message."""
    made = Twins(OWN, START_S)
    made.connected()
    made.hear(published(message.ONLINE, EARLIER, -5.0), retained=True)
    assert made.again, "to name the earlier one, which may still run"
    made.again = False
    made.hear(published(message.ONLINE, OWN), retained=False)
    assert (made.others, made.again, made.heard()) == (set(), False, [EARLIER])
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


class Shared:
    """A broker with one topic, which tells nobody apart: what it passes on waits at each publisher."""

    def __init__(self) -> None:
        self.kept = b""
        self.joined: list[One] = []

    def publish(self, payload: bytes) -> None:
        self.kept = payload
        for each in self.joined:
            each.waiting.append((payload, False))


class One:
    """A publisher at it, whose clock is off by so much."""

    def __init__(self, broker: Shared, number: str, off_s: float) -> None:
        self.number, self._off_s, self._broker = number, off_s, broker
        self.twins = Twins(number, START_S + off_s)
        self.waiting: list[tuple[bytes, bool]] = []

    def connect(self) -> None:
        """Its subscription comes before its own message."""
        self.twins.connected()
        self._broker.joined.append(self)
        if self._broker.kept:
            self.waiting.append((self._broker.kept, True))
        self.say()

    def say(self, word: str = message.ONLINE) -> None:
        self._broker.publish(published(word, self.number, self._off_s, self.twins.heard()))

    def turn(self, draw: random.Random) -> None:
        """What has come is heard in any order."""
        came, self.waiting = self.waiting, []
        for payload, retained in draw.sample(came, len(came)):
            self.twins.hear(payload, retained=retained)
        if self.twins.again:
            self.twins.again = False
            self.say()


SEEDS = [range(first, first + 100) for first in range(0, 300, 100)]
OFF_S = (-3600.0, 0.0, 3600.0)


@pytest.mark.parametrize("seeds", SEEDS, ids=str)
def test_two_learn_of_each_other_and_then_are_quiet(seeds: range) -> None:
    """Whatever their clocks show, and in whatever order their messages are heard."""
    for seed in seeds:
        draw = random.Random(seed)
        broker = Shared()
        both = [One(broker, number, draw.choice(OFF_S)) for number in (OWN, OTHER)]
        for each in both:
            each.connect()
            for _ in range(draw.randrange(3)):
                draw.choice(both).turn(draw)
        for turn in itertools.count():
            assert turn < 40, f"seed {seed}: they go on and on"
            draw.choice(both).turn(draw)
            if not any(each.waiting for each in both):
                break
        assert [each.twins.others for each in both] == [{OTHER}, {OWN}], f"seed {seed}"


@pytest.mark.parametrize("seeds", SEEDS, ids=str)
def test_publishers_that_follow_each_other_are_no_twins(seeds: range) -> None:
    """However the earlier ones ended, whenever their last wills come, and whatever the clock does between them."""
    for seed in seeds:
        draw = random.Random(seed)
        broker = Shared()
        late: list[One] = []
        for number in "abcd":
            one = One(broker, number * 16, draw.choice(OFF_S))
            one.connect()
            for _ in range(draw.randrange(4)):
                one.turn(draw)
                if late and draw.random() < 0.5:
                    late.pop(0).say(message.LOST)
                if draw.random() < 0.2:  # its connection breaks, and is there again
                    broker.joined.remove(one)
                    one.connect()
            one.turn(draw)
            assert one.twins.others == set(), f"seed {seed}"
            broker.joined.remove(one)
            if draw.random() < 0.5:
                one.say(message.OFFLINE)
            else:  # it loses its power, which the broker learns later
                late.append(one)


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
    twins.connected()
    twins.hear(published(word, OTHER, 9.0), retained=True)
    assert twins.others == {OTHER}


@pytest.mark.parametrize("after_s", [-60.0, 1e8])
def test_a_broker_that_comes_back_with_an_old_copy_makes_no_twin(after_s: float) -> None:
    """Whatever its date: the clock of a robot may be years behind when it starts."""
    twins = Twins(OWN, START_S)
    old = published(message.ONLINE, EARLIER, after_s)
    for _ in range(2):
        twins.connected()
        twins.hear(old, retained=True)
    assert twins.others == set()


@pytest.mark.parametrize("after_s", [-60.0, 4e-4, 1e8])
@pytest.mark.parametrize("word", [message.ONLINE, message.LOST, message.OFFLINE])
def test_what_the_broker_had_kept_makes_no_twin_in_whatever_order_it_is_heard(word: str, after_s: float) -> None:
    """A robot hears the newest of what has come at once first: its own message before the one that was kept. Dates are
    rounded, so the end of a publisher can be dated after the start of the next one."""
    twins = Twins(OWN, START_S)
    twins.connected()
    twins.hear(published(message.ONLINE, OWN), retained=False)
    twins.hear(published(word, EARLIER, after_s), retained=True)
    assert twins.others == set()


def test_a_message_that_was_on_its_way_when_its_publisher_died_makes_no_twin() -> None:
    """The network may deliver it after the next publisher has subscribed."""
    twins = Twins(OWN, START_S)
    twins.connected()
    twins.hear(published(message.ONLINE, EARLIER, -5.0), retained=False)
    assert (twins.others, twins.again, twins.heard()) == (set(), True, [EARLIER])


def test_a_last_will_of_the_publisher_before_the_last_one_makes_no_twin() -> None:
    """It comes while this one is not connected, and the clock was ahead then."""
    twins = Twins(OWN, START_S)
    twins.connected()
    twins.hear(published(message.ONLINE, EARLIER, -5.0, [OTHER]), retained=True)
    twins.connected()
    twins.hear(published(message.LOST, OTHER, 60.0), retained=True)
    assert twins.others == set()


@pytest.mark.parametrize("retained", [False, True])
@pytest.mark.parametrize("word", [message.ONLINE, message.LOST, message.OFFLINE])
def test_whoever_names_this_publisher_runs_alongside_it(word: str, retained: bool) -> None:
    """Even if its clock is years behind."""
    twins = Twins(OWN, START_S)
    twins.connected()
    twins.hear(published(word, OTHER, -1e8, [EARLIER, OWN]), retained=retained)
    assert twins.others == {OTHER}


def test_a_twin_whose_message_was_kept_is_known_by_its_next_one(twins: Twins) -> None:
    """Also if it hangs before it names this publisher: it is compared with its own clock."""
    twins.connected()
    twins.hear(published(message.LOST, EARLIER, -5.0), retained=True)
    assert twins.others == set()
    twins.hear(published(message.LOST, EARLIER, 9.0), retained=True)
    assert twins.others == {EARLIER}


def test_a_flood_of_numbers_fills_no_memory_and_is_answered_no_more() -> None:
    twins = Twins(OWN, START_S)
    twins.connected()
    for number in range(MOST):
        twins.hear(published(message.ONLINE, f"{number:016x}"), retained=False)
    twins.again = False
    twins.hear(published(message.ONLINE, OTHER), retained=False)
    assert (len(twins.others), len(twins.heard()), twins.again) == (MOST, MOST, False)


@pytest.mark.parametrize("payload", [b"", b"nonsense", b"[]", b'{"connection": ""}', published("offline", OWN)])
def test_a_connection_that_somebody_took_away_or_spoiled_is_said_again(twins: Twins, payload: bytes) -> None:
    twins.hear(payload, retained=False)
    assert (twins.others, twins.again) == (set(), True)


@pytest.mark.parametrize("payload", [b"\xff", b"3", b"null", b'"x"', b"[" * 100_000, b'{"connection": {}}'])
def test_nonsense_is_no_connection(payload: bytes) -> None:
    assert connection_of(payload) == NOTHING


@pytest.mark.parametrize("heard", [7, "a" * 16, {}, [None, 7, "a", ["b"]], ["c" * 15] * 1000])
def test_a_list_of_numbers_that_is_none(heard: object) -> None:
    assert connection_of(json.dumps({"connection": "online", "heard": heard}).encode()).heard == ()
