"""The end of the service: a stop that is heard, then every process ended, then another stop."""

from __future__ import annotations

import signal

import pytest

from failstop.board.interface import SUPERVISOR_ROW
from failstop.board.rrc.burst import BURST
from failstop.messages import layout, records
from failstop.policy.processes import PROCESS_BY_NAME
from failstop.shm import heartbeat
from failstop.supervisor import main
from failstop_lab.machine.kernel import TAKEDOWN_NS
from tests.support.stage import MS
from tests.support.supervisor_scene import Scene

KILLED_NS = len(PROCESS_BY_NAME) * TAKEDOWN_NS
"""Until they are gone, one after the other."""
STOPPING = ("stopping", "service is stopping; stop frame written by the port owner after 0 us")


@pytest.fixture
def scene() -> Scene:
    return whole()


def whole(settings: dict[str, object] | None = None) -> Scene:
    """Every process runs; the port owner has stopped already for the end that is to come."""
    made = Scene(*PROCESS_BY_NAME, settings=settings)
    made.pass_time()
    made.keep_beating()
    made.port_owner.word("written_ns").set(made.now_ns)
    made.port_owner.word("stopped_epoch").set(2)
    made.events()
    return made


def answer(scene: Scene, sent_ns: int) -> None:
    """The board has answered a ping a millisecond after it was sent."""
    scene.port_owner.word("asked_ns").set(sent_ns)
    scene.answered(sent_ns, sent_ns + MS)


def end(scene: Scene) -> tuple[bool, list[tuple[str, str]]]:
    """Told to end: (did it end well, what people were told)."""
    scene.supervisor.end(signal.SIGTERM, None)
    well = scene.supervisor.finish()
    return well, [(event["kind"], event["text"]) for event in scene.events() if event["kind"] != "link"]


@pytest.mark.claim("END-1")
def test_the_end_is_a_stop_that_is_heard_then_every_process_ended_then_another_stop(scene: Scene) -> None:
    scene.rung(layout.SUPERVISOR)
    answer(scene, scene.now_ns)
    began_ns = scene.now_ns
    well, told = end(scene)
    assert well
    assert scene.rung(layout.SUPERVISOR), "it does not sleep over it"
    assert scene.supervisor.ending
    assert told == [
        STOPPING,
        ("stopped", "stopped; the stop was written twice, acknowledged by the board after 1.0 ms"),
    ]
    assert scene.wire.read() == BURST
    assert scene.now_ns == began_ns + KILLED_NS, "it waits for nothing that is known"
    assert [scene.state(name) for name in PROCESS_BY_NAME] == ["waiting"] * len(PROCESS_BY_NAME)
    assert scene.word("beat_state").get() == heartbeat.BEAT_STOPPING
    assert sorted(process.name for process in scene.born) == sorted(PROCESS_BY_NAME), "an end in order is no incident"


def test_a_board_that_has_never_answered_is_waited_for_a_while_and_is_no_failure(scene: Scene) -> None:
    began_ns = scene.now_ns
    well, told = end(scene)
    assert well
    assert told[1][1].endswith("nobody knows whether the board hears (link unproven)")
    assert scene.now_ns == began_ns + main.HEAR_NS + KILLED_NS
    assert scene.word("beat_ns").get() > began_ns, "its own beat goes on: nobody stops for its silence"


def test_a_board_that_can_not_answer_is_waited_for_no_longer_than_for_its_echo() -> None:
    scene = whole({"board.kind": "hoverboard"})
    began_ns, repeats_ns, echo_ns = (
        scene.now_ns,
        scene.port.board.repeats_ns[SUPERVISOR_ROW],
        2 * scene.port.board.echo_ns,
    )
    well, told = end(scene)
    assert well
    assert told[1][1].endswith("not acknowledged, because this board's echo shows only a stop that ends motion")
    assert scene.now_ns == began_ns + echo_ns + KILLED_NS + repeats_ns[-1]


