"""A stand with a simulated board, for rows that are run one by one."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from failstop.supervisor import status
from failstop_lab.prove.stand import ProveStand
from failstop_lab.sim.client import SimBoard

LEASE: dict[str, object] = {status.LEASE: status.LEASE_WITHOUT_S}
"""The service's own stops of a busy machine are another matter."""


@contextlib.contextmanager
def on_stand(place: Path, **settings: object) -> Iterator[ProveStand]:
    """`place`: a folder for the files of this run."""
    with SimBoard(place / "board") as board, ProveStand(board.link, settings | LEASE, str(place), board) as stand:
        yield stand
