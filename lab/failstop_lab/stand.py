"""The stand of a campaign: a run of the service of its own, the client that drives it, and the simulated board, where
there is one, whose word counts."""

from __future__ import annotations

import signal

from failstop.api.client import send_stop
from failstop_lab.faults.driving import Driver
from failstop_lab.sim.client import SimBoard
from failstop_lab.trial import Service, TrialError


class Stand:
    """A stand as every campaign uses it. A campaign that holds the run by more than the driver extends let_go()."""

    def __init__(self, service: Service, driver: Driver, board: SimBoard | None) -> None:
        """`board`: None on a robot."""
        self.name = service.name
        self.service, self.driver, self.board = service, driver, board

    def ask(self, reason: str) -> None:
        """A stop request. Raises FailstopError."""
        send_stop(self.name, reason)

    def let_go(self) -> None:
        """Let go of everything by which this process holds the run."""
        self.driver.leave()

    def whole(self) -> bool:
        """The service is ready, with all its processes."""
        try:
            return self.service.ready()
        except TrialError:
            return False

    def bury(self) -> None:
        """End what is left of a run; nothing of it stays frozen or alive."""
        self.let_go()
        self.service.kill()
        self.service.kill_known()

    def end(self) -> None:
        """End a run in order where that is possible; nothing of it stays frozen or alive."""
        self.let_go()
        self.service.signal_known(signal.SIGCONT)
        try:
            self.service.end()
        except TrialError:
            self.service.kill()
        self.service.kill_known()
