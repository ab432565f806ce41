"""Attacks from the network on a stop of the fleet, each on a real broker."""

from __future__ import annotations

import dataclasses
import json
import threading
import time
from pathlib import Path

import pytest

from failstop.api.words import clock
from failstop.fleet import levels, message, signed, topics
from failstop.fleet.broker import HEAR_S
from failstop.fleet.levels import Order, StopAnswer
from failstop.fleet.publisher import Publisher
from failstop.fleet.replay import Seen
from failstop.fleet.sender import Sender
from failstop.fleet.settings import FleetSettings
from failstop.fleet.tally import MUTE, Tally
from tests.fleet.flood import packet
from tests.support import states

from . import scene
from .conftest import Enrol, fleet_name
from .scene import Listener, Mosquitto, Pretended, Robot, everywhere, pump

STOP_ID = "f" * 32


@pytest.fixture
def settings(broker: Mosquitto, key: str, request: pytest.FixtureRequest) -> FleetSettings:
    """Settings of the program that stops this test's fleet."""
    return broker.settings(stop__key_file=key, robot__fleet=fleet_name(request), robot__publish_s=0.5)


def stop_all(settings: FleetSettings, *robots: Publisher | Listener, wait_s: float = 10.0) -> Tally:
    """A stop by somebody else, while the robots go on."""
    return scene.stop_all(settings, *robots, wait_s=wait_s)[1].tally


def order(key: str, **changed: object) -> bytes:
    """A genuine stop, now, unless something else is said."""
    given = dataclasses.replace(Order(STOP_ID, time.time(), "smoke", "ann"), **changed)  # type: ignore[arg-type]
    return given.message(signed.read_key(key))


def answers(listener: Listener, key: str) -> list[StopAnswer]:
    found = [payload for topic, payload in listener.all if "/answer/" in topic]
    return [levels.read_answer(signed.read_key(key), payload) for payload in found]


def arrived(publisher: Robot, listener: Listener, topic: str, payload: bytes) -> None:
    """The robot has dealt with this message, and what it answered is heard: a broker keeps the order."""
    heard = publisher.heard
    listener.broker.say(topic, payload)
    pump("the message", lambda: publisher.heard > heard, publisher, listener)
    dealt = f"{topic}/dealt"
    listener.last.pop(dealt, None)
    publisher.broker.say(dealt, b"")
    pump("what the robot answered", lambda: dealt in listener.last, publisher, listener)


def test_all_confirm(enrol: Enrol, settings: FleetSettings) -> None:
    robots = [Pretended() for _ in range(3)]
    publishers = [enrol(f"r{number}", robot) for number, robot in enumerate(robots)]
    tally = stop_all(settings, *publishers)
    assert everywhere(tally, levels.OBSERVED)
    assert tally.robots() == ["r0", "r1", "r2"]
    assert [robot.asked for robot in robots] == [[("smoke", "ann")]] * 3, "once, however often it was sent"


def test_a_replayed_stop(enrol: Enrol, listener: Listener, settings: FleetSettings) -> None:
    robot = Pretended()
    publisher = enrol(robot=robot)
    stop_all(settings, publisher, listener)
    topic, recorded = next((topic, payload) for topic, payload in listener.all if topic.endswith("/stop"))
    robot.state = states.driving(epoch=9)
    arrived(publisher, listener, topic, recorded)
    assert len(robot.asked) == 1


def test_a_replayed_stop_after_a_restart(enrol: Enrol, listener: Listener, settings: FleetSettings) -> None:
    first = enrol("r1")
    stop_all(settings, first, listener)
    pump("what is remembered to be written", lambda: not first.unsaved, first)
    first.broker.close()
    topic, recorded = next((topic, payload) for topic, payload in listener.all if topic.endswith("/stop"))
    robot = Pretended()
    again = enrol("r1", robot)
    arrived(again, listener, topic, recorded)
    assert robot.asked == []


