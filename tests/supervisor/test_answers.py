"""What the supervisor does about a stop, and what it says of it: written only when somebody has written it."""

from __future__ import annotations

import os
import signal
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from failstop.board.burst import BURST
from failstop.policy import causes
from failstop.shm import instance, layout, segment
from failstop.shm.futex import PER_BLOCK
from failstop.shm.heartbeat import REALTIME
from failstop.supervisor import grant
from failstop.supervisor.children import WAITING, Fence
from failstop.supervisor.events import Outbox
from failstop.supervisor.main import ALONE_EVERY_NS, ANSWER_NS
from failstop.supervisor.run import LOOK_EVERY_NS
from failstop.supervisor.status import OWED_NS, TELL_EVERY_NS, UNDYING_NS, Notify
from failstop.supervisor.stops import Stop
from tests.support.supervisor_scene import MS, Scene
from tests.support.waiting import until
from tests.support.why import said, why


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Scene]:
    made = Scene(tmp_path, monkeypatch)
    yield made
    made.close()


def test_the_first_epoch_is_told_before_any_stop(scene: Scene) -> None:
    assert scene.word("epoch").get() == scene.supervisor.epoch == 1


def test_its_own_death_is_told_by_its_futexes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are of the thread that made it, which is a process's first one, and here one that ends."""
    made: list[Scene] = []
    thread = threading.Thread(target=lambda: made.append(Scene(tmp_path, monkeypatch)))
    thread.start()
    thread.join()
    (scene,) = made
    lifelines = segment.attach(scene.run.memory, "lifelines", scene.run.incarnation, write=True)
    words = [lifelines.futex("held", layout.SUPERVISOR_BLOCK * PER_BLOCK + index) for index in range(PER_BLOCK)]
    try:
        until(lambda: not any(word.held() for word in words), "the kernel has marked them")
        assert all(word.wait_for_death() for word in words)
    finally:
        lifelines.close()
        scene.close()


@pytest.mark.parametrize("granted", [0, REALTIME])
def test_what_helps_a_starved_service_depends_on_its_rights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, granted: int
) -> None:
    scene = Scene(tmp_path, monkeypatch, granted=granted)
    expected = grant.advice(realtime=bool(granted), managed=False)
    assert scene.supervisor.processes._advice == expected != grant.advice(realtime=not granted, managed=False)
    scene.close()


def test_what_people_are_told_goes_to_the_journal_where_there_is_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as journald:
        journald.bind(str(tmp_path / "journal"))
        journal = Outbox(str(tmp_path / "journal"))
        scene = Scene(tmp_path, monkeypatch, journal=journal)
        scene.supervisor._events.tell("note", "from the test")
        scene.supervisor._events.flush()
        assert b"MESSAGE=from the test\n" in journald.recv(65536, socket.MSG_DONTWAIT)
        assert capfd.readouterr().err == ""
        scene.close()
        journal.close()


def test_a_stop_that_the_port_owner_wrote(scene: Scene) -> None:
    scene.notice(written_ns=scene.now_ns + 50_000)
    assert scene.turn() == b""
    assert scene.supervisor.epoch == 2
    assert scene.word("epoch").get() == 2
    assert scene.word("ready").get() == 0
    scene.answers()
    assert scene.turn(MS) == b""
    assert scene.told() == {"reason": "key1", "written_by": "port owner", "written_us": 50.0}


def test_a_stop_that_the_port_owner_wrote_in_answer(scene: Scene) -> None:
    scene.gate_stops()
    scene.turn()
    scene.answers(written_ns=scene.now_ns + 80_000)
    assert scene.turn(MS) == b""
    assert scene.told()["written_us"] == 80.0
    assert scene.told()["written_by"] == "port owner"


def test_a_stop_that_the_port_owner_could_not_write_is_the_supervisor_s(scene: Scene) -> None:
    scene.notice("port trouble", written_ns=0)
    scene.turn()
    scene.answers()
    assert scene.turn(MS) == BURST
    assert scene.told() == {"reason": "port trouble", "written_by": "supervisor", "written_us": 1000.0}


def test_an_answer_without_a_new_burst_is_none(scene: Scene) -> None:
    """A port owner that has lost the port answers the epoch, and its last burst was long ago."""
    scene.gate_stops()
    scene.turn()
    scene.answers()
    assert scene.turn(MS) == BURST
    assert scene.told()["written_by"] == "supervisor"


def test_a_device_lost_is_said_to_be_not_written(scene: Scene) -> None:
    scene.answers(written_ns=scene.now_ns - MS)
    os.close(scene.master)
    scene.master = os.open("/dev/null", os.O_RDONLY)
    scene.notice("device lost", written_ns=0)
    scene.supervisor.turn(scene.supervisor.loop.wait(0))
    scene.answers()
    scene.supervisor.turn(scene.supervisor.loop.wait(0))
    assert scene.told() == {"reason": "device lost", "written_by": "supervisor", "written_us": None}
    assert "stop frame NOT written" in scene.events()[-1]["text"]


