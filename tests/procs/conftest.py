"""Fixtures of the processes' tests."""

from __future__ import annotations

from typing import Any

import pytest

from failstop.board.rrc.board import BOARD
from tests.support import gate_scene, port_scene, stopper_scene
from tests.support.arm_settings import ARM
from tests.support.gate_scene import Scene
from tests.support.stage import PortMachine, Stage, Wire

from .arm_bench import ArmBench, Make
from .client_side import Service
from .gate_bench import Gate


@pytest.fixture
def machine() -> PortMachine:
    """A machine with a board's port."""
    return PortMachine()


@pytest.fixture
def board(machine: PortMachine) -> Wire:
    """The board's side of that port."""
    return machine.wire


@pytest.fixture
def wire(machine: PortMachine) -> Any:
    """The port owner's writing to that port."""
    return machine.load("failstop.procs.port_owner.port_writer").PortWriter(machine.open(machine.wire), BOARD)


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
def scene(request: pytest.FixtureRequest, arm_with: Make) -> Stage:
    """The process at work that a test's file is named for; the gate with an arm whose joints it has read."""
    name = request.path.stem
    if name.startswith("test_gate_arm"):
        return arm_with()
    others = {"test_port_owner": port_scene, "test_schedule": port_scene, "test_stopper": stopper_scene}
    found = next((module for start, module in others.items() if name.startswith(start)), gate_scene)
    return found.Scene()


@pytest.fixture
def bench() -> ArmBench:
    """The arm's core alone, with servos whose places it has read."""
    return ArmBench().known()


@pytest.fixture
def arm_with() -> Make:
    """A scene with other settings, whose joints have been read."""

    def made(**changed: object) -> Scene:
        scene = Scene({**ARM, **{key.replace("__", "."): value for key, value in changed.items()}})
        scene.run(0.4)
        return scene

    return made
