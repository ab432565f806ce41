"""A robot for the programs of the pages."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator

import pytest

from failstop_lab.trial import Trial

_numbers = itertools.count()


@pytest.fixture
def trial() -> Iterator[Trial]:
    """A simulated board, a service of its own and a client."""
    with Trial(f"page-{os.getpid()}-{next(_numbers)}") as made:
        yield made
