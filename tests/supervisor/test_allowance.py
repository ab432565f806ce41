"""The log is bounded, whoever writes: a flood is a few lines and a number, and takes nobody else's room."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.procs.world import World
from failstop.supervisor.events import ASKED_BYTES, MINUTE_NS, MOST_WAITING, OWN_BYTES, Events
from tests.supervisor.streams import stderr_is

T0 = 10**15
S = 10**9


class Times:
    """Both clocks, as the events see them."""

    def __init__(self) -> None:
        self.now_ns = T0

    def monotonic_ns(self) -> int:
        return self.now_ns

    def time(self) -> float:
        return self.now_ns / 1e9


class Log:
    """Events whose lines are read back."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.times = Times()
        world = World(now_ns=lambda: self.times.now_ns, unix_s=lambda: self.times.now_ns / 1e9)
        self.events = Events(world, "x")
        self._out, self._into = os.pipe()
        os.set_blocking(self._out, False)

    def flush(self, *, end: bool = False) -> list[str]:
        """A turn's end; returns the lines that it brought."""
        with stderr_is(self._into):
            self.events.flush(0 if end else self.times.now_ns)
        try:
            return os.read(self._out, 1 << 20).decode().splitlines()
        except BlockingIOError:
            return []

    def request(self, number: int, kind: str = "stop_again") -> None:
        reason = f"stop request: {number:0100}"
        fields = {"reason": reason, "cause": "piped", "latched": "key1"}
        self.events.tell(kind, f"stopped again: {reason}; latched is still: key1", fields)

    def close(self) -> None:
        os.close(self._out)
        os.close(self._into)


@pytest.fixture
def log(monkeypatch: pytest.MonkeyPatch) -> Iterator[Log]:
    made = Log(monkeypatch)
    yield made
    made.close()


def left_out(lines: list[str]) -> int:
    return sum(int(found[1]) for line in lines if (found := re.match(r"failstop: (\d+) .* left out", line)))


def test_requests_without_end_are_bounded_and_counted_and_take_nobody_s_room(log: Log) -> None:
    minutes: list[int] = []
    lines: list[str] = []
    asked = 0
    for _minute in range(4):
        said = []
        for tick in range(60 * 50):
            log.times.now_ns += S // 50
            log.request(asked, "stop_again" if tick % 2 else "stop_also")
            asked += 1
            if tick % 1000 == 999:
                log.events.tell("stop_again", "stopped again: gate died", {"reason": "gate died", "latched": "key1"})
                log.events.tell("stop", "STOP latched: stop request: x", {"reason": "stop request: x"})
            if tick % 20 == 19:
                said += log.flush()
        minutes.append(sum(len(line) + 1 for line in said))
        lines += said
    said = log.flush(end=True)
    lines += said
    own = 3 * sum(len(f"failstop: {text}\n") for text in ("stopped again: gate died", "STOP latched: stop request: x"))
    told_of = 2 * 4 * 120
    room = 2 * ASKED_BYTES
    assert all(room - told_of < told <= room + own + told_of for told in minutes), minutes
    assert sum(line == "failstop: stopped again: gate died" for line in lines) == 4 * 3
    assert sum(line == "failstop: STOP latched: stop request: x" for line in lines) == 4 * 3
    told = sum("stop request: 0" in line for line in lines)
    assert told + left_out(lines) == asked, "each one is told or counted"
    assert left_out(said) > 0, "at the end too"


def test_the_number_comes_when_the_flood_has_ended(log: Log) -> None:
    told = 0
    for number in range(200):
        log.request(number)
        told += len(log.flush())
    log.times.now_ns += MINUTE_NS - 1
    assert log.flush() == []
    log.times.now_ns += 1
    assert log.flush() + log.flush() == [
        f"failstop: {200 - told} stop requests while a stop was latched were left out: too many to tell of each"
    ]
    log.request(1000)
    assert len(log.flush()) == 1, "and the next is told again"


@pytest.mark.parametrize("kind", ["stop", "refused", "note", "link"])
def test_every_kind_is_bounded(log: Log, kind: str) -> None:
    size = 0
    for number in range(2000):
        log.events.tell(kind, f"{number:0190}")
        size += sum(map(len, log.flush()))
    assert OWN_BYTES - 400 < size <= OWN_BYTES
    (line,) = log.flush(end=True)
    assert (
        line == f"failstop: {2000 - OWN_BYTES // 201} events of the kind {kind} were left out: too many to tell of each"
    )


def test_what_is_critical_has_room_of_its_own(log: Log) -> None:
    for number in range(1000):
        log.events.tell("stop", f"{number:0190}")
        log.flush()
    log.events.tell("stop", "stop frame NOT written", level="critical")
    assert log.flush() == ["failstop: stop frame NOT written"]


def test_what_comes_at_one_time_is_bounded_and_counted_too(log: Log) -> None:
    for number in range(MOST_WAITING + 7):
        log.events.tell("note", str(number))
    lines = log.flush(end=True)
    assert len(lines) == MOST_WAITING + 1
    assert left_out(lines) == 7


def test_once_it_is_spent_nothing_is_told_until_the_minute_is_over(log: Log) -> None:
    line = len("failstop: \n")
    log.events.tell("note", "x" * (OWN_BYTES - line))
    assert len(log.flush()) == 1, "all of it may be spent"
    log.times.now_ns += MINUTE_NS
    log.events.tell("note", "x" * (OWN_BYTES - line + 1))
    log.events.tell("note", "y")
    assert log.flush() == [], "not every other line of a flood"
    log.times.now_ns += MINUTE_NS
    log.events.tell("note", "y")
    assert log.flush() + log.flush() == [
        "failstop: y",
        "failstop: 2 events of the kind note were left out: too many to tell of each",
    ]


@given(spent=st.lists(st.tuples(st.integers(1, 3000), st.integers(0, 3 * 10**9)), max_size=200))
def test_in_no_minute_more_than_two_allowances(spent: list[tuple[int, int]]) -> None:
    times = Times()
    events = Events(World(now_ns=times.monotonic_ns), "x")
    sort = ("stop_again", "warning", True)
    told: list[tuple[int, int]] = []
    for size, elapsed_ns in spent:
        times.now_ns += elapsed_ns
        if events._may_spend(sort, size, times.now_ns):
            told.append((times.now_ns, size))
    for at_ns, _ in told:
        assert sum(size for t_ns, size in told if at_ns <= t_ns < at_ns + MINUTE_NS) <= 2 * ASKED_BYTES
