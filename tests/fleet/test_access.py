"""Rights at a broker: the access list of docs/fleet.md, and a robot that may not hear the stops."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.fleet import levels, message, topics
from failstop.fleet.publisher import Publisher
from failstop.fleet.sender import Sender
from tests.support.commands import failstop
from tests.support.pages import ROOT

from .scene import LONG_AGO_S, MOSQUITTO, Listener, Mosquitto, Pretended, everywhere, mosquitto, pump, stop_all

PASSWORDS = shutil.which("mosquitto_passwd")
PLUGIN = next(iter(Path("/usr/lib").glob("*/mosquitto_dynamic_security.so")), None)
FLEET = "failstop"
"""The fleet's name in the page's access list."""
USERS = ("r1", "r2", "operator")
pytestmark = pytest.mark.skipif(MOSQUITTO is None or PASSWORDS is None, reason="needs mosquitto: `make fleet`")


def access_list() -> str:
    """The access list as the page has it."""
    [found] = re.findall(r"```text\n(pattern .*?)```", (ROOT / "docs/fleet.md").read_text(), re.DOTALL)
    return str(found)


@pytest.fixture
def guarded(tmp_path: Path) -> Iterator[Mosquitto]:
    """A broker with a password for each, and the page's access list."""
    assert PASSWORDS is not None
    stored, listed = tmp_path / "stored", tmp_path / "list"
    for name in USERS:
        create = () if stored.exists() else ("-c",)
        subprocess.run([PASSWORDS, "-b", *create, str(stored), name, name], check=True, capture_output=True)
        (tmp_path / name).write_text(f"{name}\n")
        (tmp_path / name).chmod(0o600)
    listed.write_text(access_list())
    with mosquitto(tmp_path, "allow_anonymous false", f"password_file {stored}", f"acl_file {listed}") as running:
        yield running


def known(broker: Mosquitto, user: str) -> dict[str, object]:
    """The settings of a user."""
    return {"broker__user": user, "broker__password_file": str(broker.folder / user), "robot__fleet": FLEET}


def robot(broker: Mosquitto, key: str, name: str, **changed: object) -> Publisher:
    settings = broker.settings(**{**known(broker, name), "stop__key_file": key, **changed})
    (broker.folder / f"{name}-store").mkdir()
    made = Publisher(settings, "failstop", Pretended(), name, str(broker.folder / f"{name}-store"))
    pump("its connection", lambda: made.broker.listening, made)
    made.broker.up_s -= LONG_AGO_S
    return made


def test_with_the_page_s_access_list_a_fleet_stop_reaches_every_robot(guarded: Mosquitto, key: str) -> None:
    robots = [robot(guarded, key, name) for name in ("r1", "r2")]
    sender = Sender(guarded.settings(**known(guarded, "operator"), stop__key_file=key), "smoke", "ann")
    running = threading.Thread(daemon=True, target=sender.run, args=(10.0,))
    running.start()
    while running.is_alive():
        for each in robots:
            each.turn(0.005)
    assert sender.tally.robots() == ["r1", "r2"]
    assert everywhere(sender.tally, levels.ACKNOWLEDGED)
    for each in robots:
        each.broker.close()


def test_with_the_page_s_access_list_a_robot_writes_what_is_its_own_alone(guarded: Mosquitto, key: str) -> None:
    """No stop, nothing in another's name: neither reaches the other robot nor the operator."""
    victim = Pretended()
    other = robot(guarded, key, "r2")
    other._robot = victim
    operator = Listener(guarded.settings(**known(guarded, "operator")))
    stranger = Listener(guarded.settings(**known(guarded, "r1")), "nothing")
    for each in (operator, stranger):
        pump("a connection", lambda each=each: each.broker.listening, each)  # type: ignore[misc]
    forbidden = [
        topics.stop(FLEET),
        topics.stop(FLEET, "r2"),
        topics.answer(FLEET, "f" * 32, "r2"),
        topics.of_robot(FLEET, "r2", topics.CONNECTION),
    ]
    for topic in forbidden:
        stranger.broker.say(topic, b"by r1")
    own = topics.of_robot(FLEET, "r1", topics.EVENT)
    stranger.broker.say(own, b"by r1")
    pump("its own", lambda: own in operator.last, operator, stranger, other)
    assert not [topic for topic in forbidden if operator.last.get(topic) == b"by r1"]
    assert other.duties.forged == 0
    for broker in (operator.broker, stranger.broker, other.broker):
        broker.close()


def dynamic(folder: Path, *, subscribe: bool) -> str:
    """A configuration of mosquitto's plugin, by which nobody, or everybody, may subscribe."""
    allowed = {"publishClientSend": True, "publishClientReceive": True, "subscribe": subscribe, "unsubscribe": True}
    acls = [{"acltype": kind, "topic": "#", "priority": 0, "allow": allow}
            for kind, allow in (("publishClientSend", True), ("publishClientReceive", True),
                                ("subscribePattern", subscribe))]  # fmt: skip
    everybody = {"groupname": "everybody", "roles": [{"rolename": "all"}], "clients": []}
    found = {
        "defaultACLAccess": allowed,
        "clients": [],
        "groups": [everybody],
        "roles": [{"rolename": "all", "acls": acls}],
        "anonymousGroup": "everybody",
    }
    path = folder / "dynamic.json"
    path.write_text(json.dumps(found))
    return str(path)


@pytest.mark.skipif(PLUGIN is None, reason="needs mosquitto's plugin for dynamic security")
def test_a_robot_that_may_not_hear_the_stops_says_so(
    tmp_path: Path, key: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The robot says so in its state, so that `failstop fleet` has it, and of itself."""
    lines = ("allow_anonymous true", f"plugin {PLUGIN}", f"plugin_opt_config_file {dynamic(tmp_path, subscribe=False)}")
    with mosquitto(tmp_path, *lines) as broker:
        publisher = robot(broker, key, "r1", broker__user="", broker__password_file="")
        own = topics.of_robot(FLEET, "r1", topics.CONNECTION)
        assert publisher.broker.denied == (topics.stop(FLEET), topics.stop(FLEET, "r1"), own)
        assert publisher.deaf() == (
            f"the broker does not let this robot read {topics.stop(FLEET)} and {topics.stop(FLEET, 'r1')}: "
            "check its access list"
        )
        [error] = [row for row in publisher.own_errors(0.0) if row["kind"] == message.FLEET_STOP_OFF]
        assert error["text"] == publisher.deaf()
        publisher.turn(0.0)
        assert "WARNING: this robot obeys no fleet stop" in " ".join(capsys.readouterr().err.split())
        complete, sender = stop_all(broker.settings(stop__key_file=key), wait_s=0.5)
        assert not complete
        [doubt] = sender.doubts
        assert doubt.startswith("the broker does not let you read failstop/v1/failstop/answer/")
        done = failstop("fleet", "list", "--broker", f"127.0.0.1:{broker.port}")
        assert done.returncode == 1
        assert "the broker does not let you read failstop/v1/failstop/robot/+/connection" in " ".join(
            done.stderr.split()
        )
        publisher.broker.close()
