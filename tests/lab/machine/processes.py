"""Processes: the stage of lab/failstop_lab/simulate/stage.py on this machine's kernel, for the same scenarios: real
processes, real signals, a simulated board on a pty."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import failstop
from failstop.files import instance
from failstop_lab.machine.robot import COMMAND_EVERY_S
from failstop_lab.simulate.scenarios import Play
from failstop_lab.simulate.stage import ATTENDED, INTERLOCK, INTERLOCKED, OPERATOR, SETTINGS, SPEED_MPS, Continuation
from failstop_lab.trial import Trial, write_settings

CLICKED = 0x20
DRIVER = """\
import sys, time, failstop
robot = failstop.Robot(sys.argv[1])
until = time.monotonic() + float(sys.argv[2])
while time.monotonic() < until:
    robot.sensed()
    robot.drive(float(sys.argv[3]), 0.0, 0.0)
    time.sleep(float(sys.argv[4]))
"""


class Processes:
    """A real service, for what a scenario may do. A context manager."""

    failstop: Any = failstop
    time: Any = time

    def __init__(self, play: Play, name: str, directory: Path) -> None:
        config = directory / "settings.toml"
        write_settings(str(config), SETTINGS.get(play, {}))
        self._play, self._settings = play, SETTINGS.get(play, {})
        self.trial = Trial(name, ("--config", str(config)), imu_hz=20.0)
        self._robots: list[failstop.Robot] = []
        self._drove: set[failstop.Robot] = set()
        self._keep = True
        self._over = threading.Event()
        self._keeper = threading.Thread(target=self._keep_running)

    def __enter__(self) -> Processes:
        self.trial.__enter__()
        self._keeper.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._keeper.join()
        for robot in self._robots:
            robot.close()
        self.trial.close()

    def play(self) -> None:
        """The scenario, from a service that is ready."""
        with contextlib.suppress(failstop.FailstopError):
            self._play(self)  # type: ignore[arg-type]

    @staticmethod
    def branch(rest: Continuation) -> Continuation:
        """The rest of the scenario alone."""
        return rest

    def _keep_running(self) -> None:
        """Start the service when there is none, as systemd does."""
        service = self.trial.service
        while not self._over.wait(0.1):
            if self._keep and service.process and service.process.poll() is not None:
                service.exec()

    # What a scenario may do.

    def connect(self) -> failstop.Robot:
        """A Robot of the run that is there, once there is one."""
        while True:
            try:
                robot = failstop.Robot(self.trial.name)
                self.meet_conditions(robot)
                robot.wait_for("ready", 3.0)
            except (failstop.NoService, failstop.TimedOut):
                time.sleep(0.005)
            else:
                self._robots.append(robot)
                return robot

    def enable(self, robot: failstop.Robot) -> None:
        """Reset where a stop is latched, and enable."""
        self.meet_conditions(robot)
        robot.wait_for("ready", 3.0)
        if robot.state.cause is not None:
            robot.reset()
        if robot in self._drove:
            robot.drive(0.0, 0.0, 0.0)  # else the enable would hold what it commanded just now
        robot.enable()

    def enable_for(self, robot: failstop.Robot) -> None:
        robot.enable()

    def drive(
        self, robot: failstop.Robot, seconds: float, speed_mps: float = SPEED_MPS, *, sensed: bool = True
    ) -> None:
        """Command a speed for so long, while the obstacle sensor delivers, or not."""
        self._drove.add(robot)
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            if sensed:
                robot.sensed()
            robot.drive(speed_mps, 0.0, 0.0)
            time.sleep(COMMAND_EVERY_S)

    def meet_conditions(self, robot: failstop.Robot) -> None:
        """Report an operator and assert an interlock, if motion needs them here."""
        if self._settings.items() >= ATTENDED.items():
            robot.attend(OPERATOR)
        if self._settings.items() >= INTERLOCKED.items():
            robot.assert_interlocks(INTERLOCK)

    def compete(self, *robots: failstop.Robot) -> None:
        """These command one after the other under one source."""
        for robot in robots:
            robot.sensed()
            robot.drive(SPEED_MPS / 2, 0.0, 0.0)

    def lose(self, what: str, within_ms: int) -> None:
        """Nobody judges times here."""

    def stop(self, robot: failstop.Robot, why: str = "hand near wheel") -> None:
        """Ask for a stop, and wait until it is latched."""
        robot.estop(why)
        robot.wait_for("latched", 1.0)

    def reset(self, robot: failstop.Robot) -> None:
        """Clear the latch."""
        robot.wait_for("ready", 3.0)
        robot.reset()

    def disable(self, robot: failstop.Robot) -> None:
        """Forbid motion."""
        robot.disable()

    def must_stop(self, why: str, within_ms: int, by: str = "") -> None:
        """Nobody judges times here."""

    def _pid(self, name: str) -> int:
        service = self.trial.service
        if name == "supervisor":
            assert service.process
            return service.process.pid
        with contextlib.suppress(failstop.FailstopError):
            return service.pids().get(name, 0)
        return 0

    def kill(self, name: str) -> None:
        """SIGKILL a process of the service."""
        if pid := self._pid(name):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def freeze(self, name: str, ms: int) -> None:
        """SIGSTOP, and SIGCONT after so long."""
        pid = self._pid(name)

        def resume() -> None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)

        os.kill(pid, signal.SIGSTOP)
        threading.Timer(ms / 1000, resume).start()

    suspend = freeze

    def unplug(self) -> None:
        self.trial.board.unplug()

    def replug(self) -> None:
        self.trial.board.replug()

    def block_port(self) -> None:
        """The port keeps from now on what is written to it."""
        self.trial.board.stop_draining()

    def free_port(self) -> None:
        """The port passes on what it has kept."""
        self.trial.board.drain()

    def _stop_pipe(self) -> str:
        return next(path for place in instance.places(self.trial.name) if os.path.exists(path := f"{place}/stop"))

    def write_to_pipe(self, data: bytes) -> None:
        """Any bytes in the stop pipe."""
        with open(self._stop_pipe(), "wb", buffering=0) as pipe:
            pipe.write(data)

    def remove_pipe(self) -> None:
        """Take the stop pipe away."""
        os.unlink(self._stop_pipe())

    def start_driver(self, seconds: float) -> subprocess.Popen[bytes]:
        """Start another program, which drives for so long; returns when the wheels turn."""
        words = (self.trial.name, seconds, SPEED_MPS, COMMAND_EVERY_S)
        driver = subprocess.Popen([sys.executable, "-c", DRIVER, *map(str, words)], stderr=subprocess.DEVNULL)
        self.trial.board.wait_wheels(True, 10.0)
        return driver

    def kill_driver(self, driver: subprocess.Popen[bytes]) -> None:
        """SIGKILL that program."""
        driver.kill()
        driver.wait()

    def disturb_command(self, robot: Any) -> None:
        """Command what is no number, around the check of drive()."""
        robot._client().command(float("nan"), 0.0, 0.0, manual=False, source="cmd_vel")

    def deafen(self) -> None:
        """The board hears nothing any more."""
        self.trial.board.deaf(True)

    def hear_again(self) -> None:
        """The board hears again."""
        self.trial.board.deaf(False)

    def press(self, key: int) -> None:
        """A key of the board."""
        self.trial.board.key(key, CLICKED)

    def end_service(self) -> None:
        """SIGTERM, as systemd sends it."""
        self._keep = False
        self.trial.service.end()
        self._keep = True
