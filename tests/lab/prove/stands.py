"""A stand with a simulated board, for rows that are run one by one."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from failstop_lab.prove.stand import ProveStand
from failstop_lab.sim.client import SimBoard

LEASE: dict[str, object] = {"gate.lease_s": 0.2}
"""The service's own stops of a busy machine are another matter."""


@contextlib.contextmanager
def on_stand(tmp_path: Path) -> Iterator[ProveStand]:
    with SimBoard(tmp_path / "board") as board, ProveStand(board.link, LEASE, str(tmp_path), board) as stand:
        yield stand
