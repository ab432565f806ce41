"""One service for the live commands."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from failstop.files import root
from failstop_lab.trial import Trial, wait_for
from tests.support.shared_trial import IMU_HZ


@pytest.fixture(scope="module")
def service(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Trial]:
    """With the command timeout that `failstop teleop` counts on. A module may say how often the IMU tells (IMU_HZ)."""
    settings = tmp_path_factory.mktemp("screen") / "failstop.toml"
    imu_hz = getattr(request.module, "IMU_HZ", IMU_HZ)
    settings.write_text("gate.lease_s = 0.25\n")
    with Trial(f"screen-{os.getpid()}", ("--config", str(settings)), imu_hz) as running:
        yield running


@pytest.fixture
def trial(service: Trial) -> Iterator[Trial]:
    """A trial for all tests of a module, each from the start: nothing latched, motion disabled, nobody else
    connected."""
    if service.service.process is None or service.service.process.poll() is not None:
        service.service.start()
    if service.robot.state.estop:
        wait_for("a reset to be taken", service.reset)
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
