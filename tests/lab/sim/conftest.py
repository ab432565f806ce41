"""A simulated board of its own for each test, and its port opened as the service does."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.board.port import open_port
from failstop.board.rrc.board import RRC_PORT
from failstop_lab.sim.client import SimBoard


@pytest.fixture
def board(tmp_path: Path) -> Iterator[SimBoard]:
    with SimBoard(tmp_path / "board") as running:
        yield running


@pytest.fixture
def client(board: SimBoard) -> Iterator[int]:
    """The port, opened as the service does."""
    descriptor = open_port(board.link, exclusive=True, line=RRC_PORT)
    yield descriptor
    os.close(descriptor)
