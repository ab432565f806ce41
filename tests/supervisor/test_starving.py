"""A machine that does not run a process: who is spared, for how long, and what people are told of it."""

from __future__ import annotations

from typing import Any

import pytest

from failstop.messages import layout
from failstop.policy.processes import PROCESS_BY_NAME
from failstop.procs import starved
from failstop.supervisor.process_table import STARVED_SHOWN_NS
from failstop_lab.machine.process import Thread
from tests.support.stage import MS
from tests.support.supervisor_scene import NOT_STARVED, Scene

SPARED = tuple(name for name in PROCESS_BY_NAME if name != layout.PORT_OWNER)


@pytest.fixture
def scene() -> Scene:
    """Every process runs, and the machine runs none of them."""
    made = Scene(*PROCESS_BY_NAME)
    made.supervisor.status.ever = True
    for name in PROCESS_BY_NAME:
        made.starve(name)
    return made


def beat_but(scene: Scene, name: str, elapsed_ns: int = 10 * MS) -> None:
    """A tick in which everybody else beats."""
    scene.tick(elapsed_ns, beating=tuple(other for other in PROCESS_BY_NAME if other != name))


def shown(process: str, longest_ms: int, times: int) -> dict[str, object]:
    return {"starved": {"longest_ms": longest_ms, "process": process}, "starved_times": times}


def test_a_starved_process_is_left_alone_while_motion_is_disabled(scene: Scene) -> None:
    supervisor = scene.supervisor
    scene.has_port(layout.STOPPER)
    scene.answers()
    scene.tick(800 * MS)
    assert (supervisor.epochs.number, scene.word("ready").get()) == (1, 0)
    assert not any(child.fence for child in supervisor.children)
    assert scene.waits_for() == ", ".join(PROCESS_BY_NAME)
    scene.beat(*PROCESS_BY_NAME)
    for _ in range(2):
        scene.pass_time()
    assert scene.waits_for() == ""
    assert scene.starved() == [("port_owner", 800, 1)], "one for all of ten seconds"
    assert supervisor.processes.starved_record() == shown("port_owner", 800, 4)


@pytest.mark.parametrize("name", SPARED)
def test_a_starved_process_is_stopped_for_once_while_motion_is_enabled(scene: Scene, name: str) -> None:
    scene.enabled()
    while scene.supervisor.epochs.number == 1:
        beat_but(scene, name)
    assert (
        scene.cause()[1]
        == f"{name} hangs: {PROCESS_BY_NAME[name].deadline_ns // MS} ms silent (the machine is starved)"
    )
    beat_but(scene, name, 800 * MS)
    assert scene.supervisor.epochs.number == 2, "it is disabled now"
    assert not scene.supervisor.processes[name].fence


@pytest.mark.parametrize("sign", ["enabled", "moving"])
def test_a_starved_port_owner_is_fenced_while_it_may_move(scene: Scene, sign: str) -> None:
    if sign == "enabled":
        scene.enabled()
    else:
        scene.port_owner.word("moving").set(1)
    beat_but(scene, layout.PORT_OWNER, 100 * MS)
    assert "burst_us" in scene.supervisor.processes[layout.PORT_OWNER].fence.fields()
    assert scene.cause()[1] == "port_owner hangs: 100 ms silent (the machine is starved)"


def test_nobody_is_spared_for_ever_and_none_is_down_for_it(scene: Scene) -> None:
    telemetry = scene.supervisor.processes[layout.TELEMETRY]
    deadline_ns = PROCESS_BY_NAME[layout.TELEMETRY].deadline_ns
    for _ in range(6):
        scene.starve(layout.TELEMETRY)
        began_ns = scene.now_ns
        while not telemetry.fence:
            beat_but(scene, layout.TELEMETRY, 20 * MS)
        assert starved.LONGEST_NS <= scene.now_ns - began_ns - deadline_ns <= starved.LONGEST_NS + deadline_ns
        beat_but(scene, layout.TELEMETRY)
        assert telemetry.state == "waiting"


def test_a_beat_just_before_the_end_is_no_defect_of_the_table_of_states(scene: Scene) -> None:
    beat_but(scene, layout.TELEMETRY, 600 * MS)
    assert scene.state(layout.TELEMETRY) == "hanging"
    process = scene.employ(layout.TELEMETRY)
    scene.dies(process)
    scene.pass_time()
    assert scene.state(layout.TELEMETRY) == "starting", "it was reaped, and is restarted"
    assert scene.supervisor.processes.starved_record() == shown(layout.TELEMETRY, 600, 1)
    assert (scene.supervisor.epochs.number, scene.cause()[1]) == (2, "telemetry died")


def test_a_process_that_has_just_beaten_after_all_is_left_alone() -> None:
    scene = Scene(layout.GATE)

    def beats(thread: Thread, call: str, about: tuple[Any, ...]) -> None:
        if call == "stat":
            scene.beat(layout.GATE)

    scene.machine.at_seam = beats
    scene.tick(600 * MS)
    assert (scene.supervisor.epochs.number, scene.supervisor.processes.starved_record()) == (1, NOT_STARVED)


def test_a_starving_machine_is_told_of_at_most_every_ten_seconds(scene: Scene) -> None:
    found = scene.supervisor.processes
    assert found.starved_record() == NOT_STARVED
    for at_s, name, silent_ns in ((0, "gate", 300 * MS), (9.999, "stopper", 900_400_000), (10, "gate", 300 * MS)):
        found.log_starved(name, silent_ns, scene.now_ns + round(at_s * 1e9))
    first, second = scene.said()
    advice = scene.load("failstop.supervisor.status").advice(realtime=False, managed=False)
    text = f"the computer is too busy: gate did not run for 300 ms; {advice}"
    assert first[::2] == ("starved", text)
    assert first[3] == {"process": "gate", "silent_ms": 300, "times": 1}
    assert second[3] == {"process": "gate", "silent_ms": 300, "times": 3}
    assert found.starved_record() == shown("stopper", 900, 3)


def test_a_machine_that_starved_the_service_once_is_not_told_of_for_ever(scene: Scene) -> None:
    found = scene.supervisor.processes
    found.log_starved("gate", 900 * MS, scene.now_ns)
    scene.now_ns += STARVED_SHOWN_NS - 1
    found.log_starved("stopper", 100 * MS, scene.now_ns)
    scene.now_ns += 1
    assert found.starved_record() == shown("gate", 900, 2), "the longest of those that are shown"
    scene.now_ns += STARVED_SHOWN_NS - 1
    assert found.starved_record() == {**NOT_STARVED, "starved_times": 2}
    found.log_starved("stopper", 50 * MS, scene.now_ns)
    assert found.starved_record() == shown("stopper", 50, 3), "what is forgotten is no measure any more"
