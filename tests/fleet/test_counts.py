"""A full count while a robot is not stopped: every way that is known, at a stand-in of a broker, and at a real one
where there is one. `python -m tests.fleet.trials` has more of them, drawn, with the command that people use."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from failstop.fleet import FleetError, message, signed, topics
from failstop.fleet.sender import Sender
from failstop.fleet.settings import FleetSettings
from failstop.fleet.tally import DOUBLED
from failstop_lab.trial import wait_for

from .scene import LONG_AGO_S, MOSQUITTO, Listener, Mosquitto, Pretended, Robot, mosquitto, pump, stop_all
from .standin import Standin

FLEET = "failstop"
OPERATOR = "operator"
BLIND = f"user {OPERATOR}\ntopic readwrite failstop/v1/+/stop/#\ntopic readwrite failstop/v1/+/answer/#\n"
BLIND += "pattern readwrite failstop/v1/failstop/robot/%u/#\n"
BLIND += "pattern read failstop/v1/+/stop/#\npattern write failstop/v1/+/answer/#\n"
PUBLISH_S = 0.5
Start = Callable[..., "Standin | Mosquitto"]


def may_not_see_connections(user: str, topic: str) -> bool:
    """As BLIND has it."""
    return user != OPERATOR or not topic.endswith("/connection")


@pytest.fixture(params=["stand-in", "mosquitto"])
def start(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Start]:
    """Start a broker of that kind."""
    if request.param == "mosquitto" and MOSQUITTO is None:
        pytest.skip("needs mosquitto: `make fleet` installs it")
    with contextlib.ExitStack() as stack:

        def started(*, blind: bool = False, users_are_clients: bool = False) -> Standin | Mosquitto:
            if request.param == "mosquitto":
                (tmp_path / "list").write_text(BLIND)
                (tmp_path / "list").chmod(0o600)
                lines = [f"acl_file {tmp_path / 'list'}"] * blind
                lines += ["use_username_as_clientid true"] * users_are_clients
                return stack.enter_context(mosquitto(tmp_path, "allow_anonymous true", *lines))
            seen = may_not_see_connections if blind else lambda _user, _topic: True
            made = Standin(seen, users_are_clients=users_are_clients)
            made.start()
            stack.callback(made.kill)
            return made

        yield started


@pytest.fixture
def enrol(key: str, tmp_path: Path) -> Iterator[Callable[..., Robot]]:
    """Connect a pretended robot, as if it had been connected for long, unless it is `new`. `connect`: wait for that."""
    made: list[Robot] = []

    def publish(
        broker: Standin | Mosquitto,
        name: str,
        robot: Pretended,
        *,
        new: bool = False,
        connect: bool = True,
        **changed: object,
    ) -> Robot:
        given = {"stop__key_file": key, "robot__publish_s": PUBLISH_S, "broker__user": name, **changed}
        folder = tmp_path / f"robot-{len(made)}"
        folder.mkdir()
        made.append(Robot(broker.settings(**given), "failstop", robot, name, str(folder)))
        if not connect:
            return made[-1]
        pump(f"{name} to be connected", lambda: made[-1].broker.listening, made[-1])
        made[-1].broker.up_s -= 0.0 if new else LONG_AGO_S
        return made[-1]

    yield publish
    for publisher in made:
        publisher.broker.close()


def operator(broker: Standin | Mosquitto, key: str, **changed: object) -> Any:
    """The settings of the program that stops the fleet."""
    return broker.settings(broker__user=OPERATOR, stop__key_file=key, robot__publish_s=PUBLISH_S, **changed)


def test_a_healthy_fleet_has_a_full_count(start: Start, enrol: Any, key: str) -> None:
    """A sender that never confirms would pass all tests below."""
    broker = start()
    robots = [enrol(broker, name, Pretended()) for name in ("r1", "r2")]
    complete, sender = stop_all(operator(broker, key), *robots)
    assert (complete, sender.doubts, sender.tally.missing()) == (True, (), [])
    assert sender.tally.robots() == ["r1", "r2"]


@pytest.mark.parametrize("hangs", [False, True])
def test_two_robots_of_one_name_are_never_confirmed(
    start: Start, enrol: Any, key: str, capsys: pytest.CaptureFixture[str], *, hangs: bool
) -> None:
    """Both are stopped if they can be, and both publishers name the remedy."""
    broker = start()
    robots = [Pretended(), Pretended()]
    publishers = [enrol(broker, "r1", robot) for robot in robots]
    pump("both to know", lambda: all(each.doubled() for each in publishers), *publishers)
    for each in publishers:
        each.turn(0.0)
        [error] = [row for row in each.own_errors(0.0) if row["kind"] == message.DOUBLED]
        assert error["text"].endswith("also calls itself r1: set robot.id on one, restart both")
    said = " ".join(capsys.readouterr().err.split())
    assert said.count("WARNING: another publisher also calls itself r1") == 2
    assert said.count("give each robot its own robot.id in /etc/failstop/fleet/fleet.toml") == 2
    complete, sender = stop_all(operator(broker, key), *publishers[: 1 if hangs else 2], wait_s=1.0)
    assert not complete
    assert [(row.robot, row.why) for row in sender.tally.missing()] == [("r1", DOUBLED)]
    assert [bool(robot.asked) for robot in robots] == [True, not hangs]


def test_two_robots_that_throw_each_other_off_the_broker_are_never_confirmed(
    start: Start, enrol: Any, key: str
) -> None:
    """A broker may take a client's user for its name: then one of the two is connected at a time."""
    broker = start(users_are_clients=True)
    publishers = [enrol(broker, "r1", Pretended(), new=True) for _ in range(2)]
    complete, sender = stop_all(operator(broker, key), *publishers, wait_s=3.0)
    assert not complete
    assert sender.doubts or [row.robot for row in sender.tally.missing()] == ["r1"]
    pump("both to know", lambda: all(each.doubled() for each in publishers), *publishers)


