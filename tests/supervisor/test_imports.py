"""Imports of the processes: each module costs time at a restart, and memory that the kernel must tear down before it
reports a death."""

from __future__ import annotations

import pytest

from tests.support.imports import FORBIDDEN, imported

STOP_PATH_TOO = FORBIDDEN | {"msgpack", "signal", "socket", "enum"}


@pytest.mark.parametrize(
    ("module", "forbidden"),
    [
        ("failstop.procs.port_owner.main", STOP_PATH_TOO),
        ("failstop.procs.stopper.main", STOP_PATH_TOO),
        ("failstop.procs.context", STOP_PATH_TOO),
        ("failstop.procs.gate.main", FORBIDDEN),
        ("failstop.procs.telemetry.main", FORBIDDEN),
        ("failstop.supervisor.main", FORBIDDEN),
        ("failstop.supervisor.entry", FORBIDDEN),
    ],
)
def test_imports_nothing_that_it_does_not_need(module: str, forbidden: frozenset[str]) -> None:
    assert sorted(imported(module) & forbidden) == []


def test_the_check_sees_what_is_imported() -> None:
    assert {"argparse", "re", "failstop"} <= imported("failstop.cli.commands.status")
