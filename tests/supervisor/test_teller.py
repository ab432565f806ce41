"""When people are told what motion waits for; that a service which is never ready says why."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator

import pytest

from failstop.shm import layout, segment
from failstop.shm.heartbeat import EARLY_NEWS, REALTIME
from failstop.supervisor.causes import Cause
from failstop.supervisor.events import Events
from failstop.supervisor.teller import MOST_SAID, WAITED_NS, Teller

T0 = 10**12


class Told(Events):
    """Keeps the kinds."""

    def __init__(self) -> None:
        super().__init__("x")
        self.kinds: list[str] = []
        self.lines: list[tuple[str, str]] = []

    def tell(self, kind: str, text: str, fields: object = None, *, level: str = "") -> None:
        self.kinds.append(kind)
        self.lines.append((level, text))


@pytest.fixture
def name() -> Iterator[str]:
    made = f"w{os.getpid()}x{time.monotonic_ns()}"
    for process in (layout.GATE, layout.TELEMETRY):
        segment.create(made, process, 7).close()
    yield made
    segment.unlink_all(made)


@pytest.fixture
def events() -> Told:
    return Told()


@pytest.fixture
def teller(name: str, events: Told) -> Teller:
    return Teller(
        name, events, {process: segment.attach(name, process) for process in (layout.GATE, layout.TELEMETRY)}, ""
    )


def test_a_thousand_reasons_of_somebody_s_are_not_all_remembered_and_hide_no_death(
    teller: Teller, events: Told
) -> None:
    teller.latched(Cause(T0, layout.PORT_OWNER, "key1"))
    for number in range(1000):
        teller.also(Cause(T0, layout.PORT_OWNER, f"stop request: {number}"))
        assert len(teller._said) <= MOST_SAID
    before = len(events.kinds)
    teller.also(Cause(T0, layout.PORT_OWNER, "gate died"))
    teller.also(Cause(T0, layout.SUPERVISOR, "gate died"))
    assert len(events.kinds) == before + 1


TWICE = "stopped; the stop was written twice, "
ONCE = "stopped; the second stop could NOT be written, "
DEAF = "NOT acknowledged by the board (link deaf); wheels that turn: POWER SWITCH"


@pytest.mark.parametrize(
    ("heard_ns", "link", "written", "level", "text"),
    [
        (3_140_000, "alive", True, "", f"{TWICE}acknowledged by the board after 3.1 ms"),
        (0, "unproven", True, "warning", f"{TWICE}whether the board hears is not known (link unproven)"),
        (0, "deaf", True, "critical", TWICE + DEAF),
        (3_140_000, "alive", False, "critical", f"{ONCE}acknowledged by the board after 3.1 ms"),
        (0, "deaf", False, "critical", ONCE + DEAF),
    ],
)
def test_the_end_is_told_with_what_is_known_of_the_stop(
    teller: Teller, events: Told, heard_ns: int, link: str, written: bool, level: str, text: str
) -> None:
    teller.ended(heard_ns, link, written=written, sent=written)
    assert events.lines == [(level, text)]


def test_a_stop_that_the_kernel_keeps_is_not_said_to_be_written(teller: Teller, events: Told) -> None:
    teller.ended(0, "deaf", written=True, sent=False)
    handed = "stopped; the second stop was handed over, NOT sent: the board takes no bytes, "
    assert events.lines == [("critical", handed + DEAF)]


def test_a_short_wait_is_not_told_of(teller: Teller, events: Told) -> None:
    for since_ns, missing in ((0, "gate, telemetry"), (WAITED_NS - 1, "gate"), (WAITED_NS, "gate"), (WAITED_NS, "")):
        teller.missing(missing, T0 + since_ns)
    assert events.kinds == []


def test_a_start_that_hangs_says_what_it_waits_for_and_then_that_it_is_ready(teller: Teller, events: Told) -> None:
    teller.missing("the port", T0)
    teller.missing("the port", T0 + WAITED_NS)
    teller.missing("the port", T0 + 2 * WAITED_NS)
    assert events.kinds == ["waiting"]
    teller.ready(REALTIME | EARLY_NEWS)
    teller.missing("", T0 + 3 * WAITED_NS)
    assert events.kinds == ["waiting", "ready"], "once"


def test_each_long_wait_and_its_end_are_told(teller: Teller, events: Told) -> None:
    teller.ready(0)
    for at, missing in enumerate(("", "gate", "gate", "gate, the port", "gate, the port", "", "", "gate", "gate", "")):
        teller.missing(missing, T0 + at * WAITED_NS)
    assert events.kinds == ["ready", "rights", "rights", "waiting", "waiting", "ready", "waiting", "ready"]
