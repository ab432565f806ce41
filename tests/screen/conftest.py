"""One service for the live commands."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from failstop.files import root
from failstop.lab.trial import Trial


@pytest.fixture(scope="module")
def service() -> Iterator[Trial]:
    with Trial(f"screen-{os.getpid()}") as running:
        yield running


@pytest.fixture
def trial(service: Trial) -> Iterator[Trial]:
    """A trial for all tests of a module, each from the start: nothing latched, motion disabled, nobody else
    connected."""
    if service.robot.state.estop:
        service.robot.reset()
    service.robot.disable()
    service.leave()
    service.board.events()
    yield service
    service.leave()


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Makes this a machine where systemd runs and has a unit of that name; until then nothing is installed."""
    monkeypatch.setenv(root.VARIABLE, str(tmp_path))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "run"))
    (tmp_path / "run").mkdir()

    def install(unit: str) -> None:
        folder = tmp_path / "etc/systemd/system"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / unit).touch()
        (tmp_path / "run/systemd/system").mkdir(parents=True, exist_ok=True)

    return install
