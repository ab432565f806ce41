"""What the gate's tests start from."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.arm_settings import ARM
from tests.support.gate_scene import Scene

from .arm_bench import ArmBench
from .arm_notes import Make
from .arm_scene import ArmScene
from .client_side import Service
from .gate_bench import Gate


@pytest.fixture
def service(tmp_path: Path) -> Iterator[Service]:
    """The gate's table of clients, and the clients' side of it."""
    made = Service(tmp_path)
    yield made
    made.close()


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
def gate_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Scene]:
    """The process at work, not only its core."""
    made = Scene(tmp_path, monkeypatch)
    yield made
    made.close()


@pytest.fixture
def arm_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ArmScene]:
    """The process at work, with an arm whose joints it has read."""
    made = ArmScene(tmp_path, monkeypatch)
    made.run(0.4)
    yield made
    made.close()


@pytest.fixture
def arm_bench() -> ArmBench:
    """The arm's core alone, with servos whose places it has read."""
    return ArmBench().known()


@pytest.fixture
def arm_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Make:
    """A scene with other settings, whose joints have been read."""

    def made(**changed: object) -> ArmScene:
        values = {key.replace("__", "."): value for key, value in changed.items()}
        monkeypatch.setattr(ArmScene, "changed", {**ARM, **values})
        scene = ArmScene(tmp_path, monkeypatch)
        request.addfinalizer(scene.close)
        scene.run(0.4)
        return scene

    return made
