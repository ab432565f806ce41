"""The supervisor's answer to a stop, and its words for it: written only when somebody has written it."""

from __future__ import annotations

import signal
from types import SimpleNamespace
from typing import Any

import pytest

from failstop.board.rrc.burst import BURST
from failstop.messages import layout
from failstop.policy import causes
from failstop.procs.schedule import ZERO_EVERY_NS
from failstop.shm.futex import PER_BLOCK
from failstop.shm.heartbeat import REALTIME
from failstop.supervisor.blackbox import START_NS
from failstop.supervisor.children import KILLED
from failstop.supervisor.main import STOP_ANSWER_NS
from failstop.supervisor.run import LOOK_EVERY_NS
from failstop.supervisor.status import NOTIFY_EVERY_NS, OWED_NS, UNDYING_NS
from failstop_lab.machine.process import Thread
from tests.support.stage import MS
from tests.support.supervisor_scene import RUNTIME_DIR, Scene
from tests.support.why import said, why


@pytest.fixture
def scene() -> Scene:
    return Scene(layout.PORT_OWNER)


@pytest.fixture
def alone() -> Scene:
    """Without a port owner."""
    return Scene()


def test_the_first_epoch_is_told_before_any_stop(scene: Scene) -> None:
    assert scene.word("epoch").get() == scene.supervisor.epochs.number == 1


def test_the_supervisor_s_futexes_tell_of_its_death(scene: Scene) -> None:
    attach = scene.load("failstop.messages.segments").attach
    lifelines = attach(scene.run.memory, "lifelines", scene.run.incarnation)
    words = [lifelines.futex("held", layout.SUPERVISOR_BLOCK * PER_BLOCK + index) for index in range(PER_BLOCK)]
    assert all(word.held() for word in words)
    assert scene.machine.inline
    scene.machine.mark(scene.machine.inline)
    assert all(word.owner_died() for word in words)


@pytest.mark.parametrize("granted", [0, REALTIME])
def test_the_advice_to_a_starved_service_depends_on_its_rights(granted: int) -> None:
    scene = Scene(granted=granted)
    advice = scene.load("failstop.supervisor.status").advice
    scene.supervisor.processes.log_starved("gate", MS, scene.now_ns)
    ((_, _, text, _),) = scene.said()
    expected = advice(realtime=bool(granted), managed=False)
    assert text == f"the computer is too busy: gate did not run for 1 ms; {expected}"
    assert expected != advice(realtime=not granted, managed=False)


def test_the_journal_gets_what_people_are_told_where_there_is_one() -> None:
    sent: list[bytes] = []
    scene = Scene(journal=SimpleNamespace(send=lambda datagram: not sent.append(datagram)))
    scene.run.events.log("note", "from the test")
    scene.run.events.flush()
    assert b"MESSAGE=from the test\n" in sent[0]
    assert scene.stderr.heard == []


@pytest.mark.parametrize(
    ("process", "cause", "came_us", "answered_us", "wrote", "told"),
    [
        (layout.PORT_OWNER, "key1", 50, 0, b"", ("port owner", 50.0)),
        (layout.GATE, "x", 0, 80, b"", ("port owner", 80.0)),
        (layout.PORT_OWNER, "port trouble", 0, 0, BURST, ("supervisor", 1000.0)),
        # It has lost the port, and its last burst was long ago.
        (layout.GATE, "x", 0, 0, BURST, ("supervisor", 1000.0)),
    ],
)
def test_the_supervisor_writes_a_stop_that_the_port_owner_did_not_write(
    scene: Scene, process: str, cause: str, came_us: int, answered_us: int, wrote: bytes, told: tuple[str, float]
) -> None:
    began_ns = scene.now_ns
    scene.raises(process, why(cause), written_ns=came_us and began_ns + came_us * 1_000)
    assert scene.turn() == b""
    assert (scene.supervisor.epochs.number, scene.word("epoch").get(), scene.word("ready").get()) == (2, 2, 0)
    scene.answers(written_ns=answered_us and began_ns + answered_us * 1_000)
    assert scene.turn(MS) == wrote
    assert scene.told() == {"reason": cause, "written_by": told[0], "written_us": told[1]}


def test_a_device_lost_is_said_to_be_not_written(scene: Scene) -> None:
    scene.answers(written_ns=scene.now_ns - MS)
    scene.wire.unplug()
    scene.notice("device lost", written_ns=0)
    scene.turn()
    scene.answers()
    scene.turn()
    assert scene.told() == {"reason": "device lost", "written_by": "supervisor", "written_us": None}
    assert "stop frame NOT written" in scene.events()[-1]["text"]


