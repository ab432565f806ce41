"""Twins: scenarios that both worlds play, beside those of the campaign. A script is verbs and, as numbers, seconds."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

from failstop_lab.simulate.scenarios import Play, driving

SHORT_S = 0.06


def _try_to_enable(stage: Any, robot: Any) -> None:
    with contextlib.suppress(stage.failstop.Refused):
        robot.enable()


def _until_gone(stage: Any, robot: Any) -> None:
    """A program that connects before that finds the run that dies."""
    with contextlib.suppress(stage.failstop.NoService):
        while robot.state:
            stage.time.sleep(0.005)


BEGIN: dict[str, Callable[[Any], Any]] = {
    "connect": lambda stage: stage.connect(),
    "set_off": lambda stage: driving(stage, SHORT_S),
}
VERBS: dict[str, Callable[..., object]] = {
    "drive": lambda stage, robot: stage.drive(robot, SHORT_S),
    "enable": lambda stage, robot: stage.enable(robot),
    "try_to_enable": _try_to_enable,
    "disable": lambda stage, robot: stage.disable(robot),
    "reset": lambda stage, robot: stage.reset(robot),
    "stop": lambda stage, robot: stage.stop(robot),
    "stop_again": lambda stage, robot: robot.estop("again"),
    "close": lambda stage, robot: robot.close(),
    "limit": lambda stage, robot: robot.limit_speed(0.5),
    "wait_for": lambda stage, robot, what: robot.wait_for(what, 3.0),
    "kill": lambda stage, robot, process: stage.kill(process),
    "freeze": lambda stage, robot, process, ms: stage.freeze(process, int(ms)),
    "no_number": lambda stage, robot: stage.disturb_command(robot),
    "press": lambda stage, robot, key: stage.press(int(key)),
    "pipe": lambda stage, robot: stage.write_to_pipe(b"hand in the arm"),
    "until_gone": _until_gone,
    "unplug": lambda stage, robot: stage.unplug(),
    "replug": lambda stage, robot: stage.replug(),
    "lose_driver": lambda stage, robot: stage.kill_driver(stage.start_driver(5.0)),
}
SCRIPTS = {
    "commands_time_out": "set_off, 0.6, drive",
    "enable_is_refused_while_a_stop_is_latched": "set_off, stop, 0.1, try_to_enable, enable, drive",
    "second_stop_comes_while_the_first_is_latched": "set_off, stop, 0.1, stop_again, 0.1, enable",
    "stop_is_asked_for_while_motion_is_disabled": "connect, stop, 0.1, reset",
    "pipe_gets_bytes_while_motion_is_disabled": "connect, pipe, wait_for latched",
    "key_is_pressed_twice": "set_off, press 1, wait_for latched, 0.1, press 2, 0.1",
    "board_is_replugged_while_motion_is_disabled": ("connect, unplug, 0.1, replug, wait_for ready, 0.2, enable, drive"),
    "supervisor_dies_at_rest": "connect, kill supervisor, until_gone, connect, enable, drive",
    "port_owner_dies_twice": (
        "set_off, kill port_owner, wait_for latched, 0.2, enable, drive, "
        "kill port_owner, wait_for latched, 0.2, enable, drive"
    ),
    "gate_dies_at_rest": "connect, kill gate, wait_for latched, 0.2",
    "driver_leaves_in_order": "set_off, close, 0.5",
    "driver_dies_and_motion_is_disabled": "connect, enable, lose_driver, 0.2",
    "speed_is_limited": "set_off, limit, drive, disable",
    "nothing_is_latched_and_a_reset_comes": "connect, reset",
    "telemetry_dies_at_rest": "connect, kill telemetry, wait_for latched, 0.2",
    "stopper_dies_at_rest": "connect, kill stopper, wait_for latched, 0.2",
    "port_owner_dies_at_rest": "connect, kill port_owner, wait_for latched, 0.2",
    "gate_hangs_at_rest": "connect, freeze gate 400, wait_for latched, 0.4",
    "telemetry_hangs_at_rest": "connect, freeze telemetry 700, wait_for latched, 0.4",
    "stopper_hangs_at_rest": "connect, freeze stopper 400, wait_for latched, 0.4",
    "gate_dies_twice": (
        "set_off, kill gate, wait_for latched, 0.2, enable, drive, kill gate, wait_for latched, 0.2, enable, drive"
    ),
    "telemetry_dies_and_it_drives_again": "set_off, kill telemetry, wait_for latched, 0.2, enable, drive, disable",
    "stopper_dies_and_it_drives_again": "set_off, kill stopper, wait_for latched, 0.2, enable, drive, disable",
    "port_owner_dies_while_a_stop_is_latched": "set_off, stop, 0.1, kill port_owner, 0.3, enable, drive, disable",
    "gate_dies_while_a_stop_is_latched": "set_off, stop, 0.1, kill gate, 0.3, enable, drive, disable",
    "supervisor_dies_while_a_stop_is_latched": (
        "set_off, stop, 0.1, kill supervisor, until_gone, connect, enable, drive, disable"
    ),
    "pipe_gets_bytes_twice": "set_off, pipe, wait_for latched, 0.1, pipe, 0.1",
    "key_is_pressed_while_a_stop_is_latched": "set_off, stop, 0.1, press 1, 0.1, enable, drive",
    "key_is_pressed_while_motion_is_disabled": "connect, press 1, wait_for latched, 0.1, reset",
    "board_is_replugged_while_a_stop_is_latched": (
        "set_off, stop, 0.1, unplug, 0.1, replug, wait_for ready, 0.2, enable, drive, disable"
    ),
    "board_is_replugged_twice": (
        "set_off, unplug, 0.1, replug, wait_for ready, 0.2, enable, drive, "
        "unplug, 0.1, replug, wait_for ready, 0.2, enable, drive"
    ),
    "command_is_no_number": "set_off, no_number, wait_for latched, 0.1, enable, drive, disable",
    "motion_is_disabled_and_enabled_again": "set_off, disable, 0.1, enable, drive, disable",
    "one_program_follows_another": "set_off, disable, close, set_off, disable",
    "reset_comes_after_each_of_two_stops": "set_off, stop, 0.1, reset, enable, drive, stop, 0.1, reset",
}


def _play(script: str) -> Play:
    def play(stage: Any) -> None:
        robot: Any = None
        for step in script.split(", "):
            verb, *words = step.split()
            if verb in BEGIN:
                robot = BEGIN[verb](stage)
            elif verb in VERBS:
                VERBS[verb](stage, robot, *words)
            else:
                stage.time.sleep(float(verb))
        robot.close()

    return play


TWINS: dict[str, Play] = {name: _play(script) for name, script in SCRIPTS.items()}
