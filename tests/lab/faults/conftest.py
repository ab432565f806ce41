"""One board and one service for every row that they get over; inject_one() makes new ones when they did not."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from failstop_lab.faults.scene import Scene


@pytest.fixture(scope="package")
def scene() -> Iterator[Scene]:
    """Board, service and driving client of a campaign."""
    with Scene(f"faults-{os.getpid()}") as found:
        yield found
