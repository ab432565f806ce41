"""What the processes import: each module costs time at a restart, and memory that the kernel must tear down before it
reports a death."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import failstop

FORBIDDEN = frozenset(
    (
        "argparse",
        "asyncio",
        "dataclasses",
        "inspect",
        "json",
        "logging",
        "numpy",
        "pathlib",
        "psutil",
        "re",
        "serial",
        "subprocess",
        "typing",
    )
)
STOP_PATH_TOO = FORBIDDEN | {"msgpack", "signal", "socket", "enum"}

_LIST = """
import os, sys
sys.path[:] = os.environ["FAILSTOP_PATH"].split(os.pathsep)
__import__(sys.argv[1])
sys.stdout.write("\\n".join(sys.modules))
"""


def imported(module: str) -> set[str]:
    """Names of the top-level modules in a process that imports this one as supervisor/child.py does."""
    root = str(Path(failstop.__file__).resolve().parent.parent)
    path = os.pathsep.join(dict.fromkeys([root, *(entry for entry in sys.path if os.path.isabs(entry))]))
    arguments = [sys.executable, "-I", "-S", "-c", _LIST, module]
    done = subprocess.run(arguments, env={"FAILSTOP_PATH": path}, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    found = set(done.stdout.splitlines())
    assert module in found
    return {name.partition(".")[0] for name in found}


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
    assert {"json", "re", "failstop"} <= imported("failstop.commands.status")