@pytest.mark.parametrize(("off_s", "words"), [(-60.0, "old by 60 s"), (3700.0, "ahead by 1 h 1 min")])
def test_an_old_one_and_one_of_the_future(
    enrol: Enrol, listener: Listener, key: str, settings: FleetSettings, off_s: float, words: str
) -> None:
    """One each: of two that come soon after each other a robot refuses the second without a word."""
    robot = Pretended()
    topic = topics.stop(settings.text("robot.fleet"))
    arrived(enrol(robot=robot), listener, topic, order(key, unix_s=time.time() + off_s))
    (answer,) = answers(listener, key)
    assert list(answer.reached) == [levels.REFUSED]
    assert words in answer.why
    assert robot.asked == []


def test_a_retained_stop_waits_for_nobody(
    enrol: Enrol, listener: Listener, key: str, settings: FleetSettings, broker: Mosquitto
) -> None:
    topic = topics.stop(settings.text("robot.fleet"))
    listener.broker.say(topic, order(key, unix_s=time.time() - 20), retain=True)
    pump("it to be kept", lambda: listener.all, listener)
    robot = Pretended()
    publisher = enrol(robot=robot)
    pump("the robot's answer", lambda: answers(listener, key), publisher, listener)
    assert robot.asked == []
    listener.broker.say(topic, b"", retain=True)
    listener.turn(0.05)


def test_another_key(enrol: Enrol, listener: Listener, settings: FleetSettings, tmp_path: Path) -> None:
    robot = Pretended()
    publisher = enrol(robot=robot)
    signed.make_key(str(tmp_path / "other"))
    arrived(publisher, listener, topics.stop(settings.text("robot.fleet")), order(str(tmp_path / "other")))
    assert robot.asked == []
    assert not [topic for topic, _ in listener.all if "/answer/" in topic], "nobody is answered who can't sign"

    def warned() -> bool:
        shown = [json.loads(payload) for topic, payload in listener.all if topic.endswith("/state")]
        return any(row["kind"] == "forged_stop" for body in shown for row in body["errors"])

    pump("the warning", warned, publisher, listener)


@pytest.mark.parametrize("payload", [b"", b"stop", b"\xff" * 100, b"{}" + b" " * 5000, b'{"body": "{}", "mac": "00"}'])
def test_nonsense(enrol: Enrol, listener: Listener, settings: FleetSettings, payload: bytes) -> None:
    robot = Pretended()
    publisher = enrol(robot=robot)
    arrived(publisher, listener, topics.stop(settings.text("robot.fleet")), payload)
    assert robot.asked == []
    assert everywhere(stop_all(settings, publisher), levels.OBSERVED), "and a genuine one is obeyed"


def test_a_flood(enrol: Enrol, broker: Mosquitto, key: str, settings: FleetSettings) -> None:
    """Messages look like stops, come from a sender without a key, and go on coming."""
    robot = Pretended()
    publisher = enrol(robot=robot)
    topic = topics.stop(settings.text("robot.fleet"))
    junk = order(key)[:-4] + b'00"}'
    flooder = Listener(settings, "nothing")
    pump("the flooder", lambda: not flooder.broker.problem, flooder)
    ended = threading.Event()

    def flood() -> None:
        while not ended.is_set():
            for _ in range(50):
                flooder.broker.say(topic, junk, qos=0)
            flooder.turn(0.0)

    flooding = threading.Thread(target=flood)
    flooding.start()
    try:
        pump("the flood", lambda: publisher.duties.forged > 500, publisher)
        tally = stop_all(settings, publisher)
    finally:
        ended.set()
        flooding.join()
        flooder.broker.close()
    assert everywhere(tally, levels.OBSERVED)
    assert len(robot.asked) == 1


def test_of_a_pile_the_newest_is_heard_first(enrol: Enrol, key: str) -> None:
    """The rest is left when the time for one turn is over."""
    robot = Pretended()
    broker = enrol(robot=robot).broker
    ticks = iter(range(100))
    pile = [order(key, id=f"{number:032x}", reason=str(number)) for number in range(10)]
    broker.client.wire.feed(b"".join(packet("t", payload, 0) for payload in pile))
    broker.deliver(lambda: next(ticks) * HEAR_S / 3)
    assert [reason for reason, _ in robot.asked] == ["9", "8", "7", "6"]
    assert broker.client.wire.messages() == []


