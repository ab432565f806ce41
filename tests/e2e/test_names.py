"""Names in /dev/shm that are taken away while the service runs."""

from __future__ import annotations

import glob
import os
import re
import time

from failstop.lab.trial import Trial, judge, wait_for
from failstop.messages import segments
from tests.support.shared_trial import set_off
from tests.support.simulated import Simulated


def test_a_client_slot_that_is_gone_costs_that_slot_alone(simulated: Simulated) -> None:
    simulated.os.unlink(segments.path_of(simulated.load("failstop.api.client").run(simulated.name)[0], "client.5"))
    simulated.wait_for("the word on it", lambda: "client.5 was removed" in simulated.said)
    simulated.enable()
    pid = simulated.pids()["gate"]
    simulated.kill("gate")
    simulated.recover("gate", pid)
    simulated.enable()
    simulated.drive(0.2)
    assert simulated.turning()
    assert simulated.said.count("client.5 was removed") == 1


def test_without_its_shared_memory_it_stops_and_ends_with_an_error(fresh: Trial) -> None:
    """As logind removes it: the service manager restarts a service that has ended, and the new run makes its own (the
    row names-removed of tests/faults/test_table.py)."""
    set_off(fresh)
    pids = fresh.service.pids()
    removed_ns = time.monotonic_ns()
    for path in glob.glob(f"/dev/shm/failstop.{fresh.name}.*"):
        os.unlink(path)
    process = fresh.service.process
    assert process
    wait_for("its end", lambda: fresh.drive(0.1) or process.poll() is not None)
    assert process.wait() == 1
    stopped = judge(fresh.board.events(), removed_ns, True)
    assert stopped.stop_ns is not None
    assert stopped.motion_after == 0
    wait_for("every process to be gone", lambda: not any(os.path.exists(f"/proc/{pid}") for pid in pids.values()))
    assert "RemoveIPC" in fresh.service.said()
    assert "was removed: restart the service; stop frame written" in fresh.service.said()
    assert re.search("incident .* saved", fresh.service.said()), "names or not, its black box is there"


def test_without_its_stop_pipe_it_ends(simulated: Simulated) -> None:
    """Nobody could ask for a stop any more."""
    supervisor = simulated.lab.named("supervisor")
    assert supervisor
    simulated.os.unlink(f"/run/failstop/{simulated.name}/stop")
    simulated.wait_for("its end", lambda: supervisor.code is not None, 2.0)
    assert supervisor.code == 1
    assert "the stop pipe was removed" in simulated.said
