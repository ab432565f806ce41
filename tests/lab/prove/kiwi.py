"""A stand of a robot whose arm may move beside its wheels."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from failstop.supervisor import status
from failstop_lab.faults.arm import BESIDE
from failstop_lab.prove.arm_run import ArmRun
from failstop_lab.prove.character import characterize
from failstop_lab.prove.sight import Sight
from failstop_lab.prove.stand import ProveStand
from failstop_lab.prove.table import plan, within
from failstop_lab.sim.client import SimBoard

Kiwi = tuple[ProveStand, Sight]
"""The stand, and how its wheels show that they stand."""


@contextlib.contextmanager
def standing(place: Path, **more: object) -> Iterator[Kiwi]:
    """`more`: further settings. A process has one stand at a time."""
    settings = {"board.kind": "feetech", status.LEASE: status.LEASE_WITHOUT_S, **BESIDE, **more}
    with (
        SimBoard(place / "board", board="feetech") as board,
        ProveStand(board.link, settings, str(place), board) as made,
    ):
        yield made, characterize(made, within(made.settings)[:1], quick=True)


def beside(kiwi: Kiwi, name: str) -> ArmRun:
    """The run of one path."""
    stand, sight = kiwi
    ((path, velocity),) = plan(quick=True, only=(name,), has_arm=True, beside=True, settings=stand.settings)
    return ArmRun(stand, path.under(stand.settings), velocity, sight)
