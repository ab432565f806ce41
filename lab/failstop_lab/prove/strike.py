"""How each stop is brought about. Returns the moment that times count from, CLOCK_MONOTONIC ns."""

from __future__ import annotations

import time
from collections.abc import Callable

from failstop_lab.prove import table
from failstop_lab.prove.others import STRIKE
from failstop_lab.prove.stand import ProveStand
from failstop_lab.prove.table import Path

PRESS_S = 20.0
"""A person has so long to press a button."""
SIM_BUTTONS = (0x0100, 0x0200)
"""One of these is pressed on a simulated board: whichever is not the robot's MODE button."""

Ask = Callable[[str], None]
"""Tells a person what to do."""


class Skipped(Exception):
    """The path can't be taken here; says why."""


def strike(path: Path, stand: ProveStand, ask: Ask | None) -> int:
    """Bring about what is not done to processes, while the wheels turn. `ask`: None when there is nobody to do
    anything. Raises Skipped."""
    driver = stand.driver
    if path.kind == table.TIMEOUT:
        driver.commands = False
        return driver.commanded_ns
    if path.kind == table.SCAN:
        driver.senses = False
        return driver.sensed_ns
    if path.kind == table.PAD_STOP:
        return _press(stand, ask)
    now_ns = time.monotonic_ns()
    if path.kind == table.STOP_REQUEST:
        stand.ask(STRIKE)
    elif path.kind == table.DISABLING:
        driver.robot.disable()
    elif stand.service.process:
        stand.service.process.terminate()
    return now_ns


def _press(stand: ProveStand, ask: Ask | None) -> int:
    """The frame's own time: what happens before it, in the pad and on the air, is not failstop's."""
    known = len(stand.watch.buttons)
    ignored = int(stand.settings["pad.mode_button"])

    def pressed() -> bool:
        return any(buttons & ~ignored for _, buttons in stand.watch.buttons[known:])

    if stand.board:
        stand.board.pad(buttons=next(button for button in SIM_BUTTONS if button != ignored))
    elif ask:
        ask(f"the wheels are turning: press a button of the gamepad (not MODE) within {PRESS_S:g} s")
    if not stand.run(PRESS_S, pressed):
        raise Skipped("no press of a button arrived")
    return next(t_ns for t_ns, buttons in stand.watch.buttons[known:] if buttons & ~ignored)
