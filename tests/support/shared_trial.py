"""One service for many tests: each finds it as it was at its start, and the next one gets a new one if it is not."""

from __future__ import annotations

import itertools
import os

from failstop import FailstopError, Robot
from failstop.lab.trial import Trial, wait_for
from failstop.messages.layout import GATE

HELD_UP_S = 0.035
"""A gate that was once late by so much, its period included, shows that for as long as it lives."""
IMU_HZ = 20.0
"""Enough for the tests of the service: each of the 110 samples a second of a real board wakes three processes."""
_numbers = itertools.count()


class Keeper:
    """Keeps a service between two tests."""

    def __init__(self, prefix: str) -> None:
        self._prefix = prefix
        self._trial: Trial | None = None
        self._pids: dict[str, int] = {}

    def take(self) -> Trial:
        """The service: whole, disabled, with nothing latched and nobody connected. Where the last test has left it
        otherwise, and it does not come to rest, it is another one."""
        if self._trial and not self._is_as_new(self._trial):
            self.end()
        if self._trial is None:
            self._trial = Trial(f"{self._prefix}-{os.getpid()}-{next(_numbers)}", imu_hz=IMU_HZ)
            self._trial.__enter__()
            self._pids = self._trial.service.pids()
        self._trial.board.events()
        return self._trial

    def _is_as_new(self, trial: Trial) -> bool:
        try:
            if trial.robot.state.estop:
                wait_for("a reset to be taken", trial.reset)
            trial.robot.disable()
            trial.leave()
            trial.board.wait_wheels(moving=False, timeout_s=5.0)
            with Robot(trial.name) as robot:
                wait_for("everybody to have left", lambda: not robot.state.clients)
                state = robot.state
        except FailstopError:
            return False  # the test has ended it, or a process of it
        worst_s = state.processes[GATE].worst_s
        whole = (state.waiting_for, state.estop, state.speed_limit) == (None, None, 1.0)
        return whole and worst_s < HELD_UP_S and trial.service.pids() == self._pids

    def end(self) -> None:
        """End the service, which must end well."""
        if trial := self._trial:
            self._trial = None
            trial.close()


def goes_on(trial: Trial, velocity: tuple[float, float, float] = (0.2, 0.0, 0.0)) -> None:
    """Command until the wheels turn: on a busy machine a command may be late, and they stand meanwhile."""
    wait_for("the wheels to turn", lambda: trial.drive(0.05, velocity) or trial.moving())


def set_off(trial: Trial) -> None:
    """Enable, and drive; the board's past is forgotten."""
    trial.enable()
    goes_on(trial)
    trial.board.events()
