"""Each process is woken by its own bell, and by the early news of a death."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tests.support import gate_scene, port_scene, stopper_scene, telemetry_scene

SCENES: dict[str, Callable[[], Any]] = {
    "owner": port_scene.Scene,
    "gate": gate_scene.Scene,
    "stopper": stopper_scene.Scene,
    "telemetry": telemetry_scene.Scene,
}
"""By the name that the process has there; the supervisor's is in tests/supervisor/test_watching.py."""


@pytest.mark.parametrize("process", SCENES)
def test_a_ring_wakes_a_process_once(process: str) -> None:
    scene = SCENES[process]()
    loop = getattr(scene, process).loop
    for bell in (scene.bell("bell"), *([] if process == "telemetry" else [scene.early.bell])):
        loop.wait(0)
        bell.ring()
        assert bell.fd in loop.wait(0)
        assert bell.fd not in loop.wait(0)