def test_a_robot_that_has_just_connected_may_have_taken_its_twin_s_place(start: Start, enrol: Any, key: str) -> None:
    """That one is not back yet, and another robot's connection shows that the broker has run for long."""
    broker = start(users_are_clients=True)
    other = enrol(broker, "r0", Pretended())
    away, here = (enrol(broker, "r1", Pretended(), new=True) for _ in range(2))
    complete, sender = stop_all(operator(broker, key), other, here, wait_s=0.5)
    assert not complete
    assert sender.tally.missing() == []
    [doubt] = sender.doubts
    assert doubt.startswith("r1 connected less than 2 s before it answered")
    pump("the other one to know", away.doubled, away, here)


def test_a_robot_remembers_its_twin_that_was_lost(start: Start, enrol: Any, key: str) -> None:
    """That one may be driving still, and nobody else remembers it."""
    broker = start()
    first, second = (enrol(broker, "r1", Pretended()) for _ in range(2))
    pump("both to know", lambda: first.doubled() and second.doubled(), first, second)
    second.broker.drop()
    complete, sender = stop_all(operator(broker, key), first, wait_s=1.0)
    assert not complete
    assert [row.why for row in sender.tally.missing()] == [DOUBLED]


def test_a_publisher_that_is_started_again_has_no_twin(start: Start, enrol: Any, key: str) -> None:
    """Whichever way the first one ended: cleanly, or with a last will."""
    broker = start()
    for end in ("close", "drop"):
        first = enrol(broker, "r1", Pretended())
        first.close() if end == "close" else first.broker.drop()
        again = enrol(broker, "r1", Pretended())
        complete, sender = stop_all(operator(broker, key), again)
        assert (complete, again.doubled(), sender.tally.missing()) == (True, "", []), end
        again.close()


