"""Rows of the fault table on the service that the page of the documentation shows, without a browser."""

from __future__ import annotations

import sys
from typing import Any

import pytest

from failstop_lab.browser.acts import ACT_BY_NAME, ROWS, SWITCHES, TENTH
from failstop_lab.browser.build import modules
from failstop_lab.browser.show import ACT_BODIES, Show
from failstop_lab.faults.fault import BY_ENABLE, BY_ITSELF, BY_NEW_RUN, BY_RESET
from failstop_lab.faults.table import FAULT_BY_NAME
from tests.support.amounts import LONG
from tests.support.robot_page import play

NAMES = tuple(ROWS) if LONG else ("kill-port_owner", "hang-supervisor", "client-killed", "scan-silent", "board-deaf")


class Buttons:
    """The page's buttons, pressed on the service itself."""

    def __init__(self) -> None:
        self.show = Show()

    def press(self, act: str) -> None:
        self.show.act(act)

    def step(self) -> None:
        self.show.turn(0.1)

    def shown(self) -> dict[str, Any]:
        return self.show.shown()


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_fault_on_the_page_ends_as_its_row_says(name: str) -> None:
    page = Buttons()
    try:
        play(page, name)
    finally:
        page.show.machine.end()


def test_the_page_has_every_module_that_it_asks_for() -> None:
    """Those of a kill and a reset, and those of this process."""
    page = Buttons()
    play(page, "kill-gate")
    page.show.machine.end()
    names = {name.removesuffix(".py").removesuffix("/__init__").replace("/", ".") for _, name in modules()}
    own = {
        name for name in sys.modules if name.startswith(("failstop_lab.browser", "failstop_lab.machine", "msgpack."))
    }
    assert {*page.show.robot.loader.loaded(), *own} - {"msgpack._cmsgpack"} <= names


def test_the_rows_are_rows_and_the_acts_do_something() -> None:
    assert len(ROWS) >= 20
    assert ROWS.keys() <= FAULT_BY_NAME.keys()
    assert {FAULT_BY_NAME[name].cleared for name in ROWS} == {BY_RESET, BY_ENABLE, BY_ITSELF, BY_NEW_RUN}
    assert {act for acts in ROWS.values() for act in acts} <= {*ACT_BY_NAME, TENTH}
    pressed = {name for name in ACT_BY_NAME if not name.startswith("kill-")} - set(SWITCHES)
    assert pressed == ACT_BODIES.keys()
