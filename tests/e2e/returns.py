"""A board that is unplugged while the wheels turn, and comes back."""

from __future__ import annotations

import time

from failstop.lab.sim.client import Event
from failstop.lab.trial import Trial, wait_for
from tests.support.shared_trial import set_off


def lose_while_driving(trial: Trial) -> None:
    """Enable, drive, unplug."""
    set_off(trial)
    trial.board.unplug()
    wait_for("the loss to be seen", lambda: trial.robot.state.device.state == "lost")


def stop_at_return(trial: Trial) -> Event:
    """Plug in again; returns the first motor frame that the board executes."""
    trial.board.events()
    back_ns = time.monotonic_ns()
    trial.board.replug()
    return trial.board.wait_for(lambda e: e.is_motor and e.arrival_ns > back_ns, 10.0)


def drives_only_when_enabled(trial: Trial) -> None:
    """Commands alone move nothing; after an enable they do."""
    wait_for("a service that is whole", lambda: trial.robot.state.waiting_for is None)
    trial.drive(0.1)
    assert not trial.turning()
    set_off(trial)
