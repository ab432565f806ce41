"""`failstop fleet` as its user calls it: what it refuses, what it shows while it waits, and what Ctrl-C leaves."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import select
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from failstop.cli.main import main
from failstop.fleet import message, signed, topics
from failstop.fleet.broker import read_secret
from failstop.fleet.settings import FleetSettings
from failstop.policy.setting import SettingError
from tests.support.commands import FAILSTOP, failstop

from .scene import LONG_AGO_S, Listener, Pretended, Robot, pump
from .standin import Standin

FLEET = "failstop"
PERIOD_S = 0.5
NOBODY = 65534
READER = "reader"
"""A user of the broker who may write nothing."""
NO_ACCOUNT = 54321
NAMES = ("LOGNAME", "USER", "LNAME", "USERNAME")
"""The variables that may have the user's name."""


@pytest.fixture
def broker() -> Iterator[Standin]:
    made = Standin(may_write=lambda user, _topic: user != READER)
    made.start()
    yield made
    made.kill()


@pytest.fixture
def config(broker: Standin, key: str, tmp_path: Path) -> str:
    """The settings file of the program that stops the fleet."""
    path = tmp_path / "fleet.toml"
    path.write_text(f"[broker]\nport = {broker.port}\n[robot]\npublish_s = {PERIOD_S}\n[stop]\nkey_file = '{key}'\n")
    return str(path)


@pytest.fixture
def robot() -> Pretended:
    return Pretended()


@pytest.fixture
def publisher(broker: Standin, key: str, tmp_path: Path, robot: Pretended) -> Iterator[Robot]:
    """That robot, connected."""
    made = Robot(broker.settings(stop__key_file=key, robot__publish_s=PERIOD_S), "failstop", robot, "r1",
                 str(tmp_path))  # fmt: skip
    pump("its connection", lambda: made.broker.listening, made)
    made.broker.up_s -= LONG_AGO_S
    yield made
    made.broker.close()


@pytest.fixture
def somebody(broker: Standin) -> Iterator[Listener]:
    made = Listener(broker.settings(), "failstop/v1/+/robot/#")
    pump("the listener", lambda: made.broker.listening, made)
    yield made
    made.broker.close()


def keep(somebody: Listener, robot: str, word: str) -> None:
    """The broker remembers this connection of a robot's."""
    body = message.connection(word, PERIOD_S)
    topic = topics.of_robot(FLEET, robot, topics.CONNECTION)
    payload = message.Header(FLEET, robot, "b" * 16).message(topics.CONNECTION, body, time.time())
    somebody.broker.say(topic, payload, retain=True)
    pump("it to be kept", lambda: somebody.last.get(topic) == payload, somebody)


def test_an_empty_broker_is_no_error(config: str) -> None:
    done = failstop("fleet", "list", "--config", config)
    assert (done.returncode, done.stderr) == (0, "")
    assert " ".join(done.stdout.split()).endswith("shows no robot: either it knows none, or its access list hides them")
    done = failstop("fleet", "list", "--json", "--config", config)
    assert (done.returncode, json.loads(done.stdout)) == (0, [])


def test_no_broker_is_one() -> None:
    done = failstop("fleet", "list", "--broker", "127.0.0.1:1")
    assert (done.returncode, done.stdout) == (1, "")
    assert "no broker at 127.0.0.1:1: Connection refused" in done.stderr


