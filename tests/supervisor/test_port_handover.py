"""One port for all of them, or none: what the supervisor does when it is lost, back, or missing somewhere."""

from __future__ import annotations

import pytest

from failstop.board.rrc.burst import BURST
from failstop.messages import layout, records
from failstop.procs.schedule import ZERO_EVERY_NS
from failstop.shm.heartbeat import BEAT_STARTING
from failstop.supervisor.port_handover import LOOK_NS, SHARE_NS
from tests.support.stage import MS
from tests.support.supervisor_scene import DEVICE, Scene

OTHERS = (layout.PORT_OWNER, layout.STOPPER, layout.TELEMETRY)


@pytest.fixture
def scene() -> Scene:
    """Port owner, stopper and telemetry run and have the port; the opener's thread waits for a loss."""
    made = Scene(*OTHERS)
    made.supervisor.handover.opener.begin()
    made.has_port(layout.STOPPER)
    turn(made)
    return made


def turn(scene: Scene, elapsed_ns: int = 0) -> bytes:
    """Time passes, they beat, and the supervisor wakes up; returns what it wrote."""
    scene.now_ns += elapsed_ns
    scene.beat(*OTHERS)
    return scene.pass_time()


def received(scene: Scene, name: str) -> list[tuple[int, str]]:
    """Number and path of each port that was sent to it since the last call."""
    found = []
    control = scene.load("failstop.procs.handover").Control(scene.run.controls[name][1])
    while sent := control.receive():
        scene.os.close(sent[0])
        found.append(sent[1:])
    return found


def lose(scene: Scene) -> None:
    """The port owner finds it gone, and the supervisor sees that."""
    scene.has_port(layout.PORT_OWNER, 1, records.PORT_LOST)
    for name in (layout.STOPPER, layout.TELEMETRY):
        scene.has_port(name, 0)
    turn(scene)
    assert scene.port.fd < 0
    scene.wire.unplug()


def come_back(scene: Scene, *, full: bool = False) -> None:
    """The device is there again, as another port, and is opened. `full`: it takes nothing until then."""
    scene.plug()
    if full:
        scene.wire.fill()
    bell = scene.run.bells[layout.SUPERVISOR]
    assert scene.machine.run(lambda: scene.supervisor.loop.readable(bell.fd), 2 * LOOK_NS), "it is looked for"
    if full:
        scene.wire.port.drain()
        scene.wire.read()


@pytest.mark.parametrize("name", OTHERS)
def test_the_port_is_complete_with_everybody_s_own_descriptor_of_it_alone(scene: Scene, name: str) -> None:
    complete = scene.supervisor.handover.complete
    assert complete()
    for number in (0, 2):
        scene.has_port(name, number)
        assert not complete()
    scene.has_port(name)
    assert complete()
    scene.has_port(layout.PORT_OWNER, 1, records.PORT_LOST)
    assert not complete()


def test_a_port_that_is_back_is_stopped_before_the_supervisor_turns(scene: Scene) -> None:
    lose(scene)
    turn(scene, 100 * MS)
    come_back(scene)
    assert scene.wire.read() == BURST
    assert scene.supervisor.loop.wait(0), "its bell has rung"
    opened_ns = scene.now_ns
    assert turn(scene, MS) == b""
    assert scene.port.fd >= 0
    assert scene.word("written_ns").get() == opened_ns, "the opener's burst is the supervisor's"


@pytest.mark.parametrize("name", OTHERS)
def test_the_supervisor_sends_the_port_to_each_until_it_has_it(scene: Scene, name: str) -> None:
    lose(scene)
    come_back(scene)
    others = set(OTHERS) - {name}
    turn(scene)
    assert received(scene, name) == [(2, DEVICE)], "it did not arrive: no number was free, say"
    for other in others:
        scene.has_port(other, 2)
        assert received(scene, other) == [(2, DEVICE)]
    turn(scene, SHARE_NS - 1)
    assert received(scene, name) == []
    turn(scene, 1)
    assert len(received(scene, name)) == 1
    scene.has_port(name, 2)
    turn(scene, SHARE_NS)
    assert [received(scene, each) for each in OTHERS] == [[], [], []]
    assert scene.supervisor.handover.complete()


@pytest.mark.parametrize("name", OTHERS)
def test_one_that_is_starting_inherits_it_and_gets_it_when_it_runs_without(scene: Scene, name: str) -> None:
    scene.dies(name)
    turn(scene)
    assert scene.state(name) == "starting"
    scene.own[name].word("beat_state").set(BEAT_STARTING)
    scene.has_port(name, 0)
    turn(scene, SHARE_NS)
    assert received(scene, name) == []
    scene.employ(name)
    turn(scene)
    assert len(received(scene, name)) == 1


def test_one_that_waits_for_its_restart_is_sent_nothing(scene: Scene) -> None:
    for _ in range(3):  # after the second death a restart waits
        scene.dies(layout.PORT_OWNER)
        turn(scene)
    assert scene.state(layout.PORT_OWNER) == "waiting"
    lose(scene)
    come_back(scene)
    turn(scene)
    assert received(scene, layout.PORT_OWNER) == [], "it would stay open in the queue"
    assert len(received(scene, layout.STOPPER)) == 1


