"""Telemetry on a stage, for each test that asks for it."""

from __future__ import annotations

import pytest

from tests.support.telemetry_scene import Scene


@pytest.fixture
def scene() -> Scene:
    return Scene()
