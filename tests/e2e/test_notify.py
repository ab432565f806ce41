"""The service and its service manager: ready when motion could be enabled, a status that is true, a watchdog's beat."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.lab.trial import Trial, TrialError, wait_for
from tests.support.shared_trial import IMU_HZ, set_off

TIMEOUT_S = 0.5


class Manager:
    """The service manager's socket, and all that came to it."""

    def __init__(self, path: Path) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
        self._socket.bind(str(path))
        self.heard: list[str] = []
        self.senders: set[int] = set()

    def listen(self) -> list[str]:
        """Everything so far."""
        while True:
            try:
                data, found, _, _ = self._socket.recvmsg(4096, 1024)
            except BlockingIOError:
                return self.heard
            self.heard += data.decode().split("\n")
            self.senders |= {int.from_bytes(raw[:4], "little") for _, _, raw in found}

    def status(self) -> str:
        return [line for line in self.listen() if line.startswith("STATUS=")][-1][7:]

    def beats(self) -> int:
        return self.listen().count("WATCHDOG=1")

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Manager]:
    made = Manager(tmp_path / "notify")
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    monkeypatch.setenv("WATCHDOG_USEC", str(round(TIMEOUT_S * 1e6)))
    yield made
    made.close()


def test_ready_status_watchdog_and_end(manager: Manager, name: str, tmp_path: Path) -> None:
    config = tmp_path / "one-death.toml"
    config.write_text("[restart]\ndeaths = 1\n")
    with Trial(name, ("--config", str(config)), imu_hz=IMU_HZ) as trial:
        wait_for("READY=1", lambda: "READY=1" in manager.listen())
        assert "is ready: the stop is written" in trial.service.said(), "said and told at the same time"
        assert trial.service.process is not None
        assert manager.senders == {trial.service.process.pid}, "the main process alone: NotifyAccess=main is enough"
        wait_for("the status", lambda: manager.status() == "ready, motion disabled")
        set_off(trial)
        driven = "motion enabled; cmd_vel drives: "
        wait_for("who drives", lambda: trial.drive(0.02) or manager.status().startswith(driven))
        trial.robot.estop("hand near wheel")
        wait_for("the latch", lambda: manager.status().startswith("stop latched: stop request: hand near wheel"))
        wait_for("the reset", trial.reset)
        wait_for("the status", lambda: manager.status() == "ready, motion disabled")
        for pid in trial.service.pids().values():
            if pid != trial.service.process.pid:
                assert b"NOTIFY_SOCKET" not in Path(f"/proc/{pid}/environ").read_bytes()
        assert manager.listen().count("READY=1") == 1
        beats_but_not_of_a_hung_supervisor(manager, trial.service.process)
        wait_for("a service that is whole", lambda: trial.robot.state.waiting_for is None)
        os.kill(trial.service.pids()["gate"], signal.SIGKILL)
        wait_for("the status", lambda: "gate died too often and is down" in manager.status())
        before = manager.beats()
        wait_for("beats: a process that is down is no fault of the supervisor", lambda: manager.beats() >= before + 2)
        trial.leave()
        assert trial.service.end() == 0
        assert "STOPPING=1" in manager.listen()


def beats_but_not_of_a_hung_supervisor(manager: Manager, supervisor: subprocess.Popen[bytes]) -> None:
    before = manager.beats()
    wait_for("two beats", lambda: manager.beats() >= before + 2)
    supervisor.send_signal(signal.SIGSTOP)
    try:
        hung = manager.beats()
        with pytest.raises(TrialError, match="waited"):
            wait_for("a beat of a hung supervisor", lambda: manager.beats() > hung + 1, 2 * TIMEOUT_S)
    finally:
        supervisor.send_signal(signal.SIGCONT)
    wait_for("a beat", lambda: manager.beats() > hung + 1)
