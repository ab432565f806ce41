"""One service for many tests: each finds it as it was at its start, and the next one gets a new one if it is not."""

from __future__ import annotations

import fcntl
import itertools
import os
import shutil
import sys
import tempfile
import termios
from pathlib import Path

from failstop import FailstopError, Robot
from failstop.files import instance
from failstop.messages.layout import GATE
from failstop.supervisor import status
from failstop_lab.trial import Trial, wait_for, write_settings

HELD_UP_S = 0.035
"""A gate that was once late by so much, its period included, shows that for as long as it lives."""
IMU_HZ = 20.0
"""Enough for the tests of the service where the IMU judges nothing: each of the 110 samples a second of a real board
wakes three processes."""
_numbers = itertools.count()


def patient(folder: Path) -> tuple[str, str]:
    """The option of a service with the lease that an ordinary user's has: a machine that withholds its processors now
    and then keeps it, and no stop comes for that before the one that a test is about."""
    path = folder / "patient.toml"
    write_settings(str(path), {status.LEASE: status.LEASE_WITHOUT_S})
    return "--config", str(path)


class Keeper:
    """Keeps a service between two tests."""

    def __init__(self, prefix: str) -> None:
        self._prefix = prefix
        self._folder = Path(tempfile.mkdtemp(prefix=f"{prefix}-"))
        self._trial: Trial | None = None
        self._pids: dict[str, int] = {}

    def take(self) -> Trial:
        """The service: whole, disabled, with nothing latched and nobody connected. Where the last test has left it
        otherwise, and it does not come to rest, it is another one."""
        if self._trial and not self._is_as_new(self._trial):
            self._end()
        if self._trial is None:
            name = f"{self._prefix}-{os.getpid()}-{next(_numbers)}"
            self._trial = Trial(name, patient(self._folder), imu_hz=IMU_HZ)
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
            trial.board.wait_wheels(turning=False, timeout_s=5.0)
            with Robot(trial.name) as robot:
                wait_for("everybody to have left", lambda: not robot.state.clients)
                state = robot.state
        except FailstopError:
            return False  # the test has ended it, or a process of it
        worst_s = state.processes[GATE].worst_s
        whole = (state.waiting_for, state.estop, state.speed_limit) == (None, None, 1.0)
        return whole and worst_s < HELD_UP_S and trial.service.pids() == self._pids

    def end(self) -> None:
        """End the service, which must end well; there is no other one."""
        shutil.rmtree(self._folder)
        self._end()

    def _end(self) -> None:
        if trial := self._trial:
            self._trial = None
            trial.close()


def goes_on(trial: Trial, velocity: tuple[float, float, float] = (0.2, 0.0, 0.0)) -> None:
    """Command until the wheels turn: on a busy machine a command may be late, and they stand meanwhile."""
    wait_for("the wheels to turn", lambda: trial.drive(0.05, velocity) or trial.turning())


def set_off(trial: Trial) -> None:
    """Enable, and drive; the board's past is forgotten."""
    trial.enable()
    goes_on(trial)
    trial.board.events()


def unheard(name: str) -> int:
    """Bytes in the stop pipe, of who has ended too: the port owner lets the pipe rest after a request."""
    pipe = os.open(instance.stop_path(instance.find(name)), os.O_WRONLY | os.O_NONBLOCK)
    try:
        return int.from_bytes(fcntl.ioctl(pipe, termios.FIONREAD, bytes(4)), sys.byteorder)
    finally:
        os.close(pipe)
