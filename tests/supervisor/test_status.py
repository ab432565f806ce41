"""When the watchdog is left to bite, the one line that is always true, and what the service manager hears of both."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from failstop.notify import VARIABLES, Notify
from failstop.supervisor.status import OWED_NS, UNDYING_NS, fault, status_line

NOW = 10**12
S = 10**9


def test_a_service_in_order_is_healthy() -> None:
    assert fault(NOW, {}, 0) == ""


def test_a_killed_process_has_some_time_to_die() -> None:
    killed = {"gate": NOW - UNDYING_NS}
    assert fault(NOW - 1, killed, 0) == ""
    assert fault(NOW, killed, 0) == "gate was killed 10 s ago and is not gone"


def test_a_stop_that_nobody_could_write_is_no_job_done() -> None:
    assert fault(NOW - 1, {}, NOW - OWED_NS) == ""
    assert fault(NOW, {}, NOW - OWED_NS) == "a stop could not be written for 2 s"


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
        ("gate", "gate", "gate died", {}, "stop latched: gate died; gate died too often and is down until a reset"),
        ("gate", "gate", "", {}, "motion disabled, waiting for gate; gate died too often and is down until a reset"),
    ],
)
def test_the_line(missing: str, down: str, latched: str, gate: dict[str, Any], line: str) -> None:
    assert status_line(missing, down, latched, gate) == line


MS = 1_000_000
T0 = 5_000 * MS


class Manager:
    """The service manager's end."""

    def __init__(self, address: str) -> None:
        self.address = address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self._socket.bind("\0" + address[1:] if address.startswith("@") else address)

    def heard(self) -> list[str]:
        """Every assignment that has arrived, in order."""
        found: list[str] = []
        while True:
            try:
                found += self._socket.recv(4096).decode().split("\n")
            except BlockingIOError:
                return found

    def close(self) -> None:
        self._socket.close()


@pytest.fixture(params=["path", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Manager]:
    made = Manager(str(tmp_path / "notify") if request.param == "path" else f"@failstop-test-{os.getpid()}")
    yield made
    made.close()


@pytest.fixture
def end() -> Iterator[contextlib.ExitStack]:
    with contextlib.ExitStack() as stack:
        yield stack


def speaker(end: contextlib.ExitStack, address: str, watchdog_us: int = 0) -> Notify:
    """The service's end, closed after the test."""
    return end.enter_context(contextlib.closing(Notify(address, watchdog_us)))


def test_ready_and_status_are_told_once_and_the_watchdog_at_half_its_time(
    manager: Manager, end: contextlib.ExitStack
) -> None:
    notify = speaker(end, manager.address, 400_000)
    notify.follow(T0, "waiting for the port", ready=False, healthy=True)
    assert manager.heard() == ["STATUS=waiting for the port", "WATCHDOG=1"]
    notify.follow(T0 + 199 * MS, "ready, motion disabled", ready=True, healthy=True)
    assert manager.heard() == ["READY=1", "STATUS=ready, motion disabled"]
    notify.follow(T0 + 200 * MS, "ready, motion disabled", ready=True, healthy=True)
    assert manager.heard() == ["WATCHDOG=1"]
    notify.follow(T0 + 399 * MS, "ready, motion disabled", ready=True, healthy=True)
    assert manager.heard() == []
    notify.stopping("wheels stopped")
    assert manager.heard() == ["STOPPING=1", "STATUS=wheels stopped"]


def test_who_does_not_do_its_job_does_not_beat(manager: Manager, end: contextlib.ExitStack) -> None:
    notify = speaker(end, manager.address, 400_000)
    notify.follow(T0, "gate was killed 11 s ago and is not gone", ready=False, healthy=False)
    assert manager.heard() == ["STATUS=gate was killed 11 s ago and is not gone"]


def test_without_a_watchdog_there_is_no_beat(manager: Manager, end: contextlib.ExitStack) -> None:
    speaker(end, manager.address).follow(T0, "ready", ready=False, healthy=True)
    assert manager.heard() == ["STATUS=ready"]


def test_without_being_told_of_one_there_is_none() -> None:
    assert Notify("/run/x").every_ns == 0


def test_an_address_need_be_no_text(tmp_path: Path, end: contextlib.ExitStack) -> None:
    manager = Manager(str(tmp_path / "n\udcff"))
    assert speaker(end, manager.address).say("READY=1")
    assert manager.heard() == ["READY=1"]
    manager.close()


def test_a_reason_can_not_speak_for_the_service(manager: Manager, end: contextlib.ExitStack) -> None:
    speaker(end, manager.address).follow(T0, "stop latched: x\nREADY=1\nWATCHDOG=1", ready=False, healthy=True)
    assert manager.heard() == ["STATUS=stop latched: x?READY=1?WATCHDOG=1"]


def test_what_is_no_text_is_sent_all_the_same(manager: Manager, end: contextlib.ExitStack) -> None:
    assert speaker(end, manager.address).say("STATUS=\udcff")
    assert manager.heard() == ["STATUS=?"]


def test_what_could_not_be_sent_is_sent_later(tmp_path: Path, end: contextlib.ExitStack) -> None:
    notify = speaker(end, str(tmp_path / "notify"), 400_000)
    notify.follow(T0, "ready", ready=True, healthy=True)
    manager = Manager(str(tmp_path / "notify"))
    notify.follow(T0 + MS, "ready", ready=True, healthy=True)
    assert manager.heard() == ["READY=1", "STATUS=ready", "WATCHDOG=1"]
    manager.close()


def test_a_manager_that_does_not_listen_holds_nobody_up(manager: Manager, end: contextlib.ExitStack) -> None:
    """Its queue is full: a blocking send would wait forever."""
    notify = speaker(end, manager.address, 2)
    sent = 0
    while notify.say("STATUS=again"):
        sent += 1
        assert sent < 100_000, "a queue without an end?"
    notify.follow(T0, "ready", ready=True, healthy=True)
    assert set(manager.heard()) == {"STATUS=again"}


@pytest.mark.parametrize("address", ["", "vsock:2:1234", "relative/path", "/no/such/socket", "/" + "x" * 300])
def test_an_address_that_is_none_is_no_error(address: str) -> None:
    notify = Notify.taken_from({"NOTIFY_SOCKET": address}, 1)
    notify.follow(T0, "ready", ready=True, healthy=True)
    notify.stopping("bye")
    assert notify.say("READY=1") is False
    notify.close()


@pytest.mark.parametrize(
    ("timeout", "pid", "every_ms"),
    [
        ("400000", "77", 200),
        ("400000", "78", 0),
        ("400000", "", 200),
        ("0", "77", 0),
        ("", "77", 0),
        ("soon", "77", 0),
        ("-5", "77", 0),
    ],
)
def test_the_watchdog_of_another_process_is_none(timeout: str, pid: str, every_ms: int) -> None:
    environ = {"NOTIFY_SOCKET": "/run/x", "WATCHDOG_USEC": timeout, "WATCHDOG_PID": pid}
    assert Notify.taken_from(environ, 77).every_ns == every_ms * MS


def test_the_variables_are_taken_away() -> None:
    environ = {**dict.fromkeys(VARIABLES, "/1"), "HOME": "/root"}
    Notify.taken_from(environ, 77)
    assert environ == {"HOME": "/root"}
