"""The pty's carriers: before ordinary programs while a bench measures, and as they were afterwards."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

from bench import carriers
from bench.carriers import Carriers

OTHER, FIFO = os.SCHED_OTHER, os.SCHED_FIFO
NAMED_SO = "import sys, time; open('/proc/self/comm', 'w').write('kworker/u9:1'); print(flush=True); sys.stdin.read()"


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> dict[int, int]:
    """Workers and their policies."""
    policies = {10: OTHER, 11: FIFO, 12: OTHER}

    def setscheduler(pid: int, policy: int, parameter: os.sched_param) -> None:
        if pid not in policies:
            raise ProcessLookupError
        assert bool(parameter.sched_priority) == (policy == FIFO)
        policies[pid] = policy

    monkeypatch.setattr(carriers, "workers", lambda: iter(list(policies)))
    monkeypatch.setattr(os, "sched_getscheduler", lambda pid: policies[pid])
    monkeypatch.setattr(os, "sched_setscheduler", setscheduler)
    return policies


def test_they_come_first_and_are_given_back(machine: dict[int, int]) -> None:
    with Carriers() as first:
        assert first.priority == "ordinary"
        first.first()
        assert machine == {10: FIFO, 11: FIFO, 12: FIFO}
        del machine[12]
        machine[13] = OTHER
        first.first()
        assert machine == {10: FIFO, 11: FIFO, 13: FIFO}
    assert machine == {10: OTHER, 11: FIFO, 13: OTHER}, "one that was first before stays so"
    assert first.priority == "real-time"


def test_without_the_right_nothing_is_changed(machine: dict[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refused)
    with Carriers() as first:
        first.first()
    assert first.priority == "ordinary"
    assert machine == {10: OTHER, 11: FIFO, 12: OTHER}


def test_a_program_of_such_a_name_is_none() -> None:
    with subprocess.Popen([sys.executable, "-c", NAMED_SO], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as program:
        assert program.stdout
        program.stdout.readline()
        assert Path(f"/proc/{program.pid}/comm").read_text() == "kworker/u9:1\n"
        assert program.pid not in set(carriers.workers())
        assert program.stdin
        program.stdin.close()
