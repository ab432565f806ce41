"""Telemetry in a running service, in front of the simulated board."""

from __future__ import annotations

import math
import os
import signal
from pathlib import Path

import pytest

from failstop.api.client import attach
from failstop.board.framing import BUZZER
from failstop.lab.trial import Trial, wait_for
from failstop.procs.telemetry import pad
from failstop.shm import records
from failstop.shm.layout import TELEMETRY

MODE = 0x2000


def battery(trial: Trial) -> tuple[int, int]:
    """The published (millivolts, plugged)."""
    entry = attach(trial.name, TELEMETRY).latest_reader("battery").read()
    return records.BATTERY.unpack(entry[2]) if entry else (0, 0)


def bias_dps(trial: Trial) -> float | None:
    """The published bias on z, once it is calibrated."""
    entry = attach(trial.name, TELEMETRY).latest_reader("bias").read()
    *bias, _, calibrated = records.BIAS.unpack(entry[2]) if entry else (0.0, 0.0, 0.0, False, False)
    return math.degrees(bias[2]) if calibrated else None


@pytest.mark.slow
def test_bias_charger_log_and_tones_on_a_running_service(tmp_path: Path) -> None:
    """One service for all, since each takes seconds of its own: the calibration 3, the charger 8."""
    folder = tmp_path / "state"
    config = tmp_path / "robot.toml"
    config.write_text(f'[battery]\ndirectory = "{folder}"\nlog_s = 1.0\n[buzzer]\ntones = "on"\n')
    with Trial(f"telemetry-{os.getpid()}", ("--config", str(config))) as trial:
        trial.board.gyro_bias(0.0, 0.0, math.radians(0.4))
        trial.board.battery(11_800)

        trial.board.pad(MODE)
        trial.board.wait_for(lambda event: event.func == BUZZER and event.data == pad.MODES[1][4:-1], 5.0)
        trial.board.pad(0x0100)
        trial.board.wait_for(lambda event: event.func == BUZZER and event.data == pad.LATCH[4:-1], 5.0)
        wait_for("the button's raw frames in the log", lambda: "last frames: 0020" in trial.service.said())

        wait_for("the calibration", lambda: bias_dps(trial) is not None)
        assert "gyro bias [" in trial.service.said()
        wait_for("the bias", lambda: bias_dps(trial) == pytest.approx(0.4, abs=0.15))

        wait_for("two lines", lambda: sum(path.read_text().count("\n") for path in folder.glob("*.csv")) >= 6, 20.0)
        trial.board.battery(11_800 + 249)
        wait_for("the charger", lambda: battery(trial)[1] == 1, 20.0)
        wait_for("its file", lambda: (folder / "charger").exists())
        pid = trial.service.pids()[TELEMETRY]
        os.kill(pid, signal.SIGKILL)
        trial.recover(TELEMETRY, pid)
        wait_for("a reading of the successor", lambda: battery(trial)[0] > 12_000)
        assert battery(trial)[1] == 1, "the last state survives a restart"
        assert bias_dps(trial) == pytest.approx(0.4, abs=0.15), "and so does the bias"
        lines = "".join(path.read_text() for path in folder.glob("*.csv")).splitlines()
        assert lines[0] == "unix_s,battery_mv,enabled"
        assert all(len(line.split(",")) == 3 for line in lines)


def test_pipes_in_the_place_of_its_files_hold_nothing_up(tmp_path: Path) -> None:
    """Telemetry comes up, and what it can't keep is told."""
    os.mkfifo(tmp_path / "charger")
    (tmp_path / "robot.toml").write_text(f'[battery]\ndirectory = "{tmp_path}"\n')
    with Trial(f"telemetry-pipe-{os.getpid()}", ("--config", str(tmp_path / "robot.toml"))) as trial:
        wait_for("the remark", lambda: "charger state can't be read" in trial.service.said())
        assert "a FIFO, not a regular file" in trial.service.said()
