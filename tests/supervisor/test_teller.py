"""When people are told what motion waits for; that a service which is never ready says why."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator

import pytest

from failstop.procs.world import World
from failstop.shm import layout, segment
from failstop.shm.heartbeat import EARLY_NEWS, REALTIME
from failstop.shm.notes import Note
from failstop.supervisor.events import Events
from failstop.supervisor.stops import Stop
from failstop.supervisor.teller import MOST_SAID, NO_EARLY_NEWS, NO_REALTIME, WAITED_NS, Teller
from tests.support.why import why

T0 = 10**12


class Told(Events):
    """Keeps what is told."""

    def __init__(self) -> None:
        super().__init__(World(), "x")
        self.kinds: list[str] = []
        self.whole: list[tuple[str, str, object, str]] = []

    def tell(self, kind: str, text: str, fields: object = None, *, level: str = "") -> None:
        self.kinds.append(kind)
        self.whole.append((kind, text, fields, level))


@pytest.fixture
def memory() -> Iterator[str]:
    made = f"w{os.getpid()}x{time.monotonic_ns()}"
    for process in (layout.GATE, layout.TELEMETRY):
        segment.create(made, process, 7).close()
    yield made
    segment.unlink_all(made)


@pytest.fixture
def events() -> Told:
    return Told()


@pytest.fixture
def teller(memory: str, events: Told) -> Teller:
    views = {process: segment.attach(memory, process) for process in (layout.GATE, layout.TELEMETRY)}
    return Teller("x", events, views, "give it rights")


def answered(stop: Stop, written_ns: int, by: str = "port owner", latched: Stop | None = None, epoch: int = 7) -> Stop:
    """A stop of this cause that somebody has written, while another was latched."""
    found = Stop(stop.t_ns, stop.noticed_by, stop.cause)
    found.answered_by(by, written_ns, latched or found, epoch)
    return found


def test_a_thousand_reasons_of_somebody_s_are_not_all_remembered_and_hide_no_death(
    teller: Teller, events: Told
) -> None:
    teller.latched(Stop(T0, layout.PORT_OWNER, why("key1")))
    for number in range(1000):
        teller.also(Stop(T0, layout.PORT_OWNER, why(str(number))))
        assert len(teller._said) <= MOST_SAID
    before = len(events.kinds)
    teller.also(Stop(T0, layout.PORT_OWNER, why("gate died")))
    teller.also(Stop(T0, layout.SUPERVISOR, why("gate died")))
    assert len(events.kinds) == before + 1


TWICE = "stopped; the stop was written twice, "
ONCE = "stopped; the second stop could NOT be written, "
DEAF = "NOT acknowledged by the board (link deaf); wheels that turn: POWER SWITCH"


@pytest.mark.parametrize(
    ("heard_ns", "link", "written", "level", "text"),
    [
        (3_140_260, "alive", True, "", f"{TWICE}acknowledged by the board after 3.1 ms"),
        (0, "unproven", True, "warning", f"{TWICE}whether the board hears is not known (link unproven)"),
        (0, "deaf", True, "critical", TWICE + DEAF),
        (3_140_260, "alive", False, "critical", f"{ONCE}acknowledged by the board after 3.1 ms"),
        (0, "deaf", False, "critical", ONCE + DEAF),
    ],
)
def test_the_end_is_told_with_what_is_known_of_the_stop(
    teller: Teller, events: Told, heard_ns: int, link: str, written: bool, level: str, text: str
) -> None:
    teller.ended(heard_ns, link, written=written, sent=written)
    acknowledged_us = 3140.3 if heard_ns else None
    assert events.whole == [("stopped", text, {"link": link, "acknowledged_us": acknowledged_us}, level)]


KEY = Stop(T0, layout.PORT_OWNER, why("key1"))
DEATH = Stop(T0 + 5, layout.SUPERVISOR, why("gate died"))
NEXT = "next: `failstop reset --name x`, then `failstop enable --name x`"


@pytest.mark.parametrize(
    ("stop", "after_ns", "ending", "kind", "text", "level"),
    [
        (KEY, 80_260, False, "stop", f"STOP latched: key1; {{wrote}} 80 us; {NEXT}", ""),
        (KEY, -1, False, "stop", f"STOP latched: key1; {{wrote}} 0 us; {NEXT}", ""),
        (KEY, None, False, "stop", f"STOP latched: key1; stop frame NOT written; {NEXT}", "critical"),
        (DEATH, 80_260, False, "stop_again", "stopped again: gate died; {wrote} 80 us; latched is still: key1", ""),
        (
            DEATH,
            None,
            False,
            "stop_again",
            "stopped again: gate died; stop frame NOT written; latched is still: key1",
            "critical",
        ),
        (KEY, 80_260, True, "stopping", "key1; {wrote} 80 us", ""),
        (KEY, None, True, "stopping", "key1; stop frame NOT written", "critical"),
    ],
)
def test_a_stop_is_told_with_who_wrote_it_and_when(
    teller: Teller, events: Told, stop: Stop, after_ns: int | None, ending: bool, kind: str, text: str, level: str
) -> None:
    written_ns = 0 if after_ns is None else stop.t_ns + after_ns
    teller.latched(KEY)
    teller.stopped(answered(stop, written_ns, "stopper", None if stop is KEY else KEY), ending=ending)
    fields = {
        "reason": str(stop.cause),
        "cause": stop.cause.kind.name,
        "noticed_by": stop.noticed_by,
        "written_by": "nobody" if after_ns is None else "stopper",
        "latency_us": None if after_ns is None else max(0.0, round(after_ns / 1e3, 1)),
        "epoch": 7,
    }
    latched = {"latched": "key1"} if kind == "stop_again" else {}
    wrote = "stop frame written by the stopper after"
    assert events.whole == [(kind, text.format(wrote=wrote), {**fields, **latched}, level)]


def test_what_came_together_is_told_once_until_the_next_latch(teller: Teller, events: Told) -> None:
    also = (
        "stop_also",
        "also: gate died",
        {"reason": "gate died", "cause": "died", "noticed_by": layout.SUPERVISOR},
        "",
    )
    for count in (1, 2):
        teller.latched(KEY)
        for cause in (KEY, DEATH, DEATH):
            teller.also(cause)
        teller.stopped(answered(DEATH, DEATH.t_ns, latched=KEY), ending=False)
        assert events.whole == [also] * count


def test_the_processes_remarks_are_passed_on_and_a_damaged_one_is_left_out(
    teller: Teller, events: Told, memory: str
) -> None:
    ring = segment.attach(memory, layout.GATE, write=True).ring_writer("notes")
    ring.put(b"damaged")
    ring.put(Note("refused", "no reset yet", {"who": "nav"}, level="notice").pack())
    teller.pass_notes()
    assert events.whole == [("refused", "no reset yet", {"process": "gate", "who": "nav"}, "notice")]


def test_a_stop_that_the_kernel_keeps_is_not_said_to_be_written(teller: Teller, events: Told) -> None:
    teller.ended(0, "deaf", written=True, sent=False)
    handed = "stopped; the second stop was handed over, NOT sent: the board takes no bytes, "
    assert events.whole == [("stopped", handed + DEAF, {"link": "deaf", "acknowledged_us": None}, "critical")]


def test_a_latched_stop_that_the_kernel_keeps_is_handed_over(teller: Teller, events: Told) -> None:
    teller.stopped(answered(KEY, KEY.t_ns + 80_000), ending=False, held=True)
    [(kind, text, _, level)] = events.whole
    handed = "stop frame handed over by the port owner after 80 us, NOT sent: the board takes no bytes"
    assert (kind, text, level) == ("stop", f"STOP latched: key1; {handed}; {NEXT}", "critical")


def test_what_was_not_handed_over_is_held_by_nobody(teller: Teller, events: Told) -> None:
    teller.stopped(answered(KEY, 0), ending=True, held=True)
    [(_, text, _, level)] = events.whole
    assert (text, level) == ("key1; stop frame NOT written", "critical")


def test_a_short_wait_is_not_told_of(teller: Teller, events: Told) -> None:
    for since_ns, missing in ((0, "gate, telemetry"), (WAITED_NS - 1, "gate"), (WAITED_NS, "gate"), (WAITED_NS, "")):
        teller.missing(missing, T0 + since_ns)
    assert events.kinds == []


def test_a_start_that_hangs_says_what_it_waits_for_and_then_that_it_is_ready(teller: Teller, events: Told) -> None:
    teller.missing("the port", T0)
    teller.missing("the port", T0 + WAITED_NS)
    teller.missing("the port", T0 + 2 * WAITED_NS)
    text = "waiting for the port: motion can't be enabled; next: `failstop status --name x`"
    assert events.whole == [("waiting", text, {"for": "the port"}, "")]
    teller.ready(REALTIME | EARLY_NEWS)
    teller.missing("", T0 + 3 * WAITED_NS)
    assert events.kinds == ["waiting", "ready"], "once"


def test_each_long_wait_and_its_end_are_told(teller: Teller, events: Told) -> None:
    teller.ready(0)
    for at, missing in enumerate(("", "gate", "gate", "gate, the port", "gate, the port", "", "", "gate", "gate", "")):
        teller.missing(missing, T0 + at * WAITED_NS)
    assert events.kinds == ["ready", "rights", "rights", "waiting", "waiting", "ready", "waiting", "ready"]
    assert events.whole[0][1].endswith(" is ready: wheels stopped, motion disabled; next: `failstop enable --name x`")
    assert events.whole[1][1:3] == (f"{NO_REALTIME}; give it rights", {"what": "SCHED_FIFO"})
    assert events.whole[2][1:3] == (NO_EARLY_NEWS, {"what": "robust futexes"})
    assert events.whole[5][1] == "gate, the port is there now: motion can be enabled again"