def test_a_port_owner_that_does_not_answer_is_not_waited_for_long(scene: Scene) -> None:
    scene.gate_stops()
    assert scene.turn() == b""
    assert scene.next_ns() == scene.now_ns + 5 * MS, "to the moment"
    assert scene.turn(5 * MS - 1) == b"", "it has the first go"
    assert scene.turn(1) == BURST, "and the fault table promises 10 ms from the fault"
    assert ANSWER_NS == 5 * MS
    assert scene.told()["written_by"] == "supervisor"


def test_without_a_port_owner_the_burst_is_written_at_once(scene: Scene) -> None:
    scene.supervisor.processes[layout.PORT_OWNER].state = WAITING
    scene.gate_stops()
    assert scene.turn() == BURST


def test_a_full_port_is_said_to_be_not_written(scene: Scene) -> None:
    scene.supervisor.processes[layout.PORT_OWNER].state = WAITING
    scene.fill()
    scene.gate_stops()
    scene.supervisor.turn({})
    assert scene.told()["written_us"] is None


def test_a_run_that_others_can_not_find_any_more_stops_and_ends_when_that_is_answered(scene: Scene) -> None:
    scene.turn()
    os.unlink(instance.stop_path(scene.run.runtime_dir))
    scene.turn(LOOK_EVERY_NS)
    assert scene.cause()[1] == "the stop pipe was removed: restart the service"
    assert (scene.supervisor.epoch, scene.supervisor.broken, scene.supervisor.ending) == (2, True, False)
    scene.answers(written_ns=scene.now_ns)
    scene.turn(MS)
    assert scene.supervisor.ending
    assert scene.told()["written_by"] == "port owner"


def test_a_turn_does_not_forget_that_it_was_told_to_end(scene: Scene) -> None:
    scene.supervisor.end(signal.SIGTERM, None)
    scene.turn(LOOK_EVERY_NS)
    assert scene.supervisor.ending
    assert not scene.supervisor.broken


def test_the_cause_is_there_before_the_epoch_and_ready_is_not(scene: Scene) -> None:
    """Whoever sees the new epoch finds its cause; and nobody finds the service ready in an epoch of a stop."""
    order: list[str] = []

    class Watched:
        def __init__(self, name: str, real: Any) -> None:
            self.name, self.real = name, real

        def set(self, value: int) -> None:
            order.append(f"{self.name} {value}")
            self.real.set(value)

        def write(self, payload: bytes) -> None:
            order.append(self.name)
            self.real.write(payload)

    epochs = scene.supervisor.epochs
    for attribute in ("_epoch_word", "ready_word", "_latch_record"):
        setattr(epochs, attribute, Watched(attribute, getattr(epochs, attribute)))
    scene.supervisor._raise_epoch([Stop(scene.now_ns, "gate", why("x"))])
    assert order == ["_latch_record", "ready_word 0", "_epoch_word 2"]