def test_its_loss_and_its_return_are_told_once_each(scene: Scene) -> None:
    scene.events()
    lose(scene)
    lost_ns = scene.now_ns
    turn(scene, MS)
    turn(scene, 1_226 * MS)
    come_back(scene)
    turn(scene, lost_ns + 1_234_400_000 - scene.now_ns)
    for _ in range(2):
        turn(scene)
    told = [event for event in scene.events() if event["kind"].startswith("device_")]
    assert [(event["kind"], event["text"]) for event in told] == [
        (
            "device_lost",
            f"{DEVICE} is gone; the stop is written the moment it is back; if the wheels turn, use the POWER SWITCH",
        ),
        ("device_back", f"{DEVICE} is back after 1.2 s; the stop is written"),
    ]
    assert [event["fields"] for event in told] == [{"path": DEVICE}, {"path": DEVICE, "away_s": 1.234}]


@pytest.mark.parametrize("sure", [True, False])
def test_a_return_says_only_that_the_stop_is_written_if_it_is(scene: Scene, sure: bool) -> None:
    lose(scene)
    scene.events()
    scene.supervisor.handover.opener.finder.sure = sure
    scene.plug()
    scene.wire.fill()
    bell = scene.run.bells[layout.SUPERVISOR]
    assert scene.machine.run(lambda: scene.supervisor.loop.readable(bell.fd), 2 * LOOK_NS), "it is looked for"
    turn(scene)
    (text,) = [event["text"] for event in scene.events() if event["kind"] == "device_back"]
    assert "NO STOP COULD BE WRITTEN YET" in text
    assert "the stop is written" not in text
    assert text.endswith("if the wheels turn, use the POWER SWITCH")


@pytest.mark.parametrize(("number", "lost"), [(0, False), (1, True), (2, False)])
def test_the_loss_of_another_port_is_no_loss_of_this_one(scene: Scene, number: int, lost: bool) -> None:
    """It may be late, and speak of the one before."""
    scene.has_port(layout.PORT_OWNER, number, records.PORT_LOST)
    turn(scene)
    assert (scene.port.fd < 0) is lost


@pytest.mark.parametrize("sign", ["record", "hang-up"])
def test_a_port_that_has_gone_is_let_go_and_who_else_holds_it_told(scene: Scene, sign: str) -> None:
    fd = scene.port.fd
    for name in (layout.STOPPER, layout.TELEMETRY):
        scene.rung(name)
    if sign == "record":
        scene.has_port(layout.PORT_OWNER, 1, records.PORT_LOST)
    else:
        scene.wire.unplug()
    turn(scene)
    assert fd not in scene.fds()
    assert scene.port.fd == -1
    assert [scene.rung(name) for name in (layout.STOPPER, layout.TELEMETRY)] == [True, True]
    assert not scene.supervisor.handover.lost({}, scene.now_ns), "once"


def test_the_loop_writes_a_burst_that_the_opener_could_not_and_tells_of_it(scene: Scene) -> None:
    lose(scene)
    scene.gate_stops()
    noticed_ns = scene.now_ns
    turn(scene)
    scene.answers()
    turn(scene)
    assert scene.told()["written_us"] is None, "nobody has a port to write it on"
    come_back(scene, full=True)
    assert turn(scene, noticed_ns + 7 * MS - scene.now_ns) == BURST
    assert (scene.told()["written_by"], scene.told()["written_us"]) == ("supervisor", 7_000.0)


def test_the_link_of_a_port_that_is_gone_is_unheard(scene: Scene) -> None:
    scene.pings()
    turn(scene, 2 * MS)
    assert scene.read("link") == b"alive"
    lose(scene)
    turn(scene, MS)
    assert scene.read("link") == b"unheard"


@pytest.mark.parametrize(("sure", "state"), [(True, b"unproven"), (False, b"unheard")])
def test_the_link_of_a_lost_device_that_nobody_heard_is_as_sure_as_the_device_was(
    scene: Scene, sure: bool, state: bytes
) -> None:
    """Otherwise a stop that went to another device would count as one that the board got."""
    scene.supervisor.handover.opener.finder.sure = sure
    lose(scene)
    turn(scene, MS)
    assert scene.read("link") == state


def test_the_device_that_answers_is_the_board_where_another_one_was_known(scene: Scene) -> None:
    opener = scene.supervisor.handover.opener
    scene.pings()
    turn(scene, 2 * MS)
    assert not opener.believed, "the board that is known is the open one"
    opener.finder._board = scene.load("failstop.board.finder").Device("1a86", "55d4", "A", "0", "1-1.2")
    turn(scene, 2 * MS)
    assert opener.believed
    lose(scene)
    turn(scene, LOOK_NS)
    scene.supervisor.handover.believe()
    assert not opener.believed, "there is no device"


def test_the_supervisor_repeats_the_stop_while_the_port_owner_has_no_port(scene: Scene) -> None:
    """At its pace, from the burst of the opener on."""
    lose(scene)
    turn(scene, ZERO_EVERY_NS)
    come_back(scene)
    opened_ns = scene.now_ns
    assert turn(scene) == BURST
    assert turn(scene, opened_ns + ZERO_EVERY_NS - 1 - scene.now_ns) == b""
    assert turn(scene, 1) == BURST
    scene.has_port(layout.PORT_OWNER, 2)
    assert turn(scene, ZERO_EVERY_NS) == b"", "it says zero itself"
    assert scene.supervisor.loop.due_ns() > scene.now_ns, "and no timer of a repeat keeps the loop awake"


def test_a_port_that_has_gone_again_before_anybody_heard_of_it_is_lost_again(scene: Scene) -> None:
    lose(scene)
    come_back(scene)
    turn(scene)
    scene.wire.unplug()
    turn(scene)
    assert scene.port.fd < 0
    come_back(scene)
    turn(scene)
    assert received(scene, layout.STOPPER) == [(2, DEVICE), (3, DEVICE)]
