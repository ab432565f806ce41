"""Twins: scenarios that both worlds play, beside those of the campaign."""

from __future__ import annotations

import contextlib
from typing import Any

from failstop.lab.simulate.scenarios import Play, driving

TWINS: dict[str, Play] = {}


def twin(play: Play) -> Play:
    """Declare one."""
    TWINS[play.__name__] = play
    return play


@twin
def commands_time_out(stage: Any) -> None:
    """A program falls silent: the wheels stand, nothing is latched; it goes on."""
    robot = driving(stage, 0.06)
    stage.time.sleep(0.6)
    stage.drive(robot, 0.06)
    robot.close()


@twin
def enable_is_refused_while_a_stop_is_latched(stage: Any) -> None:
    """An enable without a reset changes nothing."""
    robot = driving(stage, 0.06)
    stage.stop(robot)
    stage.time.sleep(0.1)
    with contextlib.suppress(stage.failstop.Refused):
        robot.enable()
    stage.enable(robot)
    stage.drive(robot, 0.06)
    robot.close()


@twin
def second_stop_comes_while_the_first_is_latched(stage: Any) -> None:
    """Two stops, one reset."""
    robot = driving(stage, 0.06)
    stage.stop(robot)
    stage.time.sleep(0.1)
    robot.estop("again")
    stage.time.sleep(0.1)
    stage.enable(robot)
    robot.close()


@twin
def stop_is_asked_for_while_motion_is_disabled(stage: Any) -> None:
    """A stop latches whether or not anything moves."""
    robot = stage.connect()
    stage.stop(robot)
    stage.time.sleep(0.1)
    stage.reset(robot)
    robot.close()


@twin
def pipe_gets_bytes_while_motion_is_disabled(stage: Any) -> None:
    """Any bytes in the pipe are a stop."""
    robot = stage.connect()
    stage.write_to_pipe(b"hand in the arm")
    robot.wait_for("latched", 1.0)
    robot.close()


@twin
def key_is_pressed_twice(stage: Any) -> None:
    """The second key comes while the first one's stop is latched."""
    robot = driving(stage, 0.06)
    stage.press(1)
    robot.wait_for("latched", 1.0)
    stage.time.sleep(0.1)
    stage.press(2)
    stage.time.sleep(0.1)
    robot.close()


@twin
def board_is_replugged_while_motion_is_disabled(stage: Any) -> None:
    """A port that goes and comes back at rest."""
    robot = stage.connect()
    stage.unplug()
    stage.time.sleep(0.1)
    stage.replug()
    robot.wait_for("ready", 3.0)
    stage.time.sleep(0.2)
    stage.enable(robot)
    stage.drive(robot, 0.06)
    robot.close()


@twin
def supervisor_dies_at_rest(stage: Any) -> None:
    """The supervisor dies at rest; its successor starts with the cause latched."""
    stage.connect()
    stage.kill("supervisor")
    robot = stage.connect()
    stage.enable(robot)
    stage.drive(robot, 0.06)
    robot.close()


@twin
def port_owner_dies_twice(stage: Any) -> None:
    """A death, an enable, and a death again."""
    robot = driving(stage, 0.06)
    for _ in range(2):
        stage.kill("port_owner")
        robot.wait_for("latched", 1.0)
        stage.time.sleep(0.2)
        stage.enable(robot)
        stage.drive(robot, 0.06)
    robot.close()


@twin
def gate_dies_at_rest(stage: Any) -> None:
    """A death is a stop, also while nothing moves."""
    robot = stage.connect()
    stage.kill("gate")
    robot.wait_for("latched", 1.0)
    stage.time.sleep(0.2)
    robot.close()


@twin
def driver_leaves_in_order(stage: Any) -> None:
    """A program that closes its Robot while it drives stops nothing but itself."""
    robot = driving(stage, 0.06)
    robot.close()
    stage.time.sleep(0.5)


@twin
def driver_dies_and_motion_is_disabled(stage: Any) -> None:
    """The default: the death of a program that drives disables motion."""
    robot = stage.connect()
    stage.enable(robot)
    driver = stage.start_driver(5.0)
    stage.kill_driver(driver)
    stage.time.sleep(0.2)
    robot.close()


@twin
def speed_is_limited(stage: Any) -> None:
    """A limit holds for the next command."""
    robot = driving(stage, 0.06)
    robot.limit_speed(0.5)
    stage.drive(robot, 0.1)
    stage.disable(robot)
    robot.close()


@twin
def nothing_is_latched_and_a_reset_comes(stage: Any) -> None:
    """A reset of nothing is answered."""
    robot = stage.connect()
    stage.reset(robot)
    robot.close()