def test_a_cause_that_comes_while_the_last_is_looked_at_is_not_slept_over(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It rings after the rings were read: that ring must still wake the supervisor."""
    real = scene.supervisor._collect

    def then_another(*arguments: Any) -> list[Stop]:
        found = real(*arguments)
        if found:
            scene.gate_stops("the second")
            scene.run.bells[layout.SUPERVISOR].ring()
        return found

    monkeypatch.setattr(scene.supervisor, "_collect", then_another)
    scene.gate_stops("the first")
    scene.run.bells[layout.SUPERVISOR].ring()
    scene.turn()
    assert scene.run.bells[layout.SUPERVISOR].fd in scene.supervisor.loop.wait(0)


def test_the_first_cause_is_the_one_that_is_latched(scene: Scene) -> None:
    scene.gate_stops("the first")
    scene.turn()
    scene.answers(written_ns=scene.now_ns)
    scene.turn(MS)
    scene.notice("the second", written_ns=scene.now_ns)
    scene.turn(MS)
    assert scene.cause() == (2, "the first")
    assert scene.supervisor.epoch == 3, "each is a stop of its own"


def test_a_reset_clears_the_latch_and_says_so_once_it_is_done(scene: Scene) -> None:
    scene.gate_stops("the first")
    scene.turn()
    scene.answers(written_ns=scene.now_ns)
    scene.turn(MS)
    assert scene.cause() == (2, "the first")
    scene.ask_reset()
    scene.turn(MS)
    assert scene.decided() == (True, "latched stop cleared (was: stop request: the first); motion still disabled")
    assert scene.cause() == (0, "the first"), "it was the last stop"
    assert scene.supervisor.epoch == 2


def test_a_reset_before_any_stop_is_done_and_tells_of_none(scene: Scene) -> None:
    scene.turn()
    scene.ask_reset()
    scene.turn(MS)
    assert scene.decided() == (True, "no stop is latched")
    assert segment.attach(scene.run.memory, layout.SUPERVISOR).latest_reader("latch").read() is None


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
    """Whichever the supervisor hears first, the second stop is latched."""
    scene.gate_stops("the first")
    scene.turn()
    scene.answers(written_ns=scene.now_ns)
    scene.turn(MS)
    scene.ask_reset()
    scene.notice("the second", written_ns=scene.now_ns + MS)
    scene.turn(MS)
    scene.answers()
    scene.turn(MS)
    assert scene.decided() == (
        False,
        "asked before the last stop (stop request: the second): see to that, then ask again",
    )
    assert scene.cause() == (2, "the first")
    scene.reset()
    scene.gate_stops("the third")
    scene.turn(MS)
    scene.answers()
    scene.turn(MS)
    assert scene.cause() == (4, "the third")
    waiting = [bytes.fromhex(str(words["cause"])) for _, words in scene.supervisor.blackbox._waiting]
    assert [said(causes.read(cause)) for cause in waiting] == ["the first", "the third"]


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
        {"reason": str(why("multiple cmd_vel publishers")), "cause": "piped", "noticed_by": "gate"},
    )
    assert (stop["kind"], stop["level"]) == ("stop", "warning")
    assert stop["fields"] == {
        "reason": "key1",
        "cause": "key",
        "noticed_by": "port_owner",
        "written_by": "port owner",
        "latency_us": 50.0,
        "epoch": 2,
    }


def test_no_event_is_sent_before_the_burst(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a port owner that has died, and of one that does not answer."""
    order: list[str] = []
    real_burst, real_send = scene.supervisor._port.burst, scene.supervisor._events._send

    class Port:
        fd, number = scene.port.fd, scene.port.number

        def burst(self) -> bool:
            order.append("burst")
            return real_burst()

    def send(*told: Any) -> None:
        order.append("event")
        real_send(*told)

    scene.supervisor._port = Port()  # type: ignore[assignment]
    monkeypatch.setattr(scene.supervisor._events, "_send", send)
    scene.gate_stops("the first")
    scene.supervisor._events.tell("note", "from before")
    scene.turn()
    assert order == []
    scene.turn(ANSWER_NS)
    assert order[:2] == ["burst", "event"]


@pytest.mark.starts
def test_a_stop_that_stays_unwritten_is_what_the_watchdog_is_for(scene: Scene, tmp_path: Path) -> None:
    """And only while there is a port to write it to."""
    notify = Notify(str(tmp_path / "nobody"), 2)
    scene.supervisor.status.notify = notify
    scene.supervisor.processes[layout.PORT_OWNER].state = WAITING
    scene.fill()
    scene.gate_stops()
    scene.supervisor.turn({})
    scene.now_ns += OWED_NS - TELL_EVERY_NS
    scene.supervisor.turn({})
    assert scene.supervisor.status.fault == ""
    scene.now_ns += TELL_EVERY_NS
    scene.supervisor.turn({})
    assert scene.supervisor.status.fault == "a stop could not be written for 2 s"
    fd, scene.port.fd = scene.port.fd, -1
    scene.now_ns += TELL_EVERY_NS
    scene.supervisor.turn({})
    assert scene.supervisor.status.fault == "", "a port that is gone is nobody's fault"
    scene.port.fd = fd
    for _ in range(3):  # the first of them makes room
        scene.turn(ALONE_EVERY_NS)
    assert scene.supervisor.status.fault == "", "written at last"
    notify.close()


@pytest.mark.starts
def test_a_stop_that_the_port_owner_has_written_is_owed_no_more(scene: Scene, tmp_path: Path) -> None:
    notify = Notify(str(tmp_path / "nobody"), 2)
    scene.supervisor.status.notify = notify
    scene.gate_stops()
    scene.turn()
    scene.answers(written_ns=scene.now_ns)
    scene.turn(MS)
    scene.turn(OWED_NS)
    assert scene.supervisor.status.fault == ""
    notify.close()


def test_a_killed_process_that_does_not_go_is_what_the_watchdog_is_for(scene: Scene, tmp_path: Path) -> None:
    notify = Notify(str(tmp_path / "nobody"), 2)
    scene.supervisor.status.notify = notify
    telemetry = scene.supervisor.processes[layout.TELEMETRY]
    telemetry.pid, telemetry.fence = 2**31 - 1, Fence(scene.now_ns, scene.now_ns, 0)
    scene.turn()
    assert scene.supervisor.status.fault == ""
    scene.turn(UNDYING_NS)
    assert scene.supervisor.status.fault == "telemetry was killed 10 s ago and is not gone"
    telemetry.pid = 0
    scene.turn(TELL_EVERY_NS)
    assert scene.supervisor.status.fault == ""
    notify.close()