def test_a_message_of_twenty_megabytes(enrol: Enrol, listener: Listener, settings: FleetSettings) -> None:
    robot = Pretended()
    publisher = enrol(robot=robot)
    wire = publisher.broker.client.wire
    listener.broker.say(topics.stop(settings.text("robot.fleet")), bytes(20_000_000), qos=0)
    pump("it to be skipped", lambda: wire.skipped, publisher, listener)
    assert publisher.broker.client.wire is wire, "on the same connection"
    assert everywhere(stop_all(settings, publisher), levels.OBSERVED), "and a genuine one is obeyed"


def test_a_forged_confirmation(enrol: Enrol, listener: Listener, settings: FleetSettings, tmp_path: Path) -> None:
    """The sender sees the stop's id and has no key; another confirmation is of an earlier stop, recorded."""
    signed.make_key(str(tmp_path / "other"))
    other = signed.read_key(str(tmp_path / "other"))
    fleet = settings.text("robot.fleet")
    key = signed.read_key(settings.text("stop.key_file"))
    enrol().broker.close()
    sender = Sender(settings, "smoke", "ann")
    done = dict.fromkeys((levels.ASKED, *levels.PROOFS), 0.0)
    topic = topics.answer(fleet, sender.id, "r1")
    recorded = StopAnswer(STOP_ID, "r1", done).message(key)
    running = threading.Thread(daemon=True, target=sender.run, args=(1.0,))
    running.start()
    while running.is_alive():
        listener.broker.say(topic, StopAnswer(sender.id, "r1", done).message(other))
        listener.broker.say(topic, recorded)
        listener.turn(0.02)
    assert sender.sent_s is not None
    assert [row.robot for row in sender.tally.missing()] == ["r1"]


def test_somebody_takes_a_robot_off_the_broker(
    enrol: Enrol, listener: Listener, settings: FleetSettings, broker: Mosquitto, key: str, tmp_path: Path
) -> None:
    """Nobody misses it without a list; with one it is missed."""
    fleet = settings.text("robot.fleet")
    publisher = enrol("r1")
    enrol("r2").broker.close()
    kept = topics.of_robot(fleet, "r2", topics.CONNECTION)
    listener.broker.say(kept, b"", retain=True)
    pump("it to be taken off", lambda: listener.last.get(kept) == b"", listener)
    assert stop_all(settings, publisher).missing() == []
    names = tmp_path / "robots"
    names.write_text("r1\nr2  # the one in hall 2\n")
    listed = broker.settings(stop__key_file=key, robot__fleet=fleet, stop__robots_file=str(names))
    assert [row.robot for row in stop_all(listed, publisher, wait_s=1.0).missing()] == ["r2"]


def test_the_broker_goes_and_comes_back(enrol: Enrol, settings: FleetSettings, broker: Mosquitto) -> None:
    robot = Pretended()
    publisher = enrol(robot=robot)
    broker.kill()
    pump("the loss", lambda: publisher.broker.problem, publisher)
    sender = Sender(settings, "smoke", "ann")
    running = threading.Thread(daemon=True, target=sender.run, args=(20.0,))
    running.start()
    pump("an attempt in vain", lambda: sender.broker.problem.startswith("no broker"), publisher)
    broker.start()
    while running.is_alive():
        publisher.turn(0.005)
    assert everywhere(sender.tally, levels.OBSERVED)
    assert len(robot.asked) == 1


def test_a_robot_that_comes_late_is_stopped_too(enrol: Enrol, settings: FleetSettings, key: str) -> None:
    """The robot was away when the stop was sent, and the broker knows of it."""
    enrol("r2").close()
    here = enrol("r1")
    sender = Sender(settings, "smoke", "ann")
    running = threading.Thread(daemon=True, target=sender.run, args=(20.0,))
    running.start()
    pump("the first to confirm", lambda: sender.tally.reached(levels.ACKNOWLEDGED) == ["r1"], here)
    late = Pretended()
    publisher = enrol("r2", late)
    while running.is_alive():
        publisher.turn(0.005)
        here.turn(0.005)
    assert sender.tally.missing() == []
    assert len(late.asked) == 1


