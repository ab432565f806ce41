"""A robot on a real broker: its connection, its state, its events, and a stop that a real service obeys."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from failstop import Robot
from failstop.api.events import Event
from failstop.fleet import levels, message, repeats, sender, signed, topics
from failstop.fleet.levels import StopAnswer
from failstop.policy import causes
from failstop_lab.trial import Trial
from tests.support import states
from tests.support.commands import FAILSTOP, failstop

from .conftest import Enrol, fleet_name
from .scene import Listener, Mosquitto, Pretended, pump


def said(listener: Listener, last: str) -> dict[str, Any]:
    """The newest message of the only robot."""
    for topic, payload in listener.last.items():
        if topic.endswith(f"/{last}"):
            found: dict[str, Any] = json.loads(payload)
            return found
    return {}


def word(listener: Listener) -> str:
    return str(said(listener, "state").get("word", ""))


def test_connection_state_and_end(enrol: Enrol, listener: Listener) -> None:
    robot = Pretended(states.state())
    publisher = enrol(robot=robot)
    both = (publisher, listener)
    pump("online", lambda: said(listener, "connection").get("connection") == "online", *both)
    pump("its state", lambda: word(listener) == "STOPPED", *both)
    robot.state = states.driving()
    pump("a change", lambda: word(listener) == "DRIVING", *both)
    robot.state = None
    pump("no service", lambda: word(listener) == "NO SERVICE", *both)
    publisher.close()
    pump("its end", lambda: said(listener, "connection")["connection"] == "offline", listener)


def test_what_is_retained_is_told_to_who_comes_later(enrol: Enrol, listener: Listener, broker: Mosquitto) -> None:
    publisher = enrol()
    pump("its state", lambda: word(listener), publisher, listener)
    topic = next(topic for topic in listener.last if topic.endswith("/state"))
    late = Listener(broker.settings(), topic)
    pump("what is retained", lambda: late.last, late)
    late.broker.close()


def test_a_velocity_is_no_news_of_each_look(enrol: Enrol, listener: Listener) -> None:
    robot = Pretended(states.driving())
    publisher = enrol(robot=robot)
    pump("its state", lambda: word(listener), publisher, listener)
    now_s = time.monotonic() + 100.0
    for number in range(30):  # 6 s of looks
        robot.state = states.driving(body_vel=(0.1 + 0.01 * number, 0.0, 0.0))
        publisher.look(now_s + 0.2001 * number)
    robot.state = states.state()
    publisher.look(now_s + 60.0)
    pump("a change", lambda: word(listener) == "STOPPED", publisher, listener)
    bodies = [json.loads(payload) for topic, payload in listener.all if topic.endswith("/state")]
    speeds = [body["velocity"]["vx_mps"] for body in bodies if body["moves"]]
    assert speeds == pytest.approx([0.2, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35], abs=0.011)


def test_events(enrol: Enrol, listener: Listener) -> None:
    robot = Pretended()
    robot.told = [Event(1, 1.0, 1, "stop", "warning", "gate died", {"cause": "died"})]
    publisher = enrol(robot=robot)
    pump("the event", lambda: said(listener, "event"), publisher, listener)
    found = said(listener, "event")
    assert (found["kind"], found["text"], found["fields"]) == ("stop", "gate died", {"cause": "died"})
    assert found["event_t"] == 1.0
    assert found["t"] > 1e9, "when it was published"


def test_the_answers_to_a_stop_go_before_the_state(enrol: Enrol, listener: Listener, key: str) -> None:
    """A thousand robots that told both at once would confirm later."""
    robot = Pretended()
    robot.proofs |= {"acknowledged_s": None, "observed_s": None}
    publisher = enrol(robot=robot)
    both = (publisher, listener)
    pump("its state", lambda: word(listener), *both)
    began_s = time.monotonic()
    publisher.hears(levels.Order("a" * 32, time.time(), "smoke", "ann").message(signed.read_key(key)))
    publisher.look(began_s + 0.6)
    assert robot.state
    assert robot.state.last_stop
    proved = dataclasses.replace(robot.state.last_stop, acknowledged_s=4e-3)
    robot.state = dataclasses.replace(robot.state, last_stop=proved)
    publisher.look(began_s + 0.9)
    publisher.look(began_s + 10.0)
    pump("the latch", lambda: said(listener, "state")["latched"], *both)
    told = [json.loads(payload) for topic, payload in listener.all if topic.endswith("/state")]
    assert told[1]["last_stop"]["acknowledged_s"] == 4e-3, "the first state since the stop"
    reached = [
        sorted(json.loads(json.loads(payload)["body"])["reached"])
        for topic, payload in listener.all
        if "/answer/" in topic
    ]
    assert reached == [["asked", "written"], ["acknowledged", "asked", "written"]]


def test_a_broker_that_was_away_is_told_all_anew(enrol: Enrol, listener: Listener, broker: Mosquitto) -> None:
    publisher = enrol()
    pump("its state", lambda: word(listener), publisher, listener)
    broker.kill()
    pump("the loss", lambda: publisher.broker.problem and listener.broker.problem, publisher, listener)
    listener.last.clear()
    broker.start()
    pump(
        "it to be online again", lambda: said(listener, "connection").get("connection") == "online", publisher, listener
    )
    pump("its state again", lambda: word(listener) == "DRIVING", publisher, listener)


@pytest.fixture(scope="module")
def trial() -> Iterator[Trial]:
    with Trial(f"fleet-{os.getpid()}") as running:
        yield running


@pytest.fixture
def options(broker: Mosquitto, key: str, tmp_path: Path, request: pytest.FixtureRequest) -> tuple[str, str]:
    """The options of every command of this test's fleet."""
    config = tmp_path / "fleet.toml"
    config.write_text(
        f"[broker]\nport = {broker.port}\nkeepalive_s = 2\n[robot]\nfleet = '{fleet_name(request)}'\nid = 'real'\n"
        f"publish_s = 0.5\n[stop]\nkey_file = '{key}'\n"
    )
    return "--config", str(config)


