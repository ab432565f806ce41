"""Robots that are made while the service starts, by programs that poll for it: each of them follows the next run."""

from __future__ import annotations

from typing import Any

from failstop.messages import layout
from tests.support.simulated import Simulated

POLL_S = 0.02
POLLERS = 40
"""Programs that poll beside each other, at phases that divide the time between two polls."""
FOLLOWS_S = 1.0
"""A Robot notices at its next call."""


class Poller:
    """A program that polls until it has the state of a run, and then looks whether that is over."""

    def __init__(self, simulated: Simulated, number: int) -> None:
        self._simulated = simulated
        self._after_s = POLL_S * number / POLLERS
        self.saw = 0
        """The supervisor of the run that it found first."""
        self.sees = 0
        self.ended = False
        simulated.program(f"poller{number}.py", self._poll)

    def _poll(self, failstop: Any) -> None:
        events = self._simulated.load("failstop.api.events")
        self._simulated.wait(self._after_s)
        robot: Any = None
        log: Any = None
        while not self.saw:
            self._simulated.wait(POLL_S)
            try:
                robot = robot or failstop.Robot()
                log = events.EventLog(self._simulated.name)
                self.saw = robot.state.processes[layout.SUPERVISOR].pid
            except failstop.FailstopError:
                continue
        while not self.ended or self.sees == self.saw:
            self._simulated.wait(POLL_S)
            try:
                self.sees = robot.state.processes[layout.SUPERVISOR].pid
                log.read()
            except failstop.NoService:
                self.ended = True
            except failstop.FailstopError:
                continue


def test_a_robot_that_is_made_while_the_service_starts_follows_the_next_run(simulated: Simulated) -> None:
    def end() -> None:
        simulated.leave()
        simulated.die(layout.SUPERVISOR)
        simulated.wait_for("the last process to end", lambda: not simulated.living())

    end()
    pollers = [Poller(simulated, number) for number in range(POLLERS)]
    simulated.start()
    simulated.wait_for("every poller to have found it", lambda: all(poller.saw for poller in pollers))
    first = simulated.pids()[layout.SUPERVISOR]
    assert {poller.saw for poller in pollers} == {first}
    end()
    simulated.start()
    second = simulated.pids()[layout.SUPERVISOR]
    simulated.wait(FOLLOWS_S)
    assert second != first
    assert [number for number, poller in enumerate(pollers) if poller.sees != second] == [], "the Robot"
    assert [number for number, poller in enumerate(pollers) if not poller.ended] == [], "the EventLog"
