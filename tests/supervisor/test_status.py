"""When the watchdog is left to bite, the one line that is always true, and what the service manager hears of both."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from failstop.messages import records
from failstop.notify import Notify
from failstop.supervisor.status import OWED_NS, UNDYING_NS, although_told_zero, fault, status_line

NOW = 10**12
S = 10**9


@pytest.mark.parametrize(
    ("killed", "owed_ns", "told"),
    [
        ({}, 0, ""),
        ({"gate": NOW - UNDYING_NS + 1}, 0, ""),
        ({"gate": NOW - UNDYING_NS}, 0, "gate was killed 10 s ago and is not gone"),
        ({}, NOW - OWED_NS + 1, ""),
        ({}, NOW - OWED_NS, "a stop could not be written for 2 s"),
    ],
)
def test_the_watchdog_is_for_a_death_or_a_stop_that_does_not_come(
    killed: dict[str, int], owed_ns: int, told: str
) -> None:
    assert fault(NOW, killed, owed_ns) == told


DRIVES = {"source": "cmd_vel", "who": "nav (pid 7)", "state": "drives"}
WAITS = {"source": "low", "who": "idle (pid 8)", "state": "waits"}
DRIVING: dict[str, Any] = {"enabled": True, "blocked": None, "sources": [DRIVES, WAITS]}


@pytest.mark.parametrize(
    ("missing", "down", "latched", "gate", "line"),
    [
        ("gate, telemetry", "", "", {}, "motion disabled, waiting for gate, telemetry"),
        ("", "", "", {}, "ready, motion disabled"),
        ("", "", "", {"enabled": False}, "ready, motion disabled"),
        ("", "", "", DRIVING, "motion enabled; cmd_vel drives: nav (pid 7)"),
        ("", "", "", {**DRIVING, "sources": [WAITS]}, "motion enabled; nobody drives"),
        ("", "", "", {**DRIVING, "blocked": "no scan"}, "motion enabled; blocked: no scan"),
        ("", "", "key1", DRIVING, "stop latched: key1"),
        ("the port", "", "device lost", DRIVING, "stop latched: device lost; waiting for the port"),
        ("gate", "gate", "gate died", {}, "stop latched: gate died; gate died too often and is down for a minute"),
        ("gate", "gate", "", {}, "motion disabled, waiting for gate; gate died too often and is down for a minute"),
    ],
)
def test_the_line(missing: str, down: str, latched: str, gate: dict[str, Any], line: str) -> None:
    assert status_line(missing, down, latched, gate) == line


@pytest.mark.parametrize(
    ("by", "unexpected", "age_ms", "told"),
    [
        (2, True, 100, "the wheels turn although they are told to stop"),
        (1, True, 100, "the robot moves, or is being moved, although its wheels are told to stop"),
        (2, False, 100, ""),
        (2, True, 500, "the wheels turn although they are told to stop"),
        (2, True, 501, ""),
    ],
)
def test_wheels_that_turn_although_told_zero(by: int, unexpected: bool, age_ms: int, told: str) -> None:
    record = records.WHEELS_SEEN.pack(2, by, unexpected, 2, 1, NOW - age_ms * MS, *[0.8] * 4, *[0.0] * 4)
    assert although_told_zero((1, NOW, record), NOW) == told
    assert although_told_zero(None, NOW) == ""


MS = 1_000_000
T0 = 5_000 * MS


class Manager:
    """The service manager's end, and the service's."""

    def __init__(self, address: str, watchdog_us: int = 400_000) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self.notify = Notify(address, watchdog_us)

    def listen(self) -> None:
        """There is a manager from now on."""
        self._socket.bind(self._address)

    def hears(self, elapsed_ms: int, line: str, *, ready: bool = True, healthy: bool = True) -> list[str]:
        """The service follows, so long after its start; every assignment that has arrived since the last, in order."""
        self.notify.update(T0 + elapsed_ms * MS, line, ready=ready, healthy=healthy)
        return self.heard()

    def heard(self) -> list[str]:
        found: list[str] = []
        while True:
            try:
                found += self._socket.recv(4096).decode().split("\n")
            except BlockingIOError:
                return found

    def close(self) -> None:
        self._socket.close()
        self.notify.close()


@pytest.fixture(params=["notify", "@", "\udcff"], ids=["path", "abstract", "no text"])
def manager(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Manager]:
    made = Manager(f"@failstop-test-{os.getpid()}" if request.param == "@" else f"{tmp_path}/{request.param}")
    yield made
    made.close()


def test_ready_and_status_are_told_once_and_the_watchdog_at_half_its_time(manager: Manager) -> None:
    assert manager.hears(-1, "starting", ready=False) == [], "there is no manager yet"
    manager.listen()
    assert manager.hears(0, "waiting for the port", ready=False) == ["STATUS=waiting for the port", "WATCHDOG=1"]
    assert manager.hears(199, "ready, motion disabled") == ["READY=1", "STATUS=ready, motion disabled"]
    assert manager.hears(200, "ready, motion disabled") == ["WATCHDOG=1"]
    assert manager.hears(399, "ready, motion disabled") == []
    assert manager.hears(999, "gate was killed", healthy=False) == ["STATUS=gate was killed"], "no beat"
    hostile = "stop latched: x\nREADY=1\nWATCHDOG=1\udcff"
    assert manager.hears(999, hostile, healthy=False) == ["STATUS=stop latched: x?READY=1?WATCHDOG=1?"]
    manager.notify.stopping("wheels stopped\n")
    assert manager.notify.say("what is no text: \udcff")
    assert manager.heard() == ["STOPPING=1", "STATUS=wheels stopped?", "what is no text: ?"]


def test_without_a_watchdog_there_is_no_beat(tmp_path: Path) -> None:
    manager = Manager(str(tmp_path / "notify"), 0)
    manager.listen()
    assert manager.hears(0, "ready", ready=False) == ["STATUS=ready"]
    manager.close()
    assert Notify("/run/x").every_ns == 0


def test_a_manager_that_does_not_listen_holds_nobody_up(manager: Manager) -> None:
    """Its queue is full: a blocking send would wait forever."""
    manager.listen()
    sent = 0
    while manager.notify.say("STATUS=again"):
        sent += 1
        assert sent < 100_000, "a queue without an end?"
    assert set(manager.hears(0, "ready")) == {"STATUS=again"}


@pytest.mark.parametrize("address", ["", "vsock:2:1234", "relative/path", "/no/such/socket", "/" + "x" * 300])
def test_an_address_that_is_none_is_no_error(address: str) -> None:
    notify = Notify.from_environment({"NOTIFY_SOCKET": address}, 1)
    notify.update(T0, "ready", ready=True, healthy=True)
    notify.stopping("bye")
    assert notify.say("READY=1") is False
    notify.close()


@pytest.mark.parametrize(
    ("timeout", "pid", "every_ms"),
    [
        *(("400000", "77", 200), ("400000", "", 200), ("400000", "78", 0)),
        *(("0", "77", 0), ("", "77", 0), ("soon", "77", 0), ("-5", "77", 0)),
    ],
)
def test_the_watchdog_of_another_process_is_none(timeout: str, pid: str, every_ms: int) -> None:
    environ = {"NOTIFY_SOCKET": "/run/x", "WATCHDOG_USEC": timeout, "WATCHDOG_PID": pid, "HOME": "/root"}
    assert Notify.from_environment(environ, 77).every_ns == every_ms * MS
    assert environ == {"HOME": "/root"}, "the variables are taken away"
