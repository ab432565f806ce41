"""One service for the live commands."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from failstop.lab.trial import Trial


@pytest.fixture(scope="module")
def service() -> Iterator[Trial]:
    with Trial(f"screen-{os.getpid()}") as running:
        yield running


@pytest.fixture
def trial(service: Trial) -> Iterator[Trial]:
    """The same for every test of a module: nothing latched, motion disabled, nobody else connected."""
    if service.robot.state.estop:
        service.robot.reset()
    service.robot.disable()
    service.leave()
    service.board.events()
    yield service
    service.leave()
