"""One service for the tests of a file: each leaves it disabled, with nothing latched."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator

import pytest

from failstop.supervisor import status
from failstop_lab.trial import Trial, write_settings

_numbers = itertools.count()


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Trial]:
    config = tmp_path_factory.mktemp("api") / "failstop.toml"
    write_settings(str(config), {"sources.teleop.priority": 10, status.LEASE: status.LEASE_WITHOUT_S})
    with Trial(f"api-{os.getpid()}-{next(_numbers)}", ("--config", str(config))) as running:
        yield running


@pytest.fixture
def trial(service: Trial) -> Iterator[Trial]:
    yield service
    if service.robot.state.cause:
        service.enable()
    service.robot.disable()
    service.leave()