@contextlib.contextmanager
def publishing(name: str, options: tuple[str, str], listener: Listener) -> Iterator[subprocess.Popen[bytes]]:
    """`failstop fleet publish` beside a real service."""
    words = [*FAILSTOP, "fleet", "publish", "--name", name, *options]
    with subprocess.Popen(words, stderr=subprocess.DEVNULL) as process:
        try:
            pump("the robot", lambda: word(listener), listener)
            yield process
        finally:
            process.kill()


@pytest.fixture
def published(trial: Trial, options: tuple[str, str], listener: Listener) -> Any:
    """The publisher of a real service; gives the process and its options."""
    with publishing(trial.name, options, listener) as process:
        yield process, options


def test_a_real_robot_is_stopped_and_confirms_and_sigterm_ends_it_in_order(
    trial: Trial, published: Any, listener: Listener
) -> None:
    process, options = published
    trial.enable()
    trial.drive(0.2)
    assert trial.turning()
    command = [*FAILSTOP, "fleet", "stop", "smoke", "--by", "ann", "--json", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as done:
        while done.poll() is None:
            trial.drive(0.1)  # whoever drives goes on commanding
        assert done.stdout is not None
        found = json.load(done.stdout)
    assert (done.returncode, found["confirmed"], found["robots"], found["missing"]) == (0, 1, 1, {})
    for level in ("written", "acknowledged", "observed"):
        assert found[level]["robots"] == [f"real-{trial.name}"], level
    state = trial.robot.state
    assert state.cause == causes.FLEET("smoke", "ann")
    assert state.estop == "stop request: smoke (says it is the fleet, for ann)"
    assert not trial.turning()
    pump("the latch", lambda: said(listener, "state")["latched"], listener)
    again = failstop("fleet", "stop", "once more", *options)
    assert (again.returncode, again.stdout.splitlines()[0]) == (0, "1 of 1 robots have confirmed the stop")
    process.send_signal(signal.SIGTERM)
    assert process.wait(10) == 0
    pump("offline", lambda: said(listener, "connection")["connection"] == "offline", listener)


def test_a_robot_whose_wheels_turn_on_after_it_has_confirmed_is_not_stopped(trial: Trial, published: Any) -> None:
    """Its board acknowledges the stop and does not obey it."""
    _, options = published
    trial.robot.reset()
    trial.enable()
    trial.drive(1.0)
    trial.board.refuse_stop(True)
    with subprocess.Popen([*FAILSTOP, "fleet", "stop", "--json", *options], stdout=subprocess.PIPE) as done:
        while done.poll() is None:
            trial.drive(0.1)
        assert done.stdout is not None
        found = json.load(done.stdout)
    trial.board.refuse_stop(False)
    assert (done.returncode, found["complete"]) == (1, False)
    assert found["acknowledged"]["robots"] == [f"real-{trial.name}"]
    [why] = found["missing"].values()
    assert why.startswith("acknowledged, but: the robot moves")


def test_a_stop_that_a_dying_service_does_not_hear_reaches_the_next_run(
    options: tuple[str, str], listener: Listener
) -> None:
    """Its stop pipe can still be written, but nobody reads it."""
    with Trial(f"fleet-dies-{os.getpid()}") as running, publishing(running.name, options, listener):
        service = running.service.process
        assert service is not None
        service.send_signal(signal.SIGSTOP)
        command = [*FAILSTOP, "fleet", "stop", "smoke", "--by", "ann", "--wait", "60", *options]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL) as done:
            pump("the request", lambda: [topic for topic, _ in listener.all if "/answer/" in topic], listener)
            service.kill()
            service.wait()
            running.service.start()
            assert done.wait(60) == 0
        with Robot(running.name, client="test") as robot:
            assert robot.state.cause == causes.FLEET("smoke", "ann")


