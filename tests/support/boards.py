"""Boards: the kinds that tests are run for, and a folder of a user's own."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from failstop.board.kinds import KINDS
from failstop.board.wire import VOCABULARY
from failstop.policy.layouts import BOARDS
from tests.support.pages import ROOT

EVERY_KIND = (*KINDS, *filter(None, [os.environ.get("FAILSTOP_BOARD")]))
"""`make board BOARD=FOLDER` names a folder of one's own."""
every_board = pytest.mark.parametrize("simulated", BOARDS, indirect=True)
"""A test on the simulated machine, with each board in turn."""


def wide(left: float, right: float, wheels: int) -> tuple[float, ...]:
    """Speeds for as many wheels: those of two sides, in turn."""
    return tuple((left, right)[wheel % 2] for wheel in range(wheels))


def own_folder(at: Path) -> str:
    """The smallest board of failstop's, as a user would have it: the same modules, in a folder that failstop does not
    know."""
    at.mkdir()
    sources = {name: f"failstop/board/arduino/{name}.py" for name in ("codec", "driver", "wire")}
    sources["receiver"] = "lab/failstop_lab/boards/arduino.py"
    for name, source in sources.items():
        text = (ROOT / source).read_text()
        text = text.replace("from failstop.board.arduino import", "from . import")
        text = text.replace("_MS = 1_000_000\n", f"_MS = 1_000_000\nVOCABULARY = {VOCABULARY}\n", name == "wire")
        (at / f"{name}.py").write_text(text.replace("from failstop.board.arduino.", "from ."))
    return str(at)
