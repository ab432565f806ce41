"""A service on a simulated board, and its page."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator

import pytest

from bench.web.parts import Web
from failstop.lab.trial import Trial

_numbers = itertools.count()


@pytest.fixture(scope="module")
def trial() -> Iterator[Trial]:
    """Board, service and client with the default settings."""
    with Trial(f"web-{os.getpid()}-{next(_numbers)}") as running:
        yield running


@pytest.fixture(scope="module")
def web(trial: Trial) -> Iterator[Web]:
    """The page of it."""
    with Web(trial.name) as running:
        yield running