def unread(robot: Robot) -> bytes:
    """What has come from the broker, and stays there."""
    with socket.socket(fileno=os.dup(robot.broker.fileno())) as found, contextlib.suppress(BlockingIOError):
        return found.recv(1 << 16, socket.MSG_PEEK | socket.MSG_DONTWAIT)
    return b""


def test_a_publisher_has_no_twin_in_the_one_before_it(start: Start, enrol: Any, key: str) -> None:
    """The end of the last publisher is dated later than the start of the next one: dates are rounded, and clocks are
    set. All that the broker says to the new publisher comes at once, and the newest is heard first."""
    broker = start()
    topic = topics.of_robot(FLEET, "r1", topics.CONNECTION)
    header, ended = message.Header(FLEET, "r1", "e" * 16), message.connection(message.OFFLINE)
    ending = header.message("connection", ended, time.time() + 60.0)
    somebody = Listener(broker.settings(), topic)
    pump("the listener", lambda: somebody.broker.listening, somebody)
    somebody.broker.say(topic, ending, retain=True)
    pump("the end of the last publisher", lambda: somebody.last, somebody)

    robot = enrol(broker, "r1", Pretended(), connect=False)
    pump("its connection", lambda: not robot.broker.problem, robot)
    robot.broker.up_s -= LONG_AGO_S
    wait_for("the broker to pass on its own message", lambda: robot.number.encode() in unread(robot))
    pump("all of that to be heard", lambda: robot.broker.listening, robot)
    assert robot.doubled() == ""
    complete, sender = stop_all(operator(broker, key), robot)
    assert (complete, sender.tally.missing()) == (True, [])
    somebody.broker.close()


def test_a_last_will_that_comes_late_is_put_right(start: Start, enrol: Any, key: str) -> None:
    """The broker takes the connection of a robot that lost its power for alive until its keepalive is over."""
    broker = start()
    gone = enrol(broker, "r1", Pretended())
    listener = Listener(broker.settings(), topics.of_robot(FLEET, "r1", topics.CONNECTION))
    pump("the listener", lambda: listener.last, listener)
    back = enrol(broker, "r1", Pretended())
    gone.broker.drop()

    def words() -> list[str]:
        return [json.loads(payload)["connection"] for _, payload in listener.all]

    pump("the will, and the answer to it", lambda: words()[-2:] == ["lost", "online"], listener, back)
    assert back.doubled() == ""
    listener.broker.close()


def test_a_connection_that_somebody_removes_is_said_again(start: Start, enrol: Any) -> None:
    broker = start()
    robot = enrol(broker, "r1", Pretended())
    topic = topics.of_robot(FLEET, "r1", topics.CONNECTION)
    somebody = Listener(broker.settings(), topic)
    pump("its connection", lambda: somebody.last, somebody)
    somebody.broker.say(topic, b"", retain=True)
    pump("it to be taken away", lambda: somebody.last[topic] == b"", somebody)
    pump("it to be said again", lambda: somebody.last[topic], somebody, robot)
    assert json.loads(somebody.last[topic])["connection"] == message.ONLINE
    somebody.broker.close()


def test_an_access_list_that_hides_connections_is_said(start: Start, enrol: Any, key: str) -> None:
    """The other robot is not counted: it is dead, and nobody says that it exists."""
    broker = start(blind=True)
    here, gone = (enrol(broker, name, Pretended()) for name in ("r1", "r2"))
    gone.broker.drop()
    complete, sender = stop_all(operator(broker, key), here)
    assert not complete
    [doubt] = sender.doubts
    assert doubt.startswith("r1 answered, but the broker does not show you its connection")
    assert "must let you read failstop/v1/failstop/robot/+/connection" in doubt


