"""What the supervisor's tests begin with."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from tests.support.supervisor_scene import Scene


@pytest.fixture
def scene() -> Scene:
    """A supervisor whose processes are still to be started."""
    return Scene()


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    """A pipe of the kernel's own: what is read, what is written."""
    ends = os.pipe()
    yield ends
    for fd in ends:
        os.close(fd)