def test_a_port_owner_that_does_not_answer_is_not_waited_for_long(scene: Scene) -> None:
    scene.gate_stops()
    assert scene.turn() == b""
    assert scene.next_ns() == scene.now_ns + 5 * MS, "to the moment"
    assert scene.turn(5 * MS - 1) == b"", "it has the first go"
    assert scene.turn(1) == BURST, "and the fault table promises 10 ms from the fault"
    assert STOP_ANSWER_NS == 5 * MS
    assert scene.told()["written_by"] == "supervisor"


@pytest.mark.parametrize("full", [False, True])
def test_without_a_port_owner_the_supervisor_writes_at_once_what_the_port_takes(alone: Scene, full: bool) -> None:
    alone.pass_time()
    if full:
        alone.wire.fill()
    alone.gate_stops()
    assert alone.pass_time() == (b"" if full else BURST)
    assert (alone.told()["written_us"] is None) is full


def test_a_run_that_nobody_can_find_stops_and_ends_when_that_is_answered(scene: Scene) -> None:
    scene.turn()
    scene.os.unlink(f"{RUNTIME_DIR}/stop")
    scene.turn(LOOK_EVERY_NS)
    assert scene.cause()[1] == "the stop pipe was removed: restart the service"
    assert (scene.supervisor.epochs.number, scene.supervisor.broken, scene.supervisor.ending) == (2, True, False)
    scene.answers(written_ns=scene.now_ns)
    scene.turn(MS)
    assert scene.supervisor.ending
    assert scene.told()["written_by"] == "port owner"


def test_a_turn_does_not_forget_that_it_was_told_to_end(scene: Scene) -> None:
    scene.supervisor.end(signal.SIGTERM, None)
    scene.turn(LOOK_EVERY_NS)
    assert scene.supervisor.ending
    assert not scene.supervisor.broken


def test_the_cause_is_there_before_the_epoch_and_ready_is_not() -> None:
    """A reader that sees the new epoch finds its cause; none finds the service ready in an epoch of a stop."""
    clear = "self.ready_word.set(0)"
    scene = Scene(patches=(("failstop.supervisor.latch", clear, f"self.look(); {clear}; self.look()"),))
    seen: list[tuple[int, int, int]] = []
    epochs = scene.supervisor.epochs
    epochs.look = lambda: seen.append((scene.number("latch"), scene.word("ready").get(), scene.word("epoch").get()))
    epochs.ready_word.set(1)
    scene.gate_stops()
    scene.pass_time()
    latched = scene.number("latch")
    assert seen == [(latched, 1, 1), (latched, 0, 1)]
    assert scene.word("epoch").get() == 2


def test_a_cause_that_comes_while_the_last_is_looked_at_is_not_slept_over(scene: Scene) -> None:
    """It rings after the rings were read: that ring must still wake the supervisor."""
    bells = scene.run.bells

    def then_another(_: Thread, call: str, about: tuple[Any, ...]) -> None:
        if call == "write" and about[0] == bells[layout.GATE].fd:
            scene.allow()
            scene.gate_stops("the second")
            bells[layout.SUPERVISOR].ring()

    scene.gate_stops("the first")
    bells[layout.SUPERVISOR].ring()
    scene.machine.at_seam = then_another
    scene.turn()
    assert scene.machine.at_seam is None
    assert bells[layout.SUPERVISOR].fd in scene.supervisor.loop.wait(0)


def test_a_reset_clears_the_first_cause_and_says_so_once_it_is_done(scene: Scene) -> None:
    scene.turn()
    scene.reset()
    assert scene.decided() == (True, "no stop is latched")
    assert scene.number("latch") == 0
    scene.stops("the first")
    scene.notice("the second", written_ns=scene.now_ns)
    scene.turn(MS)
    assert scene.cause() == (2, "the first")
    assert scene.supervisor.epochs.number == 3, "each is a stop of its own"
    scene.answers()
    scene.turn(MS)
    scene.reset()
    assert scene.decided() == (True, "latched stop cleared (was: stop request: the first); motion still disabled")
    assert scene.cause()[0] == 0
    assert scene.supervisor.epochs.number == 3


def test_a_reset_waits_for_the_stop_to_be_carried_out(scene: Scene) -> None:
    scene.gate_stops("the first")
    scene.turn()
    scene.ask_reset(scene.now_ns + MS)
    scene.turn(MS)
    assert scene.decided() is None
    scene.answers(written_ns=scene.now_ns)
    scene.turn(MS)
    decided = scene.decided()
    assert decided is not None
    assert decided[0]