def test_a_sender_that_can_not_know_who_is_still_to_come_says_so(start: Start, enrol: Any, key: str) -> None:
    """The broker has forgotten the third robot, which has not connected again yet."""
    broker = start()
    robots = [Pretended() for _ in range(3)]
    publishers = [enrol(broker, f"r{number}", robot) for number, robot in enumerate(robots)]
    broker.kill()
    pump("the loss", lambda: all(each.broker.problem for each in publishers), *publishers)
    broker.start()
    pump("two of them", lambda: all(each.broker.listening for each in publishers[:2]), *publishers[:2])
    complete, sender = stop_all(operator(broker, key), *publishers[:2], wait_s=1.0)
    assert not complete
    assert sender.tally.missing() == []
    [doubt] = sender.doubts
    assert doubt.startswith("the broker may have been restarted less than 10 s ago")


@pytest.mark.slow
def test_a_sender_waits_for_a_robot_that_is_still_to_come(start: Start, enrol: Any, key: str) -> None:
    """Without a limit of its user's."""
    broker = start()
    robots = [Pretended() for _ in range(3)]
    publishers = [enrol(broker, f"r{number}", robot) for number, robot in enumerate(robots)]
    broker.kill()
    pump("three attempts in vain", lambda: publishers[2].broker._wait_s >= 4.0, *publishers)
    broker.start()
    pump("two of them", lambda: all(each.broker.listening for each in publishers[:2]), *publishers[:2])
    complete, sender = stop_all(operator(broker, key), *publishers, wait_s=None)
    assert (complete, sender.doubts) == (True, ())
    assert sender.tally.robots() == ["r0", "r1", "r2"]
    assert all(robot.asked for robot in robots)


def test_an_old_list_hides_nobody(start: Start, enrol: Any, key: str, tmp_path: Path) -> None:
    broker = start()
    here = enrol(broker, "r1", Pretended())
    signed.make_key(str(tmp_path / "other"))
    mute = enrol(broker, "x2", Pretended(), stop__key_file=str(tmp_path / "other"))
    names = tmp_path / "robots"
    names.write_text("r1\n")
    complete, sender = stop_all(operator(broker, key, stop__robots_file=str(names)), here, mute, wait_s=1.0)
    assert not complete
    assert [row.robot for row in sender.tally.missing()] == ["x2"]


def empty(names: Path) -> None:
    names.write_text("\n# r1\n")


def misspelt(names: Path) -> None:
    names.write_text("r1\nr 2\n")


def not_text(names: Path) -> None:
    names.write_bytes(b"\xff\n")


def missing(_names: Path) -> None:
    pass


@pytest.mark.parametrize(
    ("flaw", "says"),
    [
        (empty, "lists no robot: write one name per line into it, or leave stop.robots_file empty"),
        (misspelt, "'r 2' can't be a robot's name"),
        (not_text, "'utf-8' codec can't decode"),
        (missing, "No such file or directory"),
        (os.mkfifo, "a FIFO, not a regular file"),
    ],
)
def test_a_list_with_a_flaw_keeps_no_robot_from_the_stop(
    start: Start, enrol: Any, key: str, tmp_path: Path, flaw: Callable[[Path], None], says: str
) -> None:
    """It is only for counting: what the broker knows is counted, and the flaw is a reason to look for more robots."""
    flaw(names := tmp_path / "robots")
    broker = start()
    robot = Pretended()
    here = enrol(broker, "r1", robot)
    complete, sender = stop_all(operator(broker, key, stop__robots_file=str(names)), here)
    assert len(robot.asked) == 1
    assert (complete, sender.listed, sender.tally.missing()) == (False, False, [])
    [doubt] = sender.doubts
    assert doubt.startswith(f"stop.robots_file {names}")
    assert says in doubt


def test_without_a_broker_a_flaw_in_the_list_is_not_what_is_said(key: str, tmp_path: Path) -> None:
    found = FleetSettings({"broker.port": 1, "stop.key_file": key, "stop.robots_file": str(tmp_path / "missing")})
    with pytest.raises(FleetError, match="NO ROBOT WAS STOPPED: no broker at"):
        Sender(found, "smoke", "ann").run(0.1)
