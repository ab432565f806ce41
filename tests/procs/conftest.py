"""What the gate's tests start from."""

from __future__ import annotations

import pytest

from tests.support.arm_settings import ARM
from tests.support.gate_scene import Scene

from .client_side import Service
from .gate_bench import Gate


@pytest.fixture
def service() -> Service:
    """The gate's table of clients, and the clients' side of it."""
    return Service()


@pytest.fixture
def gate() -> Gate:
    """Disabled, as at the start."""
    return Gate()


@pytest.fixture
def driving(gate: Gate) -> Gate:
    """Enabled, at full speed forward, a fresh command."""
    gate.enable()
    gate.drive((0.2, 0.0, 0.0), 40)
    assert gate.core.velocity == (0.2, 0.0, 0.0)
    return gate


@pytest.fixture
def scene() -> Scene:
    """The process at work, not only its core."""
    return Scene()


@pytest.fixture
def arm_scene() -> Scene:
    """The process at work, with an arm whose joints it has read."""
    made = Scene(ARM)
    made.run(0.4)
    return made
