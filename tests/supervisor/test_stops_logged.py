"""In which words people are told of stops, and of what motion waits for: a service that is never ready says why."""

from __future__ import annotations

from typing import Any

import pytest

from failstop.messages import layout
from failstop.messages.packing import Note
from failstop.policy import causes
from failstop.policy.proofs import LINK_UNASKED, UNMOVED
from failstop.supervisor.kinds import EVENT_BY_NAME
from failstop.supervisor.status import WAITED_NS
from failstop.supervisor.stop_tracker import SENTENCES_KEPT
from failstop.supervisor.stops import Stop
from tests.support.supervisor_scene import Scene
from tests.support.why import why

T0 = 10**12


@pytest.fixture
def scene() -> Scene:
    return Scene(layout.PORT_OWNER)


@pytest.fixture
def tracker(scene: Scene) -> Any:
    return scene.supervisor.tracker


@pytest.fixture
def status(scene: Scene) -> Any:
    return scene.supervisor.status


def told(scene: Scene) -> list[tuple[str, str, object, str]]:
    """Events that people got: kind, text, fields, and the level that is not the kind's."""
    return [
        (kind, text, fields, "" if level == EVENT_BY_NAME[kind].level else level)
        for kind, level, text, fields in scene.said()
    ]


def made(scene: Scene, stop: Stop) -> Any:
    """As the supervisor has it."""
    return scene.made_stop(stop.cause, stop.noticed_by, stop.t_ns)


def answered(scene: Scene, stop: Stop, written_ns: int, by: str = "port owner", latched: Stop | None = None) -> Any:
    """A stop of this cause that somebody has written, while another was latched."""
    found = made(scene, stop)
    found.answered_by(by, written_ns, made(scene, latched) if latched else found, 7)
    return found


def test_the_monitor_forgets_the_oldest_of_many_reasons_and_hides_no_death(scene: Scene, tracker: Any) -> None:
    """Of a thousand all would be told."""

    def news(reason: str) -> bool:
        tracker.also(made(scene, Stop(T0, layout.PORT_OWNER, why(reason))))
        return bool(scene.said())

    tracker.latched(made(scene, KEY))
    assert all(news(str(number)) for number in range(SENTENCES_KEPT - 1))
    assert not news("key1")
    assert not news("0")
    assert news("one more")
    assert news("key1")
    assert (news("gate died"), news("gate died")) == (True, False)


TWICE = "stopped; the stop was written twice, "
ONCE = "stopped; the second stop could NOT be written, "
DEAF = "NOT acknowledged by the board (link deaf); if the wheels turn, use the POWER SWITCH"


HANDED = "stopped; the second stop was handed over, NOT sent: the board accepts no bytes, "


@pytest.mark.parametrize(
    ("heard_ns", "link", "written", "sent", "level", "text"),
    [
        (3_150_160, "alive", True, True, "", f"{TWICE}acknowledged by the board after 3.2 ms"),
        (0, "unproven", True, True, "warning", f"{TWICE}nobody knows whether the board hears (link unproven)"),
        (0, "deaf", True, True, "critical", TWICE + DEAF),
        (0, "deaf", True, False, "critical", HANDED + DEAF),
        (3_150_160, "alive", False, False, "critical", f"{ONCE}acknowledged by the board after 3.2 ms"),
        (0, "deaf", False, False, "critical", ONCE + DEAF),
    ],
)
def test_the_end_is_told_with_what_is_known_of_the_stop(
    scene: Scene, tracker: Any, heard_ns: int, link: str, written: bool, sent: bool, level: str, text: str
) -> None:
    tracker.ended(heard_ns, link, written=written, sent=sent)
    acknowledged = {"acknowledged_us": 3150.2} if heard_ns else {}
    assert told(scene) == [("stopped", text, {"link": link, **acknowledged}, level)]


@pytest.mark.parametrize(
    ("by", "text"),
    [(("", "wheels"), "this board never acknowledges a stop (link unasked)"), (("echo", ""), UNMOVED)],
)
def test_the_end_of_a_board_that_is_asked_nothing_is_told_with_what_acknowledges_its_stops(
    scene: Scene, tracker: Any, by: tuple[str, str], text: str
) -> None:
    tracker._by = by
    tracker.ended(0, LINK_UNASKED, written=True, sent=True)
    assert [text for _, text, _, _ in told(scene)] == [TWICE + text]


KEY = Stop(T0, layout.PORT_OWNER, why("key1"))
STUCK = Stop(T0, layout.PORT_OWNER, causes.STUCK())
DEATH = Stop(T0 + 5, layout.SUPERVISOR, why("gate died"))
STEP = "next: `failstop reset --name stage`, then `failstop enable --name stage`"