def test_the_last_line_names_the_echo_that_has_acknowledged_the_last_stop() -> None:
    scene = whole({"board.kind": "hoverboard"})
    scene.telemetry.latest_writer("proved").write(records.PROVED.pack(scene.now_ns, scene.now_ns + MS))
    well, told = end(scene)
    assert well
    assert told[1][1].endswith("acknowledged by the board's echo after 1.0 ms")


def test_a_board_that_does_not_hear_the_last_stop_is_a_failure(scene: Scene) -> None:
    answer(scene, scene.now_ns - 1)
    well, told = end(scene)
    assert not well
    assert told[1][1].endswith("NOT acknowledged by the board (link alive); if the wheels turn, use the POWER SWITCH")
    assert scene.wire.read() == BURST


def test_a_board_that_goes_deaf_at_the_end_is_told_of(scene: Scene) -> None:
    deaf_ns = scene.settings.ns("link.deaf_s")
    answer(scene, scene.now_ns - 2 * deaf_ns)
    scene.pass_time()
    scene.port_owner.word("asked_ns").set(scene.now_ns - deaf_ns)
    well, told = end(scene)
    assert not well
    assert told[1][1].endswith("NOT acknowledged by the board (link deaf); if the wheels turn, use the POWER SWITCH")


@pytest.mark.parametrize("full", [True, False])
def test_a_second_stop_that_the_kernel_does_not_take_or_keeps_is_a_failure(scene: Scene, full: bool) -> None:
    """Bytes that the kernel holds are dropped with the port."""
    scene.wire.fill() if full else scene.wire.hold()
    answer(scene, scene.now_ns)
    well, told = end(scene)
    assert not well
    how = "could NOT be written, acknowledged" if full else "was handed over, NOT sent"
    assert told[1][1].startswith(f"stopped; the second stop {how}")


@pytest.mark.parametrize("full", [False, True])
def test_the_service_manager_hears_of_no_stop_that_could_not_be_written(scene: Scene, full: bool) -> None:
    scene.supervisor.processes[layout.PORT_OWNER].kill(20.0)
    scene.port_owner.word("stopped_epoch").set(1)
    said: list[str] = []
    scene.supervisor.status.notify.say = said.append
    if full:
        scene.wire.fill()
    end(scene)
    told = "NO STOP COULD BE WRITTEN YET" if full else "the stop is written"
    assert [line for line in said if "STOPPING" in line] == [f"STOPPING=1\nSTATUS={told}; ending every process"]


def test_an_end_without_a_port_owner_has_the_supervisor_s_stop_and_waits_for_nobody(scene: Scene) -> None:
    scene.supervisor.processes[layout.PORT_OWNER].kill(20.0)
    scene.port_owner.word("stopped_epoch").set(1)
    began_ns = scene.now_ns
    well, told = end(scene)
    assert well
    assert told[0] == ("stopping", "service is stopping; stop frame written by the supervisor after 0 us")
    assert scene.wire.read() == 2 * BURST
    assert scene.now_ns == began_ns + KILLED_NS - TAKEDOWN_NS


def test_a_port_owner_that_does_not_answer_the_end_is_killed_before_the_burst(scene: Scene) -> None:
    """The kernel may have a motion frame of it in hand, which comes with its death."""
    scene.port_owner.word("stopped_epoch").set(1)
    process = scene.employ(layout.PORT_OWNER)
    lived: list[bool] = []
    scene.wire.on_bytes = lambda data: lived.append(not process.dead)
    began_ns = scene.now_ns
    well, told = end(scene)
    assert well
    assert lived == [False, False]
    assert scene.wire.read() == 2 * BURST
    assert told[0] == ("stopping", "service is stopping; stop frame written by the supervisor after 5000 us")
    assert scene.now_ns == began_ns + main.STOP_ANSWER_NS + KILLED_NS - TAKEDOWN_NS