def test_no_key_on_the_robot_is_said_and_missed(
    enrol: Enrol, listener: Listener, settings: FleetSettings, tmp_path: Path
) -> None:
    robot = Pretended()
    publisher = enrol(robot=robot, stop__key_file=str(tmp_path / "none"))

    def said() -> bool:
        shown = [json.loads(payload) for topic, payload in listener.all if topic.endswith("/state")]
        return any(row["kind"] == "fleet_stop_off" for body in shown for row in body["errors"])

    pump("the warning", said, publisher, listener)
    tally = stop_all(settings, publisher, wait_s=1.0)
    assert [row.why for row in tally.missing()] == [f"no answer, though the broker calls it connected: {MUTE}"]
    assert robot.asked == []


def test_a_service_that_is_not_there_is_no_confirmation(enrol: Enrol, settings: FleetSettings) -> None:
    robot = Pretended()
    robot.state, robot.problem = None, "no service named 'failstop' is running"
    tally = stop_all(settings, enrol(robot=robot), wait_s=1.0)
    assert [row.why for row in tally.missing()] == ["failed: no service named 'failstop' is running"]
    assert len(robot.asked) > 1, "it is tried again"


def test_a_store_that_can_not_be_written_keeps_nobody_from_stopping(
    enrol: Enrol, settings: FleetSettings, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    robot = Pretended()
    publisher = enrol(robot=robot)
    (tmp_path / "r1").rename(tmp_path / "away")
    assert everywhere(stop_all(settings, publisher), levels.OBSERVED)
    pump("the complaint", lambda: not publisher.unsaved, publisher)
    assert "a restart forgets which stops were obeyed" in " ".join(capsys.readouterr().err.split())


def test_a_robot_whose_clock_was_set_back_says_that_it_refuses_stops(
    enrol: Enrol, settings: FleetSettings, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """It has obeyed stops while its clock was ahead. Once its file is removed, as it says, it obeys again."""
    seen, ahead_s = Seen(10.0), time.time() + 3600.0
    for number in range(2):
        seen.obeyed(f"{number}" * 32, ahead_s + 11.0 * number, ahead_s + 11.0 * number)
    store = tmp_path / "r1" / "fleet-stops.json"
    store.parent.mkdir()
    store.write_bytes(seen.dump())
    robot = Pretended()
    refusing = enrol("r1", robot)
    assert refusing.deaf() == (
        f"it refuses every fleet stop until {clock(ahead_s)}, because its clock was set back: once the clock is right, "
        f"remove {store} and restart the publisher"
    )
    [error] = [row for row in refusing.own_errors(0.0) if row["kind"] == message.FLEET_STOP_OFF]
    assert error["text"] == refusing.deaf()
    refusing.turn(0.0)
    assert "WARNING: this robot obeys no fleet stop: it refuses" in " ".join(capsys.readouterr().err.split())
    assert not stop_all(settings, refusing, wait_s=0.5).all_confirmed()
    refusing.close()

    store.unlink()
    again = enrol("r1", robot)
    assert (again.deaf(), robot.asked) == ("", [])
    assert stop_all(settings, again).all_confirmed()


@pytest.mark.parametrize("data", [b"", b"nonsense", b'{"ids": 3}', b'{"ids": {}, "floor_s": 1e300}'])
def test_a_damaged_store_keeps_nobody_from_stopping(
    enrol: Enrol, settings: FleetSettings, tmp_path: Path, data: bytes
) -> None:
    (tmp_path / "r1").mkdir()
    (tmp_path / "r1" / "fleet-stops.json").write_bytes(data)
    robot = Pretended()
    assert everywhere(stop_all(settings, enrol(robot=robot)), levels.OBSERVED)
    assert len(robot.asked) == 1


def test_two_senders_at_once(enrol: Enrol, settings: FleetSettings) -> None:
    robot = Pretended()
    publisher = enrol(robot=robot)
    senders = [Sender(settings, f"reason {number}", "ann") for number in range(2)]
    threads = [threading.Thread(daemon=True, target=sender.run, args=(10.0,)) for sender in senders]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        publisher.turn(0.005)
    assert all(everywhere(sender.tally, levels.ACKNOWLEDGED) for sender in senders)
    assert len(robot.asked) == 2
