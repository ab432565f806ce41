"""The pty's carriers: before ordinary programs while a bench measures, and as they were afterwards."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from bench import carriers
from bench.carriers import Carriers, Kernel

OTHER, FIFO = os.SCHED_OTHER, os.SCHED_FIFO
NAMED_SO = "import sys, time; open('/proc/self/comm', 'w').write('kworker/u9:1'); print(flush=True); sys.stdin.read()"


class Machine(Kernel):
    """Workers and their policies, which can be without the right to change them."""

    def __init__(self) -> None:
        self.policies = {10: OTHER, 11: FIFO, 12: OTHER}
        self.allowed = True

    def workers(self) -> Iterator[int]:
        return iter(list(self.policies))

    def policy(self, pid: int) -> int:
        return self.policies[pid]

    def schedule(self, pid: int, policy: int, priority: int) -> None:
        if not self.allowed:
            raise PermissionError
        if pid not in self.policies:
            raise ProcessLookupError
        assert bool(priority) == (policy == FIFO)
        self.policies[pid] = policy


def test_they_come_first_and_are_given_back() -> None:
    machine = Machine()
    with Carriers(machine) as first:
        assert first.priority == "ordinary"
        first.first()
        assert machine.policies == {10: FIFO, 11: FIFO, 12: FIFO}
        del machine.policies[12]
        machine.policies[13] = OTHER
        first.first()
        assert machine.policies == {10: FIFO, 11: FIFO, 13: FIFO}
    assert machine.policies == {10: OTHER, 11: FIFO, 13: OTHER}, "one that was first before stays so"
    assert first.priority == "real-time"


def test_without_the_right_nothing_is_changed() -> None:
    machine = Machine()
    machine.allowed = False
    with Carriers(machine) as first:
        first.first()
    assert first.priority == "ordinary"
    assert machine.policies == Machine().policies


def test_a_program_of_such_a_name_is_none() -> None:
    with subprocess.Popen([sys.executable, "-c", NAMED_SO], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as program:
        assert program.stdout
        program.stdout.readline()
        assert Path(f"/proc/{program.pid}/comm").read_text() == "kworker/u9:1\n"
        assert program.pid not in set(carriers.workers())
        assert program.stdin
        program.stdin.close()
