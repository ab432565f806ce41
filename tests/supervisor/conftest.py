"""Fixtures of the supervisor's tests."""

from __future__ import annotations

import pytest

from tests.support.supervisor_scene import Scene


@pytest.fixture
def scene() -> Scene:
    """A supervisor whose processes are still to be started."""
    return Scene()