@pytest.mark.parametrize(
    ("stop", "after_ns", "ending", "kind", "text", "level"),
    [
        (KEY, 80_260, False, "stop", f"STOP latched: key1; {{wrote}} 80 us; {STEP}", ""),
        (KEY, -1, False, "stop", f"STOP latched: key1; {{wrote}} 0 us; {STEP}", ""),
        (KEY, None, False, "stop", f"STOP latched: key1; stop frame NOT written; {STEP}", "critical"),
        (
            DEATH,
            80_260,
            False,
            "stop_again",
            "stopped again: gate died; {wrote} 80 us; the latched cause is still: key1",
            "",
        ),
        (
            DEATH,
            None,
            False,
            "stop_again",
            "stopped again: gate died; stop frame NOT written; the latched cause is still: key1",
            "critical",
        ),
        (KEY, 80_260, True, "stopping", "key1; {wrote} 80 us", ""),
        (KEY, None, True, "stopping", "key1; stop frame NOT written", "critical"),
    ],
)
def test_a_stop_is_told_with_who_wrote_it_and_when(
    scene: Scene, tracker: Any, stop: Stop, after_ns: int | None, ending: bool, kind: str, text: str, level: str
) -> None:
    written_ns = 0 if after_ns is None else stop.t_ns + after_ns
    tracker.latched(made(scene, KEY))
    tracker.answered(answered(scene, stop, written_ns, "stopper", None if stop is KEY else KEY), ending=ending)
    fields = {
        "reason": str(stop.cause),
        "cause": stop.cause.kind.name,
        "noticed_ns": stop.t_ns,
        "noticed_by": stop.noticed_by,
        "written_by": "nobody" if after_ns is None else "stopper",
        "epoch": 7,
    }
    latency = {} if after_ns is None else {"latency_us": max(0.0, round(after_ns / 1e3, 1))}
    latched = {"latched": "key1"} if kind == "stop_again" else {}
    wrote = "stop frame written by the stopper after"
    assert told(scene) == [(kind, text.format(wrote=wrote), {**fields, **latency, **latched}, level)]


def test_causes_that_came_together_are_told_once_until_the_next_latch(scene: Scene, tracker: Any) -> None:
    also = (
        "stop_also",
        "also: gate died",
        {"reason": "gate died", "cause": "died", "noticed_ns": DEATH.t_ns, "noticed_by": layout.SUPERVISOR},
        "",
    )
    for _ in range(2):
        tracker.latched(made(scene, KEY))
        for cause in (KEY, DEATH, DEATH):
            tracker.also(made(scene, cause))
        tracker.answered(answered(scene, DEATH, DEATH.t_ns, latched=KEY), ending=False)
        assert told(scene) == [also]


def test_the_processes_remarks_are_passed_on_and_a_damaged_one_is_left_out(scene: Scene) -> None:
    ring = scene.gate.ring_writer("notes")
    ring.put(b"damaged")
    ring.put(Note("refused", "no reset yet", {"who": "nav"}, level="warning", step="wait").pack())
    scene.supervisor.processes.pass_notes()
    assert told(scene) == [("refused", "no reset yet; next: wait", {"process": "gate", "who": "nav"}, "warning")]


WROTE = "stop frame written by the port owner after 80 us"
HANDED_OVER = "stop frame handed over by the port owner after 80 us, NOT sent: the board accepts no bytes"


@pytest.mark.parametrize(
    ("stop", "held", "after_ns", "text", "level"),
    [
        (STUCK, True, 80_000, f"{STUCK.cause}; {HANDED_OVER}", "critical"),
        # Any burst is held for a moment, and a port that was stuck has drained again.
        (KEY, True, 80_000, f"key1; {WROTE}", ""),
        (STUCK, False, 80_000, f"{STUCK.cause}; {WROTE}", ""),
        # What was not handed over is held by nobody.
        (STUCK, True, None, f"{STUCK.cause}; stop frame NOT written", "critical"),
    ],
)
def test_a_stop_that_the_kernel_keeps_is_not_said_to_be_written(
    scene: Scene, tracker: Any, stop: Stop, held: bool, after_ns: int | None, text: str, level: str
) -> None:
    if held:
        scene.wire.hold()
    tracker.answered(answered(scene, stop, 0 if after_ns is None else stop.t_ns + after_ns), ending=True)
    [(_, found, _, of_it)] = told(scene)
    assert (found, of_it) == (text, level)


def test_a_short_wait_is_not_told_of(scene: Scene, status: Any) -> None:
    for since_ns, missing in ((0, "gate, telemetry"), (WAITED_NS - 1, "gate"), (WAITED_NS, "gate"), (WAITED_NS, "")):
        status.log_waiting(missing, T0 + since_ns)
    assert told(scene) == []


def test_a_start_that_hangs_says_what_it_waits_for_and_then_that_it_is_ready(scene: Scene, status: Any) -> None:
    for since_ns in (0, WAITED_NS, 2 * WAITED_NS):
        status.log_waiting("the port", T0 + since_ns)
    text = "waiting for the port: motion can't be enabled; next: `failstop status --name stage`"
    assert told(scene) == [("waiting", text, {"for": "the port"}, "")]
    assert status.publish("")
    status.log_waiting("", T0 + 3 * WAITED_NS)
    assert [kind for kind, *_ in told(scene)] == ["ready"], "once"


def test_each_long_wait_and_its_end_are_told(scene: Scene, status: Any) -> None:
    assert status.publish("")
    for at, missing in enumerate(("", "gate", "gate", "gate, the port", "gate, the port", "", "", "gate", "gate", "")):
        status.log_waiting(missing, T0 + at * WAITED_NS)
    found = told(scene)
    assert [kind for kind, *_ in found] == ["ready", "waiting", "waiting", "ready", "waiting", "ready"]
    text = " is ready: it has told the wheels to stop, and motion is disabled; next: `failstop enable --name stage`"
    assert found[0][1].endswith(text)
    assert found[3][1] == "gate, the port is there now: motion can be enabled again"


def test_the_end_of_a_long_wait_promises_no_motion_while_a_stop_is_latched(scene: Scene, status: Any) -> None:
    assert status.publish("")
    scene.supervisor.epochs.latch.add([made(scene, Stop(T0, layout.PORT_OWNER, causes.DEVICE_LOST()))], 2, T0)
    for at, missing in enumerate(("the port", "the port", "")):
        status.log_waiting(missing, T0 + at * WAITED_NS)
    assert told(scene)[-1][:2] == ("ready", "the port is there now")