def test_a_stop_and_a_reset_that_did_not_know_of_it(scene: Scene) -> None:
    """The supervisor latches the second stop, in whatever order it hears of the two."""
    scene.stops("the first")
    scene.ask_reset()
    scene.notice("the second", written_ns=scene.now_ns + MS)
    scene.turn(MS)
    scene.answers()
    scene.turn(MS)
    assert scene.decided() == (
        False,
        "asked before the last stop (stop request: the second): deal with that stop, then ask again",
    )
    assert scene.cause() == (2, "the first")
    scene.reset()
    scene.gate_stops("the third")
    scene.turn(MS)
    scene.answers()
    scene.turn(MS)
    assert scene.cause() == (4, "the third")
    for _ in range(2):
        scene.turn(START_NS)
    saved = [word for process in scene.born for word in process.argv if word.startswith("cause=")]
    assert [said(causes.read(bytes.fromhex(word[6:]))) for word in saved] == ["the first", "the third"]


def test_people_are_told_when_the_stop_is_out_and_not_before(scene: Scene) -> None:
    scene.gate_stops("multiple cmd_vel publishers")
    scene.notice("key1", written_ns=scene.now_ns + 50_000)
    scene.turn()
    assert scene.word("epoch").get() == 2
    assert scene.events() == [], "the port owner has not answered yet"
    scene.answers()
    scene.turn(MS)
    also, stop = scene.events()
    assert (also["kind"], also["fields"]) == (
        "stop_also",
        {
            "reason": str(why("multiple cmd_vel publishers")),
            "cause": "piped",
            "noticed_ns": scene.now_ns - MS,
            "noticed_by": "gate",
        },
    )
    assert (stop["kind"], stop["level"]) == ("stop", "warning")
    assert stop["fields"] == {
        "reason": "key1",
        "cause": "key",
        "noticed_ns": scene.now_ns - MS,
        "noticed_by": "port_owner",
        "written_by": "port owner",
        "latency_us": 50.0,
        "epoch": 2,
    }


def test_no_event_is_sent_before_the_burst(scene: Scene) -> None:
    seen: list[object] = []
    scene.wire.on_bytes = lambda data: seen.append(scene.events())
    scene.gate_stops("the first")
    scene.run.events.log("note", "from before")
    scene.turn()
    assert scene.events() == []
    scene.turn(STOP_ANSWER_NS)
    assert seen == [[]]
    assert scene.events()[0]["text"] == "from before"


def watched(scene: Scene) -> Any:
    """A service manager has started it, which nobody reaches; its Status."""
    scene.supervisor.status.notify = scene.load("failstop.notify").Notify("/nobody", 2)
    return scene.supervisor.status


def test_a_stop_that_stays_unwritten_is_what_the_watchdog_is_for(alone: Scene) -> None:
    """It bites only while there is a port to write the stop to."""
    status = watched(alone)
    alone.wire.fill()
    alone.gate_stops()
    alone.pass_time()
    alone.pass_time(OWED_NS - NOTIFY_EVERY_NS)
    assert status.fault == ""
    alone.pass_time(NOTIFY_EVERY_NS)
    assert status.fault == "a stop could not be written for 2 s"
    fd, alone.port.fd = alone.port.fd, -1
    alone.pass_time(NOTIFY_EVERY_NS)
    assert status.fault == "", "a port that is gone is nobody's fault"
    alone.port.fd = fd
    alone.wire.port.drain()
    alone.pass_time(ZERO_EVERY_NS)
    assert status.fault == "", "written at last"


def test_a_stop_that_the_port_owner_has_written_is_owed_no_more(scene: Scene) -> None:
    status = watched(scene)
    scene.stops("the first")
    scene.turn(OWED_NS)
    assert status.fault == ""


def test_a_killed_process_that_does_not_go_is_what_the_watchdog_is_for(scene: Scene) -> None:
    status = watched(scene)
    process = scene.employ(layout.TELEMETRY)
    telemetry = scene.supervisor.processes[layout.TELEMETRY]
    telemetry.on(KILLED)
    telemetry.fence = scene.load("failstop.supervisor.children").Fence(scene.now_ns, scene.now_ns, 0)
    scene.turn()
    assert status.fault == ""
    scene.turn(UNDYING_NS)
    assert status.fault == "telemetry was killed 10 s ago and is not gone"
    scene.dies(process)
    scene.turn(NOTIFY_EVERY_NS)
    assert status.fault == ""
