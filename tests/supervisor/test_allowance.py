"""The log is bounded, whoever writes: a flood is a few lines and a number, and takes nobody else's room."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.supervisor.events import MINUTE_NS, MOST_EVENTS_WAITING, OWN_BYTES, REPEATS_BYTES
from tests.support.supervisor_scene import Scene

S = 10**9


def flush(scene: Scene, *, end: bool = False) -> list[str]:
    """A turn's end; returns the lines that it brought."""
    scene.run.events.flush(0 if end else scene.now_ns)
    lines = [line.decode().removesuffix("\n") for line in scene.stderr.heard]
    scene.stderr.heard.clear()
    return lines


def request(scene: Scene, number: int, kind: str = "stop_again") -> None:
    reason = f"stop request: {number:0100}"
    fields = {"reason": reason, "cause": "piped", "latched": "key1"}
    scene.run.events.log(kind, f"stopped again: {reason}; the latched cause is still: key1", fields)


def left_out(lines: list[str]) -> int:
    return sum(int(found[1]) for line in lines if (found := re.match(r"failstop: (\d+) .* left out", line)))


def test_requests_without_end_are_bounded_and_counted_and_take_nobody_s_room(scene: Scene) -> None:
    minutes: list[int] = []
    lines: list[str] = []
    asked = 0
    for _minute in range(4):
        said = []
        for tick in range(60 * 50):
            scene.now_ns += S // 50
            request(scene, asked, "stop_again" if tick % 2 else "stop_also")
            asked += 1
            if tick % 1000 == 999:
                scene.run.events.log(
                    "stop_again", "stopped again: gate died", {"reason": "gate died", "latched": "key1"}
                )
                scene.run.events.log("stop", "STOP latched: stop request: x", {"reason": "stop request: x"})
            if tick % 20 == 19:
                said += flush(scene)
        minutes.append(sum(len(line) + 1 for line in said))
        lines += said
    said = flush(scene, end=True)
    lines += said
    own = 3 * sum(len(f"failstop: {text}\n") for text in ("stopped again: gate died", "STOP latched: stop request: x"))
    told_of = 2 * 4 * 120
    room = 2 * REPEATS_BYTES
    assert all(room - told_of < told <= room + own + told_of for told in minutes), minutes
    assert sum(line == "failstop: stopped again: gate died" for line in lines) == 4 * 3
    assert sum(line == "failstop: STOP latched: stop request: x" for line in lines) == 4 * 3
    told = sum("stop request: 0" in line for line in lines)
    assert told + left_out(lines) == asked, "each one is told or counted"
    assert left_out(said) > 0, "at the end too"


def test_the_number_comes_when_the_flood_has_ended(scene: Scene) -> None:
    told = 0
    for number in range(200):
        request(scene, number)
        told += len(flush(scene))
    scene.now_ns += MINUTE_NS - 1
    assert flush(scene) == []
    scene.now_ns += 1
    assert flush(scene) + flush(scene) == [
        f"failstop: {200 - told} stop requests while a stop was latched were left out: too many to log each one"
    ]
    request(scene, 1000)
    assert len(flush(scene)) == 1, "and the next is told again"


@pytest.mark.parametrize("kind", ["stop", "refused", "note", "link"])
def test_every_kind_is_bounded(scene: Scene, kind: str) -> None:
    size = 0
    for number in range(2000):
        scene.run.events.log(kind, f"{number:0190}")
        size += sum(map(len, flush(scene)))
    assert OWN_BYTES - 400 < size <= OWN_BYTES
    (line,) = flush(scene, end=True)
    assert (
        line == f"failstop: {2000 - OWN_BYTES // 201} events of the kind {kind} were left out: too many to log each one"
    )


def test_critical_events_have_room_of_their_own(scene: Scene) -> None:
    for number in range(1000):
        scene.run.events.log("stop", f"{number:0190}")
        flush(scene)
    scene.run.events.log("stop", "stop frame NOT written", level="critical")
    assert flush(scene) == ["failstop: stop frame NOT written"]


def test_events_that_come_at_one_time_are_bounded_and_counted_too(scene: Scene) -> None:
    for number in range(MOST_EVENTS_WAITING + 7):
        scene.run.events.log("note", str(number))
    lines = flush(scene, end=True)
    assert len(lines) == MOST_EVENTS_WAITING + 1
    assert left_out(lines) == 7


def test_a_spent_allowance_tells_nothing_until_the_minute_is_over(scene: Scene) -> None:
    line = len("failstop: \n")
    scene.run.events.log("note", "x" * (OWN_BYTES - line))
    assert len(flush(scene)) == 1, "all of it may be spent"
    scene.now_ns += MINUTE_NS
    scene.run.events.log("note", "x" * (OWN_BYTES - line + 1))
    scene.run.events.log("note", "y")
    assert flush(scene) == [], "not every other line of a flood"
    scene.now_ns += MINUTE_NS
    scene.run.events.log("note", "y")
    assert flush(scene) + flush(scene) == [
        "failstop: y",
        "failstop: 2 events of the kind note were left out: too many to log each one",
    ]


SCENE = Scene()
"""Made once: the allowances of a minute are forgotten with it."""


@given(spent=st.lists(st.tuples(st.integers(100, 3000), st.integers(0, 3 * 10**9)), max_size=100))
def test_a_minute_has_no_more_than_two_allowances(spent: list[tuple[int, int]]) -> None:
    SCENE.now_ns += 2 * MINUTE_NS
    flush(SCENE, end=True)
    told: list[tuple[int, int]] = []
    for size, elapsed_ns in spent:
        SCENE.now_ns += elapsed_ns
        SCENE.run.events.log("stop_again", "x" * (size - len("failstop: \n")), {"cause": "piped"})
        told += [(SCENE.now_ns, len(line) + 1) for line in flush(SCENE) if "left out" not in line]
    for at_ns, _ in told:
        assert sum(size for t_ns, size in told if at_ns <= t_ns < at_ns + MINUTE_NS) <= 2 * REPEATS_BYTES
