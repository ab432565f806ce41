"""The fault table at every board: its rows, its bars, and a few of them injected; `failstop chaos --board` has all."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from failstop.policy.layouts import BOARDS
from failstop_lab.boards.traits import HAS_ARM_BESIDE, HAS_DRIVERS, HAS_GAMEPAD, HAS_KEYS, SHOWS_DEAF, traits_of
from failstop_lab.faults.arm_table import BESIDE_BY_NAME
from failstop_lab.faults.fault import Fault
from failstop_lab.faults.injection import inject_one
from failstop_lab.faults.report import EVERY, rows_of
from failstop_lab.faults.scene import Scene
from failstop_lab.faults.table import GUARD_ROWS
from tests.support.amounts import LONG
from tests.support.boards import EVERY_KIND

FEW = (
    *("kill-port_owner", "kill-gate+telemetry", "usb-drop-mid-frame", "board-wheel-runs-away", "kill-supervisor"),
    *("kill-supervisor+port_owner+telemetry+stopper", "board-motor-unplugged"),
)
"""Each writer stops once, the stop tool too, and one of them a board that was left in the middle of a frame; and what
the first board can't have."""


@pytest.mark.slow
@pytest.mark.starts
@pytest.mark.parametrize("kind", EVERY_KIND)
def test_rows_of_every_board(kind: str) -> None:
    with Scene(f"board-{os.getpid()}", kind=kind) as scene:
        rows = rows_of(scene.traits)
        for name in rows if LONG else [name for name in FEW if name in rows]:
            outcome = inject_one(scene, rows[name], seed="every board")
            assert not outcome.wrong, outcome.story("every board")


@pytest.mark.slow
@pytest.mark.starts
@pytest.mark.claim("GUARD-1")
@pytest.mark.parametrize("kind", [kind for kind in EVERY_KIND if HAS_DRIVERS in traits_of(kind).parts])
def test_the_guard_port_s_rows_of_every_board_that_has_a_language_for_drivers(kind: str) -> None:
    with Scene(f"guards-{os.getpid()}", kind=kind) as scene:
        for row in GUARD_ROWS:
            outcome = inject_one(scene, row.at(scene.traits), seed="guard")
            assert not outcome.wrong, outcome.story("guard")


def faults(kind: str) -> Iterator[tuple[Fault, Fault]]:
    """The rows of a board, each with the first board's."""
    for name, row in rows_of(traits_of(kind)).items():
        first = EVERY[name]
        if isinstance(row, Fault) and isinstance(first, Fault):
            yield row, first


def test_a_bar_is_the_first_boards_and_the_boards_own_line_and_loop() -> None:
    of_others = [
        name for name, row in EVERY.items() if isinstance(row, Fault) and not row.needs <= traits_of(BOARDS[0]).parts
    ]
    wheels = {"board-wheel-runs-away", "board-motor-unplugged"}
    assert wheels <= set(of_others) <= {*wheels, *(row.name for row in GUARD_ROWS)}
    assert rows_of(traits_of(BOARDS[0])) == {name: row for name, row in EVERY.items() if name not in of_others}
    for kind in EVERY_KIND:
        own_ms = traits_of(kind).own_ns / 1e6
        assert own_ms > 0
        for row, first in faults(kind):
            assert row.bar_ms == (None if first.bar_ms is None else first.bar_ms + own_ms), row.name


def test_a_row_is_absent_where_a_board_has_not_what_it_needs() -> None:
    for kind in EVERY_KIND:
        traits = traits_of(kind)
        absent = EVERY.keys() - rows_of(traits).keys()
        arm = {name for name in EVERY if name.startswith("arm-")}
        beside = set(BESIDE_BY_NAME) if HAS_ARM_BESIDE in traits.parts else set()
        assert absent & arm == arm - beside
        assert ("board-deaf" in absent) == (SHOWS_DEAF not in traits.parts)
        assert {"pad-button", "board-key"} <= absent
        assert not traits.parts & {HAS_GAMEPAD, HAS_KEYS}
        assert "kill-port_owner" not in absent