def test_a_killed_publisher_is_lost_and_an_ended_one_is_not(published: Any, listener: Listener) -> None:
    process, options = published
    process.kill()
    process.wait()
    pump("the last will", lambda: said(listener, "connection")["connection"] == "lost", listener)
    shown = failstop("fleet", "list", *options)
    assert "LOST" in shown.stdout
    done = failstop("fleet", "stop", "--wait", "1", *options)
    assert done.returncode == 1
    assert done.stdout.startswith("0 of 1 robots have confirmed the stop\n")
    assert "no answer: its connection is broken" in done.stdout


def test_without_a_broker_nobody_was_stopped(key: str, tmp_path: Path) -> None:
    config = tmp_path / "fleet.toml"
    config.write_text(f"[broker]\nport = 1\n[stop]\nkey_file = '{key}'\n")
    done = failstop("fleet", "stop", "--wait", "0.2", "--config", str(config))
    assert done.returncode == 1
    assert "NO ROBOT WAS STOPPED" in done.stderr
    assert done.stdout == ""


def test_the_rest_of_a_large_fleet_is_told_one_by_one(
    broker: Mosquitto, key: str, listener: Listener, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    """Nobody who has confirmed is asked once more; while most are missing, all are."""
    names = [f"r{number}" for number in range(3 * repeats.MANY)]
    listed = tmp_path / "robots"
    listed.write_text("\n".join(names))
    found = broker.settings(stop__key_file=key, robot__fleet=fleet_name(request), stop__robots_file=str(listed))
    for name in names:
        header = message.Header(fleet_name(request), name, "a" * 16)
        whole = header.message(topics.CONNECTION, message.connection(message.ONLINE), time.time())
        listener.broker.say(header.topic(topics.CONNECTION), whole, qos=0, retain=True)
    pump("their connections", lambda: len(listener.last) == len(names), listener)
    asking = sender.Sender(found, "smoke", "ann")
    first = topics.stop(fleet_name(request))
    pump("the stop", lambda: first in listener.last, asking.broker, listener)
    some = len(names) * 3 // 5
    for name in names[:some]:
        answer = StopAnswer(asking.id, name, dict.fromkeys((levels.ASKED, *levels.PROOFS), 0.0), publisher="a" * 16)
        listener.broker.say(topics.answer(fleet_name(request), asking.id, name), answer.message(signed.read_key(key)))
    confirmed = lambda: len(asking.tally.reached(levels.OBSERVED)) == some  # noqa: E731
    pump("the answers", lambda: asking.heard_all and confirmed(), asking.broker, listener)
    asking._send(time.monotonic())
    pump("the rest", lambda: f"{first}/{names[-1]}" in listener.last, asking.broker, listener)
    asking.broker.close()
    told = [topic.rpartition("/")[2] for topic, _ in listener.all if topic.startswith(f"{first}/")]
    assert sorted(set(told)) == sorted(names[some:])
    assert [topic for topic, _ in listener.all].count(first) == 1


@pytest.mark.parametrize("answers", [True, False])
def test_while_the_broker_may_hide_robots_a_repeated_stop_goes_to_all(
    answers: bool, broker: Mosquitto, key: str, listener: Listener, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    """A robot that nobody lists may be hidden, and may have come since the first sending."""
    listed = tmp_path / "robots"
    listed.write_text("r1")
    found = broker.settings(stop__key_file=key, robot__fleet=fleet_name(request), stop__robots_file=str(listed))
    asking = sender.Sender(found, "smoke", "ann")
    first = topics.stop(fleet_name(request))
    pump("the stop", lambda: first in listener.last and asking.heard_all, asking.broker, listener)
    if answers:
        listener.broker.say(
            topics.answer(fleet_name(request), asking.id, "r2"),
            StopAnswer(asking.id, "r2", {levels.ASKED: 0.0}, publisher="a" * 16).message(signed.read_key(key)),
        )
        pump("the answer", asking.tally.hidden, asking.broker, listener)
    listener.last.clear()
    asking._send(time.monotonic())
    pump("the stop", lambda: listener.last, asking.broker, listener)
    asking.broker.close()
    assert list(listener.last) == [first]