@pytest.mark.parametrize("wait", ["0", "-3", "nan", "inf", "1e9", "soon", ""])
def test_a_time_to_wait_that_is_none(wait: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fleet", "stop", f"--wait={wait}", "--broker", "127.0.0.1:1"]) == 1
    assert "it must be more than 0 s, and at most 3600 s" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("given", "where"),
    [
        ("robots", "robots:1883"),
        ("robots:8883", "robots:8883"),
        ("::1", "::1:1883"),
        ("[::1]", "::1:1883"),
        ("[::1]:8883", "::1:8883"),
        ("fe80::1:2", "fe80::1:2:1883"),
    ],
)
def test_where_the_broker_is(given: str, where: str, capsys: pytest.CaptureFixture[str], key: str) -> None:
    main(["fleet", "stop", "--wait=0.1", "--broker", given, "--config", settings_of(key)])
    assert f"no broker at {where}" in " ".join(capsys.readouterr().err.split())


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to become somebody else")
def test_a_user_without_an_account_stops_the_fleet(
    config: str, publisher: Robot, robot: Pretended, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a container with `--user 54321`, where no variable has a name either."""
    for name in NAMES:
        monkeypatch.delenv(name, raising=False)
    before = os.getuid()
    os.setresuid(NO_ACCOUNT, -1, -1)
    try:
        with ThreadPoolExecutor(1) as pool:
            stopping = pool.submit(main, ["fleet", "stop", "smoke", "--config", config])
            pump("its end", stopping.done, publisher)
    finally:
        os.setresuid(before, -1, -1)
    assert stopping.result() == 0
    assert robot.asked == [("smoke", f"uid {NO_ACCOUNT}@{socket.gethostname()}")]


def settings_of(key: str) -> str:
    path = Path(key).with_suffix(".toml")
    path.write_text(f"[stop]\nkey_file = '{key}'\n")
    return str(path)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"broker.ca_file": "/ca"}, 'broker.ca_file is set but broker.tls is "off"'),
        ({"broker.cert_file": "/c"}, 'broker.cert_file is set but broker.tls is "off"'),
        ({"broker.cert_key_file": "/k"}, 'broker.cert_key_file is set but broker.tls is "off"'),
        ({"broker.tls": "on", "broker.cert_key_file": "/k"}, "broker.cert_key_file is set but broker.cert_file is not"),
        ({"broker.password_file": "/p"}, "broker.password_file is set but broker.user is not"),
    ],
)
def test_settings_that_protect_less_than_they_seem_to(given: dict[str, object], says: str) -> None:
    with pytest.raises(SettingError, match=says.replace(".", r"\.")):
        FleetSettings(given)


def test_a_password_of_the_unit_needs_a_user_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "broker.password").write_text("x")
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path))
    with pytest.raises(Exception, match=r"broker\.user is not set"):
        Listener(FleetSettings({}))


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to become somebody else")
@pytest.mark.parametrize(
    ("what", "says"),
    [
        (lambda path: read_secret(path), "LoadCredential=broker.password:"),
        (lambda path: signed.read_key(path), "LoadCredential=fleet.key:"),
        (lambda path: Listener(FleetSettings({"broker.tls": "on", "broker.ca_file": path})), "chmod 644 "),
        (
            lambda path: Listener(
                FleetSettings({"broker.tls": "on", "broker.cert_file": "/etc/hosts", "broker.cert_key_file": path})
            ),
            "LoadCredential=broker.cert_key:",
        ),
    ],
    ids=["password", "key", "authority", "certificate's key"],
)
def test_a_file_that_the_units_user_may_not_read_comes_with_the_remedy(what: Any, says: str, tmp_path: Path) -> None:
    path = tmp_path / "secret"
    path.write_text("x")
    path.chmod(0o600)
    for folder in (tmp_path, *tmp_path.parents[:2]):
        folder.chmod(0o755)
    before = os.geteuid()
    os.seteuid(NOBODY)
    try:
        with pytest.raises(Exception, match=f"Permission denied.*{says}{path}"):
            what(str(path))
    finally:
        os.seteuid(before)


def test_ctrl_c_prints_the_report_so_far(config: str, publisher: Robot, somebody: Listener) -> None:
    keep(somebody, "r2", message.LOST)
    words = [*FAILSTOP, "fleet", "stop", "--wait", "60", "--config", config]
    terminal, theirs = pty.openpty()
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=theirs, text=True) as running:
        os.close(theirs)
        until(terminal, "1 of 2 robots have confirmed; waiting for r2", publisher)
        running.send_signal(signal.SIGINT)
        assert "Traceback" not in until(terminal, "interrupted, ", publisher)
        out, _ = running.communicate(timeout=20)
    os.close(terminal)
    assert running.returncode == 130
    assert out.startswith("1 of 2 robots have confirmed the stop\n")
    assert "r2  no answer: its connection is broken" in out


def test_ctrl_c_before_a_broker_took_it_says_that_nobody_was_stopped(key: str) -> None:
    terminal, theirs = pty.openpty()
    words = [*FAILSTOP, "fleet", "stop", "--wait", "60", "--broker", "127.0.0.1:1", "--config", settings_of(key)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=theirs) as running:
        os.close(theirs)
        until(terminal, "no broker at 127.0.0.1:1: Connection refused: trying again")
        running.send_signal(signal.SIGINT)
        assert "NO ROBOT WAS STOPPED" in until(terminal, "power switch")
        assert running.wait(20) == 130
    os.close(terminal)


def test_a_status_that_the_service_manager_could_not_take_is_sent_again(
    config: str, tmp_path: Path, somebody: Listener
) -> None:
    """Its queue is full while the publisher connects to the broker."""
    (tmp_path / "state").mkdir()
    address = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(address)
        manager.settimeout(20.0)
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as other:
            other.setblocking(False)
            with contextlib.suppress(BlockingIOError):
                while True:
                    other.sendto(b"WATCHDOG=1", address)
        known = {**os.environ, "NOTIFY_SOCKET": address, "STATE_DIRECTORY": str(tmp_path / "state")}
        words = [*FAILSTOP, "fleet", "publish", "--name", "nobody", "--config", config]
        with subprocess.Popen(words, env=known, stderr=subprocess.DEVNULL) as running:
            states = lambda: [topic for topic, _ in somebody.all if topic.endswith("/state")]  # noqa: E731
            pump("two states", lambda: len(states()) > 1, somebody)
            said = b""
            while b"STATUS=" not in said:
                said = manager.recv(4096)
            running.kill()
    assert said == b"STATUS=obeys a fleet stop\nERRNO=0"


@pytest.mark.parametrize(
    ("broker", "says"),
    [
        ("127.0.0.1:²", "no broker at 127.0.0.1:²:1883"),
        (f"127.0.0.1:{'1' * 5000}", "broker.port = '1111"),
        (f"{'é' * 70}:1883", "no broker at éé"),
        ("a..b", "no broker at a..b:1883"),
    ],
    ids=["digit", "long port", "long host", "empty label"],
)
def test_an_address_of_a_broker_that_is_none(broker: str, says: str, key: str) -> None:
    done = failstop("fleet", "list", "--broker", broker, "--config", settings_of(key))
    assert done.returncode == 1
    assert says in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr


def until(terminal: int, wanted: str, *turning: Robot) -> str:
    """What is shown until that comes."""
    shown, end_s = "", time.monotonic() + 20.0
    while wanted not in " ".join(shown.split()):
        assert time.monotonic() < end_s, shown
        for each in turning:
            each.turn(0.005)
        if select.select([terminal], (), (), 0.005)[0]:
            shown += os.read(terminal, 4096).decode()
    return " ".join(shown.split())


def test_progress_is_shown_while_it_waits(config: str, somebody: Listener) -> None:
    keep(somebody, "r2", message.LOST)
    terminal, theirs = pty.openpty()
    words = [*FAILSTOP, "fleet", "stop", "--wait", "60", "--config", config]
    with subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=theirs) as running:
        os.close(theirs)
        until(terminal, "0 of 1 robots have confirmed; waiting for r2")
        running.send_signal(signal.SIGINT)
        assert running.wait(20) == 130
    os.close(terminal)


def test_a_robot_that_was_switched_off_while_the_broker_was_down_is_forgotten(config: str, somebody: Listener) -> None:
    """The broker calls it connected for ever."""
    keep(somebody, "r2", message.ONLINE)
    done = failstop("fleet", "forget", "r2", "--config", config)
    assert (done.returncode, done.stdout) == (0, "r2 is forgotten: a fleet stop no longer waits for it\n")
    assert "the broker reports r2 as connected; waiting up to 4 s for a sign of life" in " ".join(done.stderr.split())
    topic = topics.of_robot(FLEET, "r2", topics.CONNECTION)
    pump("it to be taken off", lambda: somebody.last[topic] == b"", somebody)


def test_a_robot_that_the_broker_keeps_is_not_called_forgotten(config: str, somebody: Listener) -> None:
    keep(somebody, "r2", message.LOST)
    Path(config).write_text(Path(config).read_text().replace("[broker]", f"[broker]\nuser = '{READER}'"))
    done = failstop("fleet", "forget", "r2", "--config", config)
    assert (done.returncode, done.stdout) == (1, "")
    assert (
        "the broker still knows r2: its access list must let you read and write failstop/v1/failstop/robot/r2/#"
        in " ".join(done.stderr.split())
    )


@pytest.mark.parametrize(
    ("names", "says"),
    [
        (
            "r1\nr2\n",
            "r2 is forgotten by the broker, but a fleet stop still waits for it: remove it from stop.robots_file",
        ),
        ("r1\n", "r2 is forgotten: a fleet stop no longer waits for it"),
        ("", "r2 is forgotten: a fleet stop no longer waits for it"),
    ],
)
def test_a_robot_that_is_forgotten_may_still_be_listed(
    config: str, somebody: Listener, tmp_path: Path, names: str, says: str
) -> None:
    keep(somebody, "r2", message.LOST)
    (tmp_path / "robots").write_text(names)
    with Path(config).open("a") as file:
        file.write(f"robots_file = '{tmp_path / 'robots'}'\n")
    done = failstop("fleet", "forget", "r2", "--config", config)
    assert (done.returncode, " ".join(done.stdout.split())[: len(says)]) == (0, says)


def test_a_robot_that_is_alive_is_not_forgotten(config: str, publisher: Robot) -> None:
    words = [*FAILSTOP, "fleet", "forget", "r1", "--config", config]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        pump("its end", lambda: running.poll() is not None, publisher)
        assert running.returncode == 1
        assert running.stderr is not None
        assert "r1 is connected: end its publisher first" in " ".join(running.stderr.read().split())
