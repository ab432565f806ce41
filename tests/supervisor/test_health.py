"""When the watchdog is left to bite, and the one line that is always true."""

from __future__ import annotations

from typing import Any

import pytest

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
        (
            "gate",
            "gate",
            "gate died",
            {},
            "stop latched: gate died; gate died too often and is down until a reset",
        ),
        (
            "gate",
            "gate",
            "",
            {},
            "motion disabled, waiting for gate; gate died too often and is down until a reset",
        ),
    ],
)
def test_the_line(missing: str, down: str, latched: str, gate: dict[str, Any], line: str) -> None:
    assert status_line(missing, down, latched, gate) == line
