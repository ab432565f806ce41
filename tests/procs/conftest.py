"""What the gate's tests start from."""

from __future__ import annotations

import pytest

from .gate_bench import Gate


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
