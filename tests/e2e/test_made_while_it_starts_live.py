"""As in test_made_while_it_starts, by threads of this process and a real service, while both cores are busy."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import pytest

from failstop import FailstopError, NoService, Robot
from failstop.api.events import EventLog
from failstop.lab.trial import Trial, TrialError, wait_for
from failstop.messages import layout
from tests.support.amounts import amount

POLL_S = 0.02
POLLERS = 15
"""Programs that poll beside each other, at phases that divide the time between two polls."""
ROUNDS = amount(1, 20)
FOLLOWS_S = 1.0
"""A Robot notices at its next call."""
LOAD = "while True: pass"


class Poller(threading.Thread):
    """A program that polls at 50 Hz until it has the state of a run, and what that tells."""

    def __init__(self, name: str, after_s: float) -> None:
        super().__init__(daemon=True)
        self._service = name
        self._after_s = after_s
        self.found: tuple[Robot, EventLog] | None = None

    def run(self) -> None:
        time.sleep(self._after_s)
        robot = None
        while not self.found:
            time.sleep(POLL_S)
            with contextlib.suppress(FailstopError):
                robot = robot or Robot(self._service)
                log = EventLog(self._service)
                _ = robot.state
                self.found = robot, log

    def deaf(self, pid: int) -> str:
        """The client objects that do not notice, for a second, that there is another run with this supervisor."""
        self.join()
        assert self.found
        robot, log = self.found
        try:
            wait_for("the Robot", lambda: sees(robot, pid), FOLLOWS_S)
            wait_for("the EventLog", lambda: ended(log), FOLLOWS_S)
        except TrialError as error:
            return str(error)
        finally:
            robot.close()
        return ""


def sees(robot: Robot, pid: int) -> bool:
    """True when it tells of the run with this supervisor."""
    with contextlib.suppress(FailstopError):
        return robot.state.processes[layout.SUPERVISOR].pid == pid
    return False


def ended(log: EventLog) -> bool:
    """True when it says that its run has ended."""
    try:
        log.read()
    except NoService:
        return True
    return False


@pytest.fixture
def load() -> Iterator[None]:
    """Give both cores something to do."""
    loads = [subprocess.Popen([sys.executable, "-S", "-c", LOAD]) for _ in range(2)]
    yield
    for each in loads:
        each.kill()
        each.wait()


def test_enough_robots() -> None:
    assert amount(15, 300) <= ROUNDS * POLLERS


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.usefixtures("load")
def test_a_robot_that_is_made_while_the_service_starts_follows_the_next_run(name: str) -> None:
    deaf = []
    with Trial(name) as trial:
        for _ in range(ROUNDS):
            trial.service.kill()
            pollers = [Poller(name, POLL_S * number / POLLERS) for number in range(POLLERS)]
            for poller in pollers:
                poller.start()
            trial.service.start()
            for poller in pollers:
                poller.join()
            trial.service.kill()
            trial.service.start()
            assert trial.service.process
            deaf += [found for poller in pollers if (found := poller.deaf(trial.service.process.pid))]
    assert deaf == []
