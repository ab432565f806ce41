"""Imports of the modules that a stop needs: each costs time before the first byte is out."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
HEAVY = """dataclasses typing enum re inspect pathlib logging argparse json subprocess ctypes numpy serial pwd grp"""
HEAVIER = "collections collections.abc functools contextlib"
"""Modules that the port alone may import."""


@pytest.mark.parametrize(
    "module",
    [
        "failstop.board.port",
        *(f"failstop.board.rrc.{name}" for name in ("codec", "burst", "decoder")),
        "failstop_lab.sim.motors",
    ],
)
def test_a_module_of_the_stop_path_imports_nothing_heavy(module: str) -> None:
    # Without site, so that what the environment brings along is not counted.
    program = f"import sys; sys.path[:0] = {[str(ROOT), str(ROOT / 'lab')]!r}; import {module}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-S", "-c", program], capture_output=True, text=True, timeout=60, check=True)
    loaded = set(done.stdout.split())
    assert module in loaded
    assert not loaded.intersection(HEAVY.split())
    assert module == "failstop.board.port" or not loaded.intersection(HEAVIER.split())
