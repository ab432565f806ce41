"""In which words people are told of stops, and of what motion waits for: a service that is never ready says why."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.policy import causes
from failstop.procs.world import World
from failstop.shm import layout, segment
from failstop.shm.packing import Note
from failstop.supervisor.aftermath import MOST_SAID, Aftermath
from failstop.supervisor.events import Events
from failstop.supervisor.status import WAITED_NS, Status
from failstop.supervisor.stops import Stop
from tests.support.supervisor_scene import Scene
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
def events() -> Told:
    return Told()


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, events: Told) -> Iterator[Scene]:
    made = Scene(tmp_path, monkeypatch)
    made.run.events = made.supervisor.processes._events = events
    yield made
    made.close()


@pytest.fixture
def aftermath(scene: Scene) -> Aftermath:
    return scene.supervisor.aftermath


@pytest.fixture
def status(scene: Scene) -> Status:
    return scene.supervisor.status


def answered(stop: Stop, written_ns: int, by: str = "port owner", latched: Stop | None = None, epoch: int = 7) -> Stop:
    """A stop of this cause that somebody has written, while another was latched."""
    found = Stop(stop.t_ns, stop.noticed_by, stop.cause)
    found.answered_by(by, written_ns, latched or found, epoch)
    return found


def test_a_thousand_reasons_of_somebody_s_are_not_all_remembered_and_hide_no_death(
    aftermath: Aftermath, events: Told
) -> None:
    aftermath.latched(Stop(T0, layout.PORT_OWNER, why("key1")))
    for number in range(1000):
        aftermath.also(Stop(T0, layout.PORT_OWNER, why(str(number))))
        assert len(aftermath._said) <= MOST_SAID
    before = len(events.kinds)
    aftermath.also(Stop(T0, layout.PORT_OWNER, why("gate died")))
    aftermath.also(Stop(T0, layout.SUPERVISOR, why("gate died")))
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
    aftermath: Aftermath, events: Told, heard_ns: int, link: str, written: bool, level: str, text: str
) -> None:
    aftermath.ended(heard_ns, link, written=written, sent=written)
    acknowledged_us = 3140.3 if heard_ns else None
    assert events.whole == [("stopped", text, {"link": link, "acknowledged_us": acknowledged_us}, level)]


KEY = Stop(T0, layout.PORT_OWNER, why("key1"))
STUCK = Stop(T0, layout.PORT_OWNER, causes.STUCK())
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
    aftermath: Aftermath, events: Told, stop: Stop, after_ns: int | None, ending: bool, kind: str, text: str, level: str
) -> None:
    written_ns = 0 if after_ns is None else stop.t_ns + after_ns
    aftermath.latched(KEY)
    aftermath.answered(answered(stop, written_ns, "stopper", None if stop is KEY else KEY), ending=ending)
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


def test_what_came_together_is_told_once_until_the_next_latch(aftermath: Aftermath, events: Told) -> None:
    also = (
        "stop_also",
        "also: gate died",
        {"reason": "gate died", "cause": "died", "noticed_by": layout.SUPERVISOR},
        "",
    )
    for count in (1, 2):
        aftermath.latched(KEY)
        for cause in (KEY, DEATH, DEATH):
            aftermath.also(cause)
        aftermath.answered(answered(DEATH, DEATH.t_ns, latched=KEY), ending=False)
        assert events.whole == [also] * count


def test_the_processes_remarks_are_passed_on_and_a_damaged_one_is_left_out(scene: Scene, events: Told) -> None:
    ring = segment.attach(scene.run.memory, layout.GATE, write=True).ring_writer("notes")
    ring.put(b"damaged")
    ring.put(Note("refused", "no reset yet", {"who": "nav"}, level="notice").pack())
    scene.supervisor.processes.pass_notes()
    assert events.whole == [("refused", "no reset yet", {"process": "gate", "who": "nav"}, "notice")]


def test_a_stop_that_the_kernel_keeps_is_not_said_to_be_written(aftermath: Aftermath, events: Told) -> None:
    aftermath.ended(0, "deaf", written=True, sent=False)
    handed = "stopped; the second stop was handed over, NOT sent: the board takes no bytes, "
    assert events.whole == [("stopped", handed + DEAF, {"link": "deaf", "acknowledged_us": None}, "critical")]


def test_a_latched_stop_that_the_kernel_keeps_is_handed_over(aftermath: Aftermath, events: Told) -> None:
    aftermath._holds = lambda: True
    aftermath.answered(answered(STUCK, KEY.t_ns + 80_000), ending=False)
    [(kind, text, _, level)] = events.whole
    handed = "stop frame handed over by the port owner after 80 us, NOT sent: the board takes no bytes"
    assert (kind, text, level) == ("stop", f"STOP latched: {STUCK.cause}; {handed}; {NEXT}", "critical")


@pytest.mark.parametrize(("stop", "held"), [(KEY, True), (STUCK, False)])
def test_a_burst_on_its_way_to_a_board_that_takes_bytes_is_not_said_to_be_unsent(
    aftermath: Aftermath, events: Told, stop: Stop, held: bool
) -> None:
    """Any burst is held for a moment, and a port that was stuck has drained again."""
    aftermath._holds = lambda: held
    aftermath.answered(answered(stop, KEY.t_ns + 80_000), ending=False)
    [(_, text, _, level)] = events.whole
    assert (text, level) == (
        f"STOP latched: {stop.cause}; stop frame written by the port owner after 80 us; {NEXT}",
        "",
    )


def test_what_was_not_handed_over_is_held_by_nobody(aftermath: Aftermath, events: Told) -> None:
    aftermath._holds = lambda: True
    aftermath.answered(answered(STUCK, 0), ending=True)
    [(_, text, _, level)] = events.whole
    assert (text, level) == (f"{STUCK.cause}; stop frame NOT written", "critical")


def test_a_short_wait_is_not_told_of(status: Status, events: Told) -> None:
    for since_ns, missing in ((0, "gate, telemetry"), (WAITED_NS - 1, "gate"), (WAITED_NS, "gate"), (WAITED_NS, "")):
        status.tell_people(missing, T0 + since_ns)
    assert events.kinds == []


def test_a_start_that_hangs_says_what_it_waits_for_and_then_that_it_is_ready(status: Status, events: Told) -> None:
    status.tell_people("the port", T0)
    status.tell_people("the port", T0 + WAITED_NS)
    status.tell_people("the port", T0 + 2 * WAITED_NS)
    text = "waiting for the port: motion can't be enabled; next: `failstop status --name x`"
    assert events.whole == [("waiting", text, {"for": "the port"}, "")]
    assert status.publish("")
    status.tell_people("", T0 + 3 * WAITED_NS)
    assert events.kinds == ["waiting", "ready"], "once"


def test_each_long_wait_and_its_end_are_told(status: Status, events: Told) -> None:
    assert status.publish("")
    for at, missing in enumerate(("", "gate", "gate", "gate, the port", "gate, the port", "", "", "gate", "gate", "")):
        status.tell_people(missing, T0 + at * WAITED_NS)
    assert events.kinds == ["ready", "waiting", "waiting", "ready", "waiting", "ready"]
    assert events.whole[0][1].endswith(
        " is ready: the stop is written, motion disabled; next: `failstop enable --name x`"
    )
    assert events.whole[3][1] == "gate, the port is there now: motion can be enabled again"
