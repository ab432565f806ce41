"""A board that is unplugged while the wheels turn, and comes back."""

from __future__ import annotations

import time

from failstop.lab.sim.client import Event
from failstop.lab.trial import Trial, wait_for


def lose_while_driving(trial: Trial) -> None:
    """Enable, drive, unplug."""
    trial.enable()
    trial.drive(0.2)
    assert trial.moving()
    trial.board.unplug()
    wait_for("the loss to be seen", lambda: trial.robot.state.device.state == "lost")


def stop_at_return(trial: Trial) -> tuple[Event, float]:
    """Plug in again; returns the first motor frame that the board executes, and the seconds to it."""
    trial.board.events()
    back_ns = time.monotonic_ns()
    trial.board.replug()
    event = trial.board.wait_for(lambda e: e.is_motor and e.arrival_ns > back_ns, 10.0)
    return event, (event.arrival_ns - back_ns) / 1e9


def drives_only_when_enabled(trial: Trial) -> None:
    """Commands alone move nothing; after an enable they do."""
    wait_for("a service that is whole", lambda: trial.robot.state.waiting_for is None)
    trial.drive(0.1)
    assert not trial.moving()
    trial.enable()
    trial.drive(0.2)
    assert trial.moving()
