"""Scenarios: what a program and the world do in a simulated run, before the faults of the campaign."""

from __future__ import annotations

from collections.abc import Callable

from failstop.lab.machine.robot import MS
from failstop.lab.machine.stage import Stage

SCENARIOS: dict[str, Callable[[Stage], object]] = {}


def scenario(play: Callable[[Stage], object]) -> Callable[[Stage], object]:
    """Declare one."""
    SCENARIOS[play.__name__] = play
    return play


@scenario
def drive_and_stop(stage: Stage) -> None:
    """Enable, drive, stop, reset, enable, drive, disable."""
    robot = stage.connect()
    stage.enable(robot)
    stage.drive(robot, 0.06)
    stage.stop(robot)
    stage.enable(robot)
    stage.drive(robot, 0.06)
    robot.disable()
    stage.witness.must_stop("a program disabled motion", 30 * MS)
    robot.close()


def _death(name: str) -> None:
    def play(stage: Stage) -> None:
        robot = stage.connect()
        stage.enable(robot)
        stage.drive(robot, 0.04)
        stage.kill(name)
        stage.drive(robot, 0.04)

    play.__name__ = f"{name}_dies"
    scenario(play)


for _name in ("supervisor", "port_owner", "gate", "telemetry", "stopper"):
    _death(_name)


@scenario
def replug(stage: Stage) -> None:
    """The board is unplugged while it drives, and is back."""
    robot = stage.connect()
    stage.enable(robot)
    stage.drive(robot, 0.04)
    stage.unplug()
    stage.time.sleep(0.03)
    stage.replug()
    stage.time.sleep(0.03)


@scenario
def reset_races_stop(stage: Stage) -> None:
    """A reset is under way when another stop is asked for."""
    robot = stage.connect()
    stage.enable(robot)
    stage.drive(robot, 0.04)
    stage.stop(robot)
    robot.reset()
    stage.stop(robot, "again")
    stage.enable(robot)
    stage.drive(robot, 0.02)


@scenario
def machine_sleeps(stage: Stage) -> None:
    """The machine sleeps while it drives."""
    robot = stage.connect()
    stage.enable(robot)
    stage.drive(robot, 0.04)
    stage.sleep_machine(20.0)
    stage.drive(robot, 0.04)


@scenario
def service_ends(stage: Stage) -> None:
    """The service is told to end while it drives."""
    robot = stage.connect()
    stage.enable(robot)
    stage.drive(robot, 0.04)
    stage.end_service()
