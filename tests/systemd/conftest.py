"""The unit on a real systemd, in a container: what the tests of this room start from."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from bench.container import ContainerMissing
from bench.service_scene import HARDY, UNIT, Scene


@pytest.fixture(scope="package")
def shared_scene() -> Iterator[Scene]:
    """One container and board for all tests: each starts and ends the service itself."""
    try:
        made = Scene(HARDY)
    except ContainerMissing as reason:
        pytest.skip(str(reason))
    with made:
        yield made


@pytest.fixture
def scene(shared_scene: Scene) -> Iterator[Scene]:
    """The service, ready. It must end well, and leave nothing."""
    shared_scene.start()
    yield shared_scene
    shared_scene.end()
    assert shared_scene.box.pids(UNIT) == []
