"""Names in /dev/shm that are taken away while the service runs."""

from __future__ import annotations

import glob
import os
import re
import time

from failstop.lab.trial import Trial, judge, wait_for
from failstop.messages import segments
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
    assert simulated.moving()
    assert simulated.said.count("client.5 was removed") == 1


def test_without_its_shared_memory_it_stops_and_ends_with_an_error(trial: Trial) -> None:
    """logind removes it so: the service manager restarts a service that has ended, and the new run makes its own."""
    trial.enable()
    trial.drive(0.2)
    assert trial.moving()
    trial.board.events()
    pids = trial.service.pids()
    removed_ns = time.monotonic_ns()
    for path in glob.glob(f"/dev/shm/failstop.{trial.name}.*"):
        os.unlink(path)
    process = trial.service.process
    assert process
    trial.drive(2.0)
    assert process.wait(5) == 1
    stopped = judge(trial.board.events(), removed_ns, True)
    assert stopped.stop_ns is not None
    assert stopped.stop_ns < 3e9
    assert stopped.motion_after == 0
    wait_for("every process to be gone", lambda: not any(os.path.exists(f"/proc/{pid}") for pid in pids.values()))
    assert "RemoveIPC" in trial.service.said()
    assert "was removed: restart the service; stop frame written" in trial.service.said()
    assert re.search("incident .* saved", trial.service.said()), "names or not, its black box is there"
    trial.leave()
    trial.service.start()
    trial.enable()
    trial.drive(0.2)
    assert trial.moving()


def test_without_its_stop_pipe_it_ends(simulated: Simulated) -> None:
    """Nobody could ask for a stop any more."""
    supervisor = simulated.lab.named("supervisor")
    assert supervisor
    simulated.os.unlink(f"/run/failstop/{simulated.name}/stop")
    simulated.wait_for("its end", lambda: supervisor.code is not None, 2.0)
    assert supervisor.code == 1
    assert "the stop pipe was removed" in simulated.said
